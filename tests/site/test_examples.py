"""The examples in the docstrings of the public interface run, and give what they show."""

import doctest
import importlib
import inspect
import re
from pathlib import Path

import pytest

from hydro_agents.learning import stable_gain

ROOT = Path(__file__).parents[2]
FURTHER = (
    "hydro_agents.controllers.pid.PID",
    "hydro_agents.controllers.pid.PIDGains",
    "hydro_agents.learning.loading.shipped",
    "hydro_rig.recordings.recording.read_recording",
    "hydro_rig.recordings.simulated.record_axis",
    "hydro_agents.rigs.check.check_rig",
    "hydro_rig.diagnosis.diagnose.diagnose",
    "hydro_agents.running.cases.Cases",
    "hydro_agents.running.cases.run_cases",
)
"""Public names that the pages use beside those of docs/api.md."""

RESULTS = {
    "hydro_env.plant.linearisation.StateSpace",
    "hydro_env.plant.linearisation.Mode",
    "hydro_rig.estimation.result.Estimate",
    "hydro_agents.evaluation.runner.Results",
}
"""What a function returns; the example of the function shows it."""


def public_names():
    listed = re.findall(r"(?:autoclass|autofunction|py:class):: ([\w.]+)", (ROOT / "docs/api.md").read_text())
    assert len(listed) > 20
    return sorted({*listed, *FURTHER} - RESULTS)


@pytest.mark.parametrize("name", public_names())
def test_the_example_of_a_public_name_runs(name, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(stable_gain, "DRAWN", 8)
    monkeypatch.setattr(stable_gain, "PLANTS", 2)
    module, _, attribute = name.rpartition(".")
    thing = getattr(importlib.import_module(module), attribute)
    (test,) = doctest.DocTestFinder(recurse=False).find(thing, name, globs={})
    assert test.examples, "has no example"
    report = []
    options = doctest.ELLIPSIS | doctest.NORMALIZE_WHITESPACE
    doctest.DocTestRunner(optionflags=options).run(test, out=report.append)
    assert not report, "".join(report)
    assert inspect.getdoc(thing)
