"""The page about clusters, word for word: its program on every backend, its array job with Slurm's variable."""

import importlib.util
import os
import re
import stat
import subprocess
import sys

import pandas as pd
import pytest
from command_line import COMMAND, ROOT, environment

PAGE = (ROOT / "docs" / "cluster.md").read_text(encoding="utf-8")
(PROGRAM,) = re.findall(r"^```python\n(.*?)^```$", PAGE, flags=re.MULTILINE | re.DOTALL)
ARRAY, TABLES = re.findall(r"^```bash\n(.*?)^```$", PAGE, flags=re.MULTILINE | re.DOTALL)
PACKAGES = {"loky": "joblib", "dask": "distributed", "ray": "ray"}
STUDY = """
task: {episode_duration: 0.4}
controllers:
  PID: {kind: pid}
  PPO:
    kind: ppo
    corrects: PID
    settings: {total_steps: 64, axes: 8, hidden_sizes: [4], validation_every: 0,
               steps_per_rollout: 8, minibatches: 1, epochs: 1}
leakage_head: {episodes: 100, validation_episodes: 100, epochs: 1, width: 4, batch: 64}
evaluation: {plants: 3, detection_episodes: 100, leak_levels: [0.01, 4.0], families: [step], bound_plants: 1}
"""


@pytest.fixture(scope="module")
def expected(tmp_path_factory):
    return ran(PROGRAM.replace("jobs=2", "jobs=1"), tmp_path_factory.mktemp("alone"))


def ran(program, folder):
    """The tables of the program of the page; it must print nothing but that something is compiled."""
    (folder / "program.py").write_text(program)
    line = [sys.executable, "program.py"]
    done = subprocess.run(line, cwd=folder, env=environment(), capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert [line for line in done.stderr.splitlines() if not line.startswith("hydro_env: compiling")] == []
    tables = folder / "results" / "quick" / "tables"
    return {path.name: pd.read_csv(path) for path in tables.glob("*.csv")}


@pytest.mark.slow  # tests/hydro_agents/running/test_workers.py runs short jobs on every backend
@pytest.mark.parametrize("backend", PACKAGES)
def test_the_program_of_the_page_gives_the_same_bits_everywhere(backend, expected, tmp_path):
    if not importlib.util.find_spec(PACKAGES[backend]):
        pytest.skip(f"{PACKAGES[backend]} is not installed")
    found = ran(PROGRAM.replace('"loky"', f'"{backend}"'), tmp_path)
    assert found.keys() == expected.keys() >= {"ranking.csv", "status.csv"}
    for name in expected:
        pd.testing.assert_frame_equal(found[name], expected[name], check_exact=True)


def without_times(file):
    table = pd.read_csv(file)
    return table[table["figure"] != "training, s"]


@pytest.mark.slow
def test_the_array_job_and_the_seeds_side_by_side_give_the_bits_of_one_after_another(tmp_path):
    (tmp_path / "quick.yaml").write_text(STUDY)
    own = tmp_path / "hydro"  # the command of this checkout, in the place of the installed one
    own.write_text(f'#!/bin/sh\nexec {" ".join(COMMAND)} "$@"\n')
    own.chmod(own.stat().st_mode | stat.S_IXUSR)
    path = os.pathsep.join([str(tmp_path), os.environ["PATH"]])

    def shell(script, **variables):
        script = script.replace("--config quick", "--config quick.yaml")
        variables = environment(PATH=path, **variables)
        done = subprocess.run(
            ["bash", "-ec", script], cwd=tmp_path, env=variables, capture_output=True, text=True, check=False
        )
        assert done.returncode == 0, done.stderr

    first, last = map(int, re.search(r"--array=(\d+)-(\d+)", ARRAY).groups())
    assert f"--seeds {last - first + 1} " in TABLES
    for seed in (0, 2, 1):
        shell(ARRAY, SLURM_ARRAY_TASK_ID=str(seed))
    weights = tmp_path / "results" / "seeds" / "seed 1" / "controllers" / "PPO" / "policy.safetensors"
    written = weights.stat().st_mtime_ns
    shell(TABLES.replace("--seeds 8", "--seeds 3"))
    assert weights.stat().st_mtime_ns == written  # nothing was trained again
    line = "hydro study --config quick --seeds 3"
    shell(f"{line} --jobs 1 --output alone")
    shell(f"{line} --jobs 2 --output beside")
    assert (tmp_path / "beside" / "seed 2.log").stat().st_size > 0
    table = without_times(tmp_path / "results" / "seeds" / "tables" / "over_seeds.csv")
    for other in ("alone", "beside"):
        pd.testing.assert_frame_equal(
            without_times(tmp_path / other / "tables" / "over_seeds.csv"), table, check_exact=True
        )
        same = tmp_path / other / weights.relative_to(tmp_path / "results" / "seeds")
        assert same.read_bytes() == weights.read_bytes()
