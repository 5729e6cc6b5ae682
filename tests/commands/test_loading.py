"""A command loads what it needs: no learning for a diagnosis, no torch for a help, and few files."""

import json
import subprocess
import sys

import pytest
from command_line import environment

COUNT = """
import contextlib, io, json, sys
from hydro_agents.commands.application import main
sys.argv = ["hydro", *sys.argv[1:]]
with contextlib.suppress(SystemExit), contextlib.redirect_stdout(io.StringIO()):
    main()
print(json.dumps(sorted(sys.modules)))
"""
LEARNING = ("torch", "stable_baselines3", "hydro_agents.learning.training", "hydro_agents.evaluation.study")
"""What only a training needs."""


@pytest.mark.parametrize(
    ("line", "most", "absent"),
    [
        ("--help", 55, (*LEARNING, "numba", "scipy", "pandas", "matplotlib")),
        ("diagnose absent.csv --output new", 135, (*LEARNING, "hydro_agents.learning")),
    ],
)
def test_a_command_loads_few_files_and_no_library_without_need(line, most, absent, tmp_path):
    done = subprocess.run(
        [sys.executable, "-c", COUNT, *line.split()],
        cwd=tmp_path, env=environment(), capture_output=True, text=True, check=True,
    )  # fmt: skip
    loaded = json.loads(done.stdout)
    own = [name for name in loaded if name.split(".")[0] in ("hydro_env", "hydro_agents", "hydro_rig")]
    assert not set(absent) & set(loaded)
    assert len(own) <= most, own
