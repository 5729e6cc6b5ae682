"""The protocol as data: what its conditions change, which cases they have, and how wrong ones are refused."""

import numpy as np
import pytest
from command_line import ROOT
from small_leaks import SMALL, small

from hydro_agents.detection.operations import ACTING, MOTIONS
from hydro_agents.evaluation.leak_protocol import DRAWN, HEALTHY, LeakProtocol
from hydro_agents.running.cases import run_cases
from hydro_agents.running.seeds import LEAKAGE, TEST_SEEDS, VALIDATION_SEEDS
from hydro_env import ConfigurationError


def test_every_level_and_condition_has_the_same_plants():
    protocol = small()
    cases = [protocol.cases_in(name, level, 10) for name in ("plain", "null") for level in (HEALTHY, 1.0)]
    for other in cases[1:]:
        np.testing.assert_array_equal(cases[0].seeds, other.seeds)
    assert set(cases[0].seeds) <= set(TEST_SEEDS)
    assert set(protocol.cases_in("plain", HEALTHY, 10, validation=True).seeds) <= set(VALIDATION_SEEDS)
    assert min(cases[0].seeds) == LEAKAGE.first


def test_leaks_are_fixed_healthy_or_drawn():
    protocol = small()
    low, high = protocol.task.leakage.healthy_range
    healthy, fixed, drawn = (protocol.cases_in("plain", level, 40).leakage_flow_lpm for level in (HEALTHY, 1.0, DRAWN))
    assert low <= healthy.min() < healthy.max() <= high
    assert (fixed == 1.0).all()
    assert ((drawn <= high) == (np.arange(40) % 2 == 0)).all()
    assert drawn.max() > 1.0


def test_the_detector_knows_the_rig_and_nothing_else_of_a_condition():
    conditions = {
        **SMALL["conditions"],
        "loud": {"noise_factor": 2.0, "task": {"leakage": {"law": "orifice"}}, "factors": {"load.mass": 2.0}},
        "other": {"rig": str(ROOT / "configs" / "rigs" / "symmetric_eha.yaml")},
    }
    protocol = small(conditions=conditions)
    assert protocol.known_task("loud") == protocol.task
    assert protocol.task_in("loud").sensors.position.noise == 2.0 * protocol.task.sensors.position.noise
    assert protocol.cases_in("loud", 1.0, 3).parameters["load"]["mass"] == 2.0 * protocol.task.plant.load.mass
    assert protocol.known_task("other").plant == protocol.task_in("other").plant != protocol.task.plant
    np.testing.assert_array_equal(protocol.cases_in("null", 1.0, 3).faults["valve_null_shift"], [0.02] * 3)


def test_windows_anywhere_are_cut_from_longer_runs():
    protocol = small(conditions={"plain": {"duration": 0.3}, "late": {"duration": 0.3, "begins": "anywhere"}})
    assert protocol.task_in("late").steps == 3 * protocol.task_in("plain").steps == 180


def test_groups_and_detectors_choose_what_is_read():
    protocol = small(
        detectors={"A": {"kind": "head", "groups": ["fault"]}, "B": {"kind": "estimator"}},
        conditions={**SMALL["conditions"], "mine": {"group": "fault", "detectors": ["B"]}},
    )
    read = {(name, who) for name in protocol.conditions for who in "AB" if protocol.reads(name, who)}
    assert read == {("plain", "B"), ("null", "A"), ("null", "B"), ("mine", "B")}


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"base": "absent"}, "base: 'absent' is not a condition"),
        ({"alarms": {"X": "a.yaml"}}, "alarms: unknown detector 'X'"),
        ({"bound_conditions": ["absent"]}, "bound_conditions: 'absent' is not a condition"),
        ({"conditions": {"plain": {"acting": "nobody"}}}, "unknown controller 'nobody'; known: PID"),
        ({"conditions": {"plain": {"motion": "flying"}}}, "unknown motion 'flying'; known: ordinary"),
        ({"conditions": {"plain": {"faults": {"rust": 1.0}}}}, "unknown fault 'rust'"),
        ({"conditions": {"plain": {"faults": {"valve_flow": 3.0}}}}, "must be within -0.9 to 0.9"),
        ({"conditions": {"plain": {"detectors": ["X"]}}}, "unknown detector 'X'"),
        ({"conditions": {"plain": {"levels": [99.0]}}}, "levels"),
        (
            {"conditions": {"plain": {"begins": "anywhere", "task": {"leakage": {"schedule": "onset"}}}}},
            "begin at rest",
        ),
        ({"conditions": {"plain": {"task": {"unknown": 1}}}}, "conditions.plain: "),
    ],
)
def test_a_wrong_protocol_is_refused_in_one_line(changes, message, tmp_path):
    import yaml

    path = tmp_path / "wrong.yaml"
    path.write_text(yaml.safe_dump({**SMALL, "kind": "leakage", **changes}))
    with pytest.raises(ConfigurationError) as error:
        LeakProtocol.from_yaml(path)
    assert message in str(error.value)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("name", ["leakage", "leakage_quick"])
def test_the_shipped_protocols_are_valid(name):
    protocol = LeakProtocol.from_yaml(ROOT / "configs" / "protocols" / f"{name}.yaml")
    assert protocol.measured[0] == "windows"
    assert len(protocol.sha256) == 64


@pytest.mark.parametrize("name", [name for name, acting in ACTING.items() if not acting.trained])
def test_operations_that_no_training_holds_move_the_axes_and_keep_their_memory(name):
    protocol = small()
    config, cases = protocol.task_in("plain"), protocol.cases_in("plain", HEALTHY, 4)
    runs = [run_cases(config, ACTING[name].make(config, 4, 3), cases, [0]) for _ in range(2)]
    assert np.ptp(runs[0].position, axis=1).max() > 1e-3
    np.testing.assert_array_equal(runs[0].signals, runs[1].signals)


def test_motions_change_what_is_asked_alone():
    task = small().task
    for motion in MOTIONS.values():
        assert motion.change(task).plant == task.plant
