"""The best found: it predicts as the simulator does, and its steps find known optima."""

import numpy as np
import pytest
from scipy.optimize import lsq_linear

from benchmarks.best_found import BestFound, Prediction, bounded_least_squares, continued, true_schedule
from hydro_agents.learning.loading import shipped
from hydro_agents.running.cases import Cases, run_cases
from hydro_env import ServoHydraulicVectorEnv, TaskConfig

SHORT = TaskConfig(episode_duration=0.4)
FAMILIES = ("step", "point_to_point", "ramp", "sine", "multi_sine", "start_stop")
CASES = Cases(
    np.arange(1_900_000, 1_900_012), np.repeat([0.01, 4.0], len(FAMILIES)), np.tile(FAMILIES, 2).astype(np.str_)
)
CHANGING = SHORT.model_copy(
    update={
        "leakage": SHORT.leakage.model_copy(update={"schedule": "growth"}),
        "disturbance": SHORT.disturbance.model_copy(update={"kind": "sine"}),
        "command_latency_range": (0.0, 4e-3),
    }
)


def errors(rollout):
    """Mean error of each case in the sensor's frame, m."""
    return np.abs(rollout.reference - rollout.position - rollout.position_bias[:, None]).mean(axis=1)


def prediction_of(config, env, horizon):
    axes = env.axes
    schedule = true_schedule(config, axes, config.steps + horizon)
    return Prediction(config, axes.coefficient.copy(), axes.column("latency").copy(), schedule)


@pytest.mark.parametrize("config", [SHORT, CHANGING], ids=["constant", "changing leak, force, latency"])
def test_the_prediction_is_what_the_environment_does(config):
    horizon = 30
    env = ServoHydraulicVectorEnv(3, config, info=False)
    env.reset(seed=[5, 6, 7], options={"leakage_flow_lpm": 3.0})
    axes = env.axes
    commands = np.random.default_rng(0).uniform(-0.3, 0.3, (3, horizon)).astype(np.float32)
    before = axes.column("command").copy()
    predicted = prediction_of(config, env, horizon).positions(
        axes.state.copy(), before, commands[:, None].astype(float), 0
    )
    driven = []
    for period in range(horizon):
        env.step(commands[:, period : period + 1])
        driven.append(axes.column("position").copy())
    np.testing.assert_array_equal(predicted[:, 0], np.transpose(driven))


def test_sensitivities_are_differences_of_predictions():
    horizon = 6
    env = ServoHydraulicVectorEnv(2, CHANGING, info=False)
    env.reset(seed=[1, 2])
    axes, prediction = env.axes, prediction_of(CHANGING, env, horizon)
    commands = np.random.default_rng(1).uniform(-0.5, 0.5, (2, horizon))
    start = axes.state.copy(), axes.column("command").copy()
    positions, jacobian = prediction.sensitivities(*start, commands, 0)
    for command in range(horizon):
        change = np.where(commands[:, command] > 0.0, -0.01, 0.01)
        moved = commands.copy()
        moved[:, command] += change
        other = prediction.positions(*start, moved[:, None], 0)[:, 0]
        np.testing.assert_allclose(jacobian[:, :, command] * change[:, None], other - positions, atol=1e-15)
    assert np.all(np.triu(jacobian, 1) == 0.0)  # a command changes nothing before it acts


def test_a_step_finds_the_optimum_within_the_limits():
    rng = np.random.default_rng(4)
    jacobian = np.tril(rng.uniform(0.5, 1.0, (20, 8, 8))) + 2.0 * np.eye(8)
    weight = rng.uniform(0.5, 2.0, (20, 8))
    error = 8.0 * rng.normal(size=(20, 8))
    found = bounded_least_squares(jacobian, error, weight, np.zeros((20, 8)), np.zeros(20), 0.0)
    root = np.sqrt(weight)
    known = [lsq_linear(r[:, None] * j, r * e, (-1, 1)).x for j, e, r in zip(jacobian, error, root, strict=True)]
    assert np.mean(np.abs(known) > 0.999) > 0.2  # the limits matter
    np.testing.assert_allclose(found, known, atol=1e-4)


def test_it_is_never_worse_than_the_pid_and_a_case_does_not_depend_on_its_neighbours():
    found, pid = (run_cases(SHORT, acting, CASES) for acting in (BestFound(SHORT), shipped("pid", SHORT)))
    assert np.all(found.failed_at < 0)
    assert np.all(errors(found) <= errors(pid))
    assert errors(found)[np.isin(CASES.families, ("point_to_point", "sine", "multi_sine"))].max() < 2e-6
    again = run_cases(SHORT, BestFound(SHORT), CASES.part(4, 5))
    np.testing.assert_array_equal(again.position, found.position[4:5])


def test_the_reference_beyond_the_preview():
    ramp = np.arange(20.0)[None]
    jump = np.where(np.arange(20) < 8, 0.0, 5.0)[None]
    np.testing.assert_array_equal(continued(ramp, 3, 4, 8), np.arange(4.0, 12.0)[None])
    np.testing.assert_array_equal(continued(ramp, 3, 0, 3), [[4, 5, 6]])  # without preview
    np.testing.assert_array_equal(continued(jump, 4, 4, 8), [[0, 0, 0, 5, 5, 5, 5, 5]])
    np.testing.assert_allclose(continued(ramp**2, 3, 4, 8), (ramp**2)[:, 4:12])
    slowing = np.cumsum(np.arange(20.0, 0.0, -1.0))[None]  # after five periods of its acceleration it keeps its speed
    speeds = np.diff(continued(slowing, 3, 4, 12)[0])
    np.testing.assert_array_equal(speeds, [15, 14, 13, 12, 11, 10, 9, 8, 8, 8, 8])
