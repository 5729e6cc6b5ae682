"""The estimator finds what was put in, says how well it knows it, and notices what its model does not have."""

import numpy as np
import pytest
from driven_axes import CONFIG, FEW, PLANT, driven
from refusal import refused

from hydro_env import TaskConfig
from hydro_env.plant.states import State
from hydro_env.task.configuration import task_config
from hydro_rig.estimation.estimate import EstimationSettings, estimate
from hydro_rig.estimation.replay import Commands, Rows, replay
from hydro_rig.estimation.unknowns import LEAKAGE, Prior, default_unknowns, prior_of

QUICK = EstimationSettings(horizons=(0.2,), restarts=1)


def replayed(config, command, physical, start, latency=(1e-3,)):
    """Readings of axes, each with its own window of commands (N, T)."""
    count, samples = command.shape
    supply = np.zeros((count, samples)), np.zeros((count, 2))
    rows = Rows(np.arange(count), physical, start, np.array(latency), np.zeros(count), *supply)
    return replay(config, Commands(command, np.full((count, 2, samples), np.nan)), rows)


def assert_within(found, name, truth, deviations=4.0):
    """The values of an unknown differ from the truth by at most so many of their standard deviations."""
    assert (np.abs(found.value(name) - truth) < deviations * found.deviation(name)).all(), name


@pytest.fixture(scope="module")
def moving():
    """Windows of four plants with two leaks; they do not begin at rest."""
    leak = np.array([0.05, 0.05, 0.5, 0.5])
    signals, physical, start = driven(CONFIG, leak, range(1_300_000, 1_300_004), start_moving=True)
    return leak, signals, physical, start


@pytest.fixture(scope="module")
def found(moving):
    return estimate(moving[1], CONFIG)


def exact(config=CONFIG):
    """The task with exact sensors: no lag, no noise."""
    return task_config(config, sensors={"enabled": False})


@pytest.mark.parametrize("latencies", [(0.0, 4e-3), (6e-3, 24e-3)], ids=["within a period", "up to five periods"])
def test_the_replay_is_what_the_environment_does(latencies):
    config = exact(TaskConfig(episode_duration=1.0, command_latency_range=latencies))
    random, latency = np.random.default_rng(0), []

    def command(axes, time):
        latency[:] = axes.column("latency")
        return random.uniform(-0.4, 0.4, 3)

    signals, physical, start = driven(config, [2.0] * 3, [1, 2, 3], 41, command)
    readings = replayed(config, signals[:, -1], physical, start, latency)
    np.testing.assert_allclose(readings, signals[:, :-1], rtol=1e-9, atol=1e-9)


def test_the_truth_is_recovered_from_exact_readings():
    config = exact()
    signals, physical, _ = driven(config, [0.02, 0.7], [11, 12])
    unknowns = (LEAKAGE, "valve.rated_flow", "load.mass", "load.spring_stiffness", "start.position", "start.pressure_a")
    unknowns = (*unknowns, "start.pressure_b", "start.spool_position", "start.supply_pressure")
    known = estimate(signals, config, unknowns, physical=physical)
    assert known.value(LEAKAGE) == pytest.approx([0.02, 0.7], abs=2e-4)
    for name in unknowns[1:4]:
        np.testing.assert_allclose(known.value(name), physical[:, PLANT(name)], rtol=2e-3)


def test_noisy_windows_of_unknown_plants_are_read_within_their_uncertainty(moving, found):
    leak, _, physical, start = moving
    assert found.names == default_unknowns(CONFIG)
    assert found.holds.all()
    assert (np.abs(found.chi2_per_sample - 1.0) < 0.2).all()
    assert_within(found, LEAKAGE, leak, 3.5)
    assert (found.deviation(LEAKAGE) < 0.03).all()
    for name in ("load.mass", "valve.rated_flow", "friction.coulomb_force"):
        assert_within(found, name, physical[:, PLANT(name)])
    assert_within(found, "start.position", start[:, State._fields.index("position")])


def test_a_narrow_prior_is_respected_and_a_wide_one_overruled(moving):
    leak, signals, physical, _ = moving
    for deviation, expected in ((1e-5, 0.2), (5.0, leak[2])):
        given = {"priors": {LEAKAGE: Prior(0.2, deviation)}, "physical": physical[2:3], "settings": QUICK}
        found = estimate(signals[2:3], CONFIG, FEW, **given)
        assert found.value(LEAKAGE)[0] == pytest.approx(expected, abs=1e-3 if deviation < 1.0 else 0.05)


def remaining_of(found, name):
    """Standard deviation of an unknown in the first window over that of its prior."""
    slope = prior_of(CONFIG, name).slope(found.scaled[0, found.names.index(name)])
    return float(found.deviation(name)[0] / slope)


def test_what_a_window_at_rest_cannot_tell_is_named():
    signals, *_ = driven(CONFIG, [0.01], [5], 60, lambda axes, time: axes.column("command"), initial_position=0.01)
    still = estimate(signals, CONFIG, settings=QUICK)
    remaining = {name: remaining_of(still, name) for name in still.names}
    assert min(remaining[name] for name in ("load.mass", "load.viscous_damping", "position_bias")) > 0.7
    assert remaining["start.position"] <= 0.7


def test_missing_readings_are_left_out(moving):
    leak, signals, *_ = moving
    gaps = signals[2:].copy()
    gaps[:, 3] = np.nan  # no spool sensor
    gaps[:, :4, 50:60] = np.nan
    gaps[:, 0, 70] = np.nan
    partial = estimate(gaps, CONFIG)
    assert partial.holds.all()
    assert_within(partial, LEAKAGE, leak[2:])
    assert (partial.deviation("spool_position_bias") > 0.99 * prior_of(CONFIG, "spool_position_bias").deviation).all()
    blind = signals[2:3].copy()
    blind[:, :4] = np.nan
    assert remaining_of(estimate(blind, CONFIG, settings=QUICK), LEAKAGE) > 0.7


def test_saturated_readings_are_left_out(moving):
    leak, signals, *_ = moving
    cut, high = signals[2:3].copy(), float(np.quantile(signals[2, 2], 0.8))
    cut[:, 2] = np.minimum(cut[:, 2], high)
    answer = estimate(cut, task_config(CONFIG, sensors={"pressure_b": {"high": high}}))
    assert answer.holds.all()
    assert_within(answer, LEAKAGE, leak[2])


@pytest.mark.parametrize("fault", [("valve_null_shift", 0.02), ("pressure_b_freeze", 1.0), ("valve_hysteresis", 0.04)])
def test_a_structure_that_the_model_lacks_is_flagged(fault):
    signals, *_ = driven(CONFIG, [0.02, 0.02], [41, 42], faults=dict([fault]))
    assert not estimate(signals, CONFIG, settings=EstimationSettings(restarts=0)).holds.any()


def test_batches_threads_and_neighbours_change_nothing(moving, found):
    _, signals, *_ = moving
    alone = estimate(signals[1], CONFIG, settings=EstimationSettings(threads=1))
    np.testing.assert_allclose(alone.values[0], found.values[1], rtol=1e-6)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"unknowns": ["leak"]}, "'leak': unknown name"),
        ({"unknowns": ["lines.wall_bulk_modulus"]}, "is infinite on this rig"),
        ({"first": {"valve.null_shift": 0.0}}, "'valve.null_shift' is not among the unknowns"),
        ({"signals": np.zeros((4, 20))}, "signals: shape"),
        ({"signals": np.full((5, 20), 2.0)}, "commands: window 0, sample 0 = 2"),
    ],
)
def test_wrong_input_is_one_line(change, message):
    arguments = {"signals": np.zeros((5, 20)), **change}
    with refused(message) as caught:
        estimate(arguments.pop("signals"), CONFIG, **arguments)
    assert "\n" not in str(caught.value)
