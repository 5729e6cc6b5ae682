"""What the documentation of version 0.2 imports still works; of its imports only the first word changed."""

import importlib
import sys
import warnings

import pytest

from hydro_agents.moved import MOVED

PUBLIC = {
    "alarms.alarm": "AlarmSettings LeakAlarm",
    "alarms.looks": "looks_at",
    "bound.best_found": "best_found",
    "controllers": "ObservationLayout PID PIDGains",
    "controllers.base": "Controller Floats ObservationLayout as_batch",
    "controllers.registry": "CONTROLLERS make_controller",
    "diagnosis.diagnose": "diagnose",
    "diagnosis.picture": "paint",
    "estimation.estimate": "Estimate estimate",
    "estimation.information": "information ratios_to_bound sigma",
    "estimation.known_windows": "known_windows leak_cases",
    "estimation.unknowns": "priors_of",
    "evaluation.opponents": "opponent shipped",
    "evaluation.protocol": "ProtocolSettings evaluate",
    "leakage.head": "LeakageHead",
    "leakage.monitor": "MonitoredController",
    "learning.policy": "PolicyController",
    "learning.progress": "Progress",
    "learning.trainers": "Trainer",
    "learning.vec_env": "AxisVecEnv",
    "recordings.simulated": "record_axis",
    "rigs.brief": "brief",
    "rigs.check": "check_rig",
    "robustness.conditions": "protocol_named",
    "robustness.participants": "participants",
    "robustness.running": "replay",
    "running.cases": "Cases",
    "running.folders": "pretrained_folder",
    "running.seeds": "TEST_SEEDS",
    "running.weights": "load_weights require save_weights",
}
"""Modules and names that pages of version 0.2 import."""


def imported_anew(monkeypatch, name):
    """A module of a path of version 0.2, imported as if for the first time, and the warnings."""
    full = f"hydro_agents.{name}"
    if name in MOVED:
        monkeypatch.delitem(sys.modules, full, raising=False)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", DeprecationWarning)
        module = importlib.import_module(full)
    return module, [str(warning.message) for warning in caught if "since version 0.3" in str(warning.message)]


@pytest.mark.parametrize("name", PUBLIC)
def test_a_module_of_version_0_2_is_where_it_was_or_leads_to_its_new_place(monkeypatch, name):
    module, warned = imported_anew(monkeypatch, name)
    for public in PUBLIC[name].split():
        assert hasattr(module, public), public
    assert warned == ([f"hydro_agents.{name} is {MOVED[name]} since version 0.3"] if name in MOVED else [])


def test_an_old_path_gives_the_very_objects_of_the_new_one(monkeypatch):
    old, _ = imported_anew(monkeypatch, "leakage.head")
    assert old.LeakageHead is importlib.import_module(MOVED["leakage.head"]).LeakageHead


def test_every_path_of_the_table_was_public():
    assert set(MOVED) <= set(PUBLIC)


def test_what_never_existed_is_not_found(monkeypatch):
    with pytest.raises(ModuleNotFoundError, match=r"hydro_agents\.leakage\.tails"):
        importlib.import_module("hydro_agents.leakage.tails")
    head, _ = imported_anew(monkeypatch, "leakage.head")
    with pytest.raises(AttributeError, match="LeakageTail"):
        _ = head.LeakageTail
