"""Faults of valve, sensors, return line and rod seal: drawn, hidden from the observation, told to the judge."""

import numpy as np
import pytest

import hydro_env  # noqa: F401
from hydro_env import ServoHydraulicVectorEnv
from hydro_env.task.faults import FAULT_KINDS, FAULTS, KIND_OF_FAULT
from hydro_env.task.sensors import CHANNELS

COUNT = 400
PLAIN = {"sensors": {"enabled": False}}
COMMANDS = 0.3 * np.sin(np.arange(60) / 5)[:, None, None] * np.ones((60, 2, 1))


def signals(faults, **config):
    """Readings (T, channels) of an axis with faults and of the same axis without, at the same commands."""
    envs = ServoHydraulicVectorEnv(2, **{**PLAIN, **config})
    envs.reset(seed=[5, 5], options={"faults": {name: [size, 0.0] for name, size in faults.items()}})
    rows = []
    for command in COMMANDS.astype(np.float32):
        rows.append(envs.axes.column("measured").copy())
        envs.step(command)
    both = np.array(rows)
    return both[:, 0], both[:, 1], envs


def column(name):
    return CHANNELS.index(name)


def test_without_faults_nothing_changes_and_nothing_is_told():
    sound = ServoHydraulicVectorEnv(4)
    first, info = sound.reset(seed=1)
    assert info["faults"] == {}
    drawn = ServoHydraulicVectorEnv(4, task="faulty", leakage=sound.config.leakage)
    second, info = drawn.reset(seed=1)
    assert info["faults"]
    healthy = [axis for axis in range(4) if not drawn.axes.column("faulty")[axis]]
    assert healthy  # the faults of other axes shift no number of theirs
    np.testing.assert_array_equal(first[healthy], second[healthy])


def test_each_kind_occurs_with_its_probability_and_range():
    envs = ServoHydraulicVectorEnv(COUNT, task="faulty")
    envs.reset(seed=2)
    target = envs.axes.column("fault_target")
    for kind in FAULT_KINDS:
        sizes = target[:, [index for index, name in enumerate(FAULTS) if KIND_OF_FAULT[name] == kind]]
        hit = (sizes != 0.0).sum(axis=1)
        assert hit.max() == 1  # of one sensor alone
        assert abs(hit.mean() - 0.1) < 4 * np.sqrt(0.09 / COUNT)
        low, high = getattr(envs.config.faults, kind).range
        largest = np.abs(sizes).max(axis=1)[hit == 1]
        assert low <= largest.min() <= largest.max() <= high
    assert (target[:, FAULTS.index("valve_null_shift")] < 0.0).any()
    assert (target[:, FAULTS.index("valve_underlap")] >= 0.0).all()


def test_a_fault_of_the_plant_is_the_parameter_of_that_name():
    envs = ServoHydraulicVectorEnv(2)
    faults = {"valve_null_shift": 0.02, "valve_underlap": 0.03, "valve_flow": -0.2, "tank_pressure": 3e5}
    envs.reset(seed=[7, 7], options={"faults": {name: [size, 0.0] for name, size in faults.items()}})
    worn, sound = envs.axes.parameters(0), envs.axes.parameters(1)
    assert worn.valve.null_shift == pytest.approx(sound.valve.null_shift + 0.02)
    assert worn.valve.underlap == pytest.approx(sound.valve.underlap + 0.03)
    assert worn.valve.rated_flow == pytest.approx(0.8 * sound.valve.rated_flow)
    assert worn.supply.tank_pressure == pytest.approx(sound.supply.tank_pressure + 3e5)

    # The same plant without faults, whose parameters have these values, moves in the same way.
    other = ServoHydraulicVectorEnv(2)
    groups = {"valve": ("null_shift", "underlap", "rated_flow"), "supply": ("tank_pressure",)}
    values = {
        group: {name: [getattr(getattr(plant, group), name) for plant in (worn, sound)] for name in names}
        for group, names in groups.items()
    }
    other.reset(seed=[7, 7], options={"parameters": values})
    for command in COMMANDS[:20].astype(np.float32):
        first, second = envs.step(command)[0], other.step(command)[0]
    np.testing.assert_allclose(first, second, atol=1e-5)


@pytest.mark.parametrize("channel", CHANNELS)
def test_a_sensor_reads_beside_the_truth(channel):
    sensor = getattr(ServoHydraulicVectorEnv(1).config.sensors, channel)
    span = sensor.high - sensor.low
    start = {"start": "actual"}  # else the axis begins where the faulty sensor reads the reference
    wrong, right, _ = signals({f"{channel}_offset": 0.02, f"{channel}_gain": -0.03}, **start)
    place = column(channel)
    np.testing.assert_allclose(wrong[:, place], 0.97 * right[:, place] + 0.02 * span, rtol=1e-12, atol=1e-12)
    others = [index for index in range(len(CHANNELS)) if index != place]
    np.testing.assert_array_equal(wrong[:, others], right[:, others])


def test_a_frozen_sensor_stands_still_and_a_lost_sample_reads_the_lower_end():
    wrong, right, _ = signals({"spool_position_freeze": 1.0, "pressure_a_dropout": 0.25})
    frozen, lost = wrong[:, column("spool_position")], wrong[:, column("pressure_a")]
    assert np.ptp(right[:, column("spool_position")]) > 0.1
    assert np.ptp(frozen) == 0.0
    assert 5 <= (lost == 0.0).sum() <= 28
    np.testing.assert_array_equal(lost[lost > 0.0], right[:, column("pressure_a")][lost > 0.0])


def test_hysteresis_follows_half_its_width_behind():
    _, _, envs = signals({"valve_hysteresis": 0.1})
    drive, command = envs.axes.column("drive"), envs.axes.column("command")
    assert abs(drive[0] - command[0]) <= 0.05 + 1e-12
    assert drive[1] == command[1]
    for level in (0.5, 0.42):  # back by less than the play
        envs.step(np.full((2, 1), level, np.float32))
        assert envs.axes.column("drive")[0] == pytest.approx(0.45)
