"""The best found: it predicts as the simulator does, its steps find known optima; ``hydro bound``."""

import numpy as np
import pandas as pd
import pytest
from command_line import assert_one_clear_line, done, hydro
from published import assert_published
from refusal import refused
from scipy.optimize import lsq_linear

from hydro_agents.evaluation.best_found import BestFound, StateFilter, best_found
from hydro_agents.evaluation.bound_comparison import MEASURED, TRUTH, means_by, summary
from hydro_agents.evaluation.prediction import Prediction, bounded_least_squares, continued, true_schedule
from hydro_agents.learning.opponents import shipped
from hydro_agents.running.cases import Cases, run_cases
from hydro_agents.running.text import frame_markdown
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


@pytest.fixture(scope="module")
def truth():
    return best_found(SHORT, CASES)


@pytest.fixture(scope="module")
def measured():
    return best_found(SHORT, CASES, measured=True)


@pytest.fixture(scope="module")
def pid():
    return run_cases(SHORT, shipped("pid", SHORT), CASES)


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


def test_told_the_truth_it_is_never_worse_than_the_pid_and_than_without_it(truth, measured, pid):
    assert np.all(truth.failed_at < 0)
    assert np.all(errors(truth) <= errors(pid))
    assert np.all(errors(truth) <= errors(measured) + 1e-6)
    smooth = np.isin(CASES.families, ("point_to_point", "sine", "multi_sine"))
    assert errors(truth)[smooth].max() < 2e-6


def test_a_case_does_not_depend_on_its_neighbours(truth, measured):
    for told, whole in ((False, truth), (True, measured)):
        again = run_cases(SHORT, BestFound(SHORT, told), CASES.part(4, 6), chunk=1)
        np.testing.assert_array_equal(again.position, whole.position[4:6])


def test_with_a_measured_state_it_is_better_than_the_pid(measured, pid):
    assert np.mean(errors(measured) < errors(pid)) > 0.9
    assert errors(measured).mean() < 0.8 * errors(pid).mean()
    assert np.all(measured.failed_at < 0)


@pytest.mark.parametrize("config", [SHORT, CHANGING], ids=["constant", "changing leak, force, latency"])
def test_the_filter_finds_the_state_below_the_noise_of_the_sensors(config):
    """Position in the sensor's frame, speed, and pressures without the offsets of their sensors."""
    env = ServoHydraulicVectorEnv(8, config, info=False)
    env.reset(seed=list(range(40, 48)), options={"leakage_flow_lpm": 2.0})
    axes, prediction = env.axes, prediction_of(config, env, 1)
    estimate = StateFilter(config, axes)
    wrong = []
    for period in range(config.steps - 1):
        state, truth = estimate.updated(axes, prediction), axes.state.copy()
        truth[:, 0] += axes.column("bias")[:, 0]
        wrong.append(state - truth)
        env.step(np.full((8, 1), 0.1 * np.sin(0.2 * period)))
    position, speed, pressure_a, pressure_b = np.sqrt(np.mean(np.square(wrong[20:]), axis=(0, 1)))[:4]
    sensors = config.sensors
    assert position < 0.3 * sensors.position.noise
    assert speed < 0.1 * sensors.position.noise / config.control_period
    assert pressure_a < sensors.pressure_a.bias
    assert pressure_b < 0.5 * sensors.pressure_b.bias


def test_the_filter_derives_as_the_integrator_does():
    """The derivative of the next state, by a change of the first state that is ten times as large."""
    env = ServoHydraulicVectorEnv(3, SHORT, info=False)
    env.reset(seed=[1, 2, 3])
    axes, prediction = env.axes, prediction_of(SHORT, env, 1)
    state, command = axes.state.copy(), np.full(3, 0.1)
    after, change = prediction.next_state(state, command, command, 0)
    moved = state.copy()
    moved[:, 2] += 1e3  # Pa
    np.testing.assert_allclose(
        prediction.next_state(moved, command, command, 0)[0] - after, 1e3 * change[:, :, 2], rtol=0.1
    )


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


def test_wrong_input_gets_one_line(tmp_path):
    with refused("reads the true states"):
        BestFound(SHORT).predict(np.zeros((1, 13)))
    assert_one_clear_line(hydro("bound", "--task", "none.yaml", "--output", tmp_path / "out"), "none.yaml")
    assert_one_clear_line(hydro("bound", "--leak", "-1", "--output", tmp_path / "out"), "leak_levels", "-1")
    assert not (tmp_path / "out").exists()


def test_the_command_writes_every_case_and_a_table(tmp_path):
    task = tmp_path / "task.yaml"
    task.write_text("episode_duration: 0.05\n")
    answer = done("bound", "--task", task, "--leak", 1, "--leak", 4, "--output", tmp_path / "out")
    assert_published("bound", tmp_path / "out")
    cases = pd.read_csv(tmp_path / "out" / "bound.csv")
    shipped = {"PID", "PID mended", "ADRC", "LQG", "Flow linearisation", "PPO on flow linearisation"}
    assert set(cases["controller"]) == {*shipped, TRUTH, MEASURED}
    assert len(cases) == (len(shipped) + 2) * 2 * 6 * 3  # controllers, leaks, families, plants
    mean = cases[cases["controller"] == TRUTH]["error_mm"].mean()
    assert f"| {mean:.4f} |" in answer.stdout
    assert (tmp_path / "out" / "bound.md").read_text(encoding="utf-8").count("| mean |") == 3
    assert_one_clear_line(hydro("bound", "--task", task, "--output", tmp_path / "out"), "holds results already")


def test_the_summary_has_both_frames():
    rows = pd.DataFrame([("PID", 0.2), (MEASURED, 0.1), (TRUTH, 0.0)] * 2, columns=["controller", "error_mm"])
    rows = rows.assign(
        family=np.repeat(["step", "sine"], 3), true_error_mm=rows["error_mm"] + 0.03, valve_travel_per_s=2.0
    )
    table = summary(rows, "family")
    assert list(table.columns) == ["PID", MEASURED, TRUTH, "PID, true position", "floor, true position"]
    np.testing.assert_allclose(table.loc["mean"], [0.2, 0.1, 0.0, 0.23, 0.03])
    assert frame_markdown(means_by(rows, "valve_travel_per_s"), 1).splitlines()[-1] == "| mean | 2.0 | 2.0 | 2.0 |"
    assert frame_markdown(table).splitlines()[-1] == "| mean | 0.2000 | 0.1000 | 0.0000 | 0.2300 | 0.0300 |"
