"""A detector of one's own in a leakage protocol, by the command: its verdicts, and how little of the house it loads."""

import subprocess
import sys

import pandas as pd
import yaml
from command_line import environment

DETECTOR = """
import numpy as np

from hydro_agents.detection.detector import Reading

class Spread:
    threshold = None

    def refuses(self, task, samples):
        return ""

    def read(self, windows, task):
        return Reading.of(windows.signal("spool_position").std(axis=1))
"""
PROTOCOL = {
    "kind": "leakage",
    "task": {"episode_duration": 0.3},
    "levels": [0.0, 1.0],
    "detectors": {"mine": {"kind": "my_detector:Spread", "windows": 4, "validation_windows": 20, "batch": 20}},
    "base": "plain",
    "conditions": {"plain": {"group": "levels", "duration": 0.3}},
}
RUN = """
import sys
from hydro_agents.commands import application

sys.argv = ["hydro", "evaluate", "--protocol", "tiny.yaml", "--output", "out", "-j", "1"]
try:
    application.main()
except SystemExit as stop:
    assert not stop.code
print("loaded:", *(name for name, module in sys.modules.items() if not hasattr(module, "__path__")))
"""
ROOMS = ("hydro_agents.learning", "hydro_agents.study", "hydro_agents.rigs", "hydro_rig")
LIBRARIES = {"torch", "stable_baselines3", "sb3_contrib", "safetensors", "cma"}
MOST_FILES = 90
"""Own files that the command may load, those of the environment among them."""


def test_a_detector_of_numpy_is_judged_without_the_rooms_that_learn(tmp_path):
    (tmp_path / "my_detector.py").write_text(DETECTOR)
    (tmp_path / "tiny.yaml").write_text(yaml.safe_dump(PROTOCOL))
    answer = subprocess.run(
        [sys.executable, "-c", RUN], cwd=tmp_path, env=environment(), capture_output=True, text=True, check=False
    )
    assert answer.returncode == 0, answer.stderr
    table = pd.read_csv(tmp_path / "out" / "tables" / "detection.csv")
    assert table["windows"].tolist() == [4, 4]
    printed = next(line.split() for line in answer.stdout.splitlines() if line.split()[:1] == ["mine"])
    assert [float(share) for share in printed[1:]] == (100.0 * table["flagged"]).tolist()
    facts = pd.read_csv(tmp_path / "out" / "tables" / "protocol.csv").set_index("key")["value"]
    assert facts["sha256"] in (tmp_path / "out" / "leakage.html").read_text(encoding="utf-8")
    loaded = answer.stdout.splitlines()[-1].removeprefix("loaded: ").split()
    assert not LIBRARIES & {name.partition(".")[0] for name in loaded}
    own = [name for name in loaded if name.startswith(("hydro_env.", "hydro_agents.", "hydro_rig."))]
    assert {name for name in own if name.startswith(ROOMS)} <= {"hydro_agents.learning.loading"}
    assert len(own) <= MOST_FILES
