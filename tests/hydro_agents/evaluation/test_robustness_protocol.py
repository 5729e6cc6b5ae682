"""Conditions: what each changes, what it leaves alone, and what is refused."""

import numpy as np
import pandas as pd
import pytest
import yaml
from refusal import refused
from small_protocol import SMALL, named, small

from hydro_agents.evaluation.evaluate import ProtocolSettings
from hydro_agents.evaluation.robustness_protocol import RobustnessProtocol
from hydro_agents.report.controllers_page import GROUPS
from hydro_agents.running.seeds import ROBUSTNESS
from hydro_env import PlantParameters, ServoHydraulicVectorEnv


def plants_of(protocol, name):
    """Parameters of every plant of a condition."""
    cases = protocol.cases_of(name, protocol.cases_in(name))
    env = ServoHydraulicVectorEnv(len(cases), protocol.tasks[name], info=False)
    options = {"leakage_flow_lpm": cases.leakage_flow_lpm, "parameters": cases.parameters or {}}
    env.reset(seed=[int(seed) for seed in cases.seeds], options=options)
    return [env.axes.parameters(axis) for axis in range(len(cases))]


def test_factors_and_parameters_fix_every_plant_and_leave_the_other_draws_alone():
    protocol = small(
        conditions={"plain": {}, "heavy": {"factors": {"load.mass": 2.0}, "parameters": {"valve.underlap": 0.04}}}
    )
    plain, heavy = plants_of(protocol, "plain"), plants_of(protocol, "heavy")
    assert {plant.load.mass for plant in heavy} == {2.0 * PlantParameters().load.mass}
    assert {plant.valve.underlap for plant in heavy} == {0.04}
    assert len({plant.load.mass for plant in plain}) > 2
    assert [p.supply.pressure for p in plain] == [p.supply.pressure for p in heavy]
    assert [p.load.viscous_damping for p in plain] == [p.load.viscous_damping for p in heavy]


def test_noise_and_bias_are_multiplied_on_every_sensor_and_the_controller_is_not_told():
    conditions = {
        "loud": {"noise_factor": 2.0},
        "off": {"bias_factor": 3.0},
        "late": {"task": {"command_latency": 0.004}},
    }
    protocol = small(conditions=conditions | {"heavy": {"factors": {"load.mass": 2.0}}})
    own, loud, off = protocol.task.sensors, protocol.tasks["loud"].sensors, protocol.tasks["off"].sensors
    for channel in ("position", "pressure_a", "pressure_b", "spool_position"):
        mine, noisy, biased = (getattr(sensors, channel) for sensors in (own, loud, off))
        assert (noisy.noise, noisy.bias) == (2.0 * mine.noise, mine.bias)
        assert (biased.noise, biased.bias) == (mine.noise, 3.0 * mine.bias)
        assert min(mine.noise, mine.bias) > 0.0
    assert protocol.tasks["heavy"].plant == protocol.task.plant
    assert (protocol.tasks["late"].command_latency, protocol.tasks["late"].sensors) == (0.004, own)


def test_cases_are_paired_over_conditions_and_leaks_and_disjoint_from_the_ordinary_evaluation():
    protocol = small()
    table, second = protocol.cases_in("plain"), protocol.cases_in("late")
    np.testing.assert_array_equal(table["seed"], second["seed"])
    assert len(table) == 2 * 2 * 3
    for _, rows in table.groupby(["family", "plant"]):
        assert rows["seed"].nunique() == 1
        assert set(rows["leakage_flow_lpm"]) == {0.03, 4.0}
    everything = named("robustness")
    own = np.concatenate([everything.cases_in(name)["seed"] for name in everything.conditions])
    assert ROBUSTNESS.first <= own.min() <= own.max() < ROBUSTNESS.first + ROBUSTNESS.count
    study = ProtocolSettings(plants=9_000).protocol(protocol.task).cases_in("task")
    assert not set(own.tolist()) & set(study["seed"].tolist())


def test_the_shipped_protocols_are_possible_and_as_wide_as_promised():
    protocol = named("robustness")
    table = pd.DataFrame(protocol.rows())
    assert set(GROUPS) == set(table["group"])
    assert table["label"].is_unique
    # Every drawn parameter is varied by itself.
    fixed = {path for entry in protocol.conditions.values() for path in (*entry.factors, *entry.parameters)}
    assert set(protocol.task.randomisation) <= fixed
    for path, draw in protocol.task.randomisation.items():
        entries = [c.factors[path] for c in protocol.conditions.values() if path in c.factors]
        group, field = path.split(".")
        if draw.times is None and "external" not in path:
            own = getattr(getattr(protocol.task.plant, group), field)
            low, high = draw.bounds(own)
            assert own * min(entries) < low
            assert own * max(entries) > high
    assert len(list(named("quick").rows())) < 12


def test_a_file_names_its_task_rigs_and_gains_by_path_and_the_digest_follows_all(tmp_path):
    path, gains = tmp_path / "own.yaml", tmp_path / "gains.yaml"
    (tmp_path / "task.yaml").write_text("episode_duration: 0.5\n")
    entry = {"controllers": {"PID": "gains.yaml"}, "rig": "symmetric_eha"}
    path.write_text(yaml.safe_dump({**SMALL, "task": "task.yaml", "conditions": {"rig": entry}}))
    gains.write_text("proportional: 12.0\n")
    protocol = RobustnessProtocol.from_yaml(path)
    assert protocol.task.episode_duration == 0.5
    assert protocol.conditions["rig"].controllers["PID"] == {"proportional": 12.0}
    assert protocol.tasks["rig"].plant.load.mass == 20.0
    assert RobustnessProtocol.from_yaml(path).sha256 == protocol.sha256
    gains.write_text("proportional: 13.0\n")
    assert RobustnessProtocol.from_yaml(path).sha256 != protocol.sha256


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"conditions": {"a": {"leak": [1.0]}}}, r"conditions\.a\.leak = \[1\.0\]: unknown key.*leak_levels"),
        ({"conditions": {"a": {"leak_levels": [30.0]}}}, r"leak_levels\.0 = 30\.0: must be within .* 20 l/min"),
        ({"conditions": {"a": {"families": ["user", "step"]}}}, "'user' must stand alone"),
        ({"conditions": {"a": {"factors": {"supply.model": 2.0}}}}, "a name, not a number"),
        (
            {"conditions": {"a": {"factors": {"load.mass": 2.0}, "parameters": {"load.mass": 9.0}}}},
            "also in parameters",
        ),
        ({"conditions": {"a": {"task": {"command_latency": 0.2}}}}, r"conditions\.a: task.*0\.1"),
        ({"conditions": {"all": {}}}, "'all' is the name"),
        ({"leak_levels": [1.0, 1.0]}, "duplicate entry"),
    ],
)
def test_what_is_wrong_is_named_in_one_line(tmp_path, changes, message):
    path = tmp_path / "own.yaml"
    path.write_text(yaml.safe_dump({**SMALL, **changes}))
    with refused(f"own.yaml.*{message}"):
        RobustnessProtocol.from_yaml(path)
