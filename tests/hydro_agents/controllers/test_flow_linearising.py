"""Flow linearisation: its model against the simulated plant, its filter against the textbook, its behaviour."""

import numpy as np
import pytest

from hydro_agents.controllers.flow_linearising import FlowLinearising, FlowLinearisingGains
from hydro_agents.controllers.flow_model import FlowModel
from hydro_agents.controllers.motion_filter import MotionFilter
from hydro_agents.controllers.registry import make_controller
from hydro_agents.running.cases import Cases, run_cases
from hydro_env import PlantParameters, ServoHydraulicVectorEnv, TaskConfig, simulate
from hydro_env.folders import config_folder
from hydro_env.plant.states import STATE_NAMES
from hydro_env.task.rig import read_rig

PLAIN = PlantParameters().replace(
    friction={"model": "none"},
    load={"spring_stiffness": 0.0},
    supply={"model": "constant"},
    leakage={"internal_resistance": 1e18},
)
RIGS = sorted((config_folder() / "rigs").glob("*.yaml"))


@pytest.mark.parametrize("volts", [6.0, 1.0, -1.0, -6.0])
def test_the_model_gives_the_speed_of_the_plant_while_its_pressures_still_move(volts):
    """Also 15 ms after the start, when the pressures are far from their steady level."""
    period = 1e-4
    run = simulate(PLAIN, np.full(2500, volts), period)
    model = FlowModel(PLAIN)
    pressures = np.array([run["pressure_a"], run["pressure_b"]])
    flow = model.at(run["position"], pressures, np.full(len(run), PLAIN.supply.pressure))
    speed = model.speed(run["spool_position"], flow) - np.gradient(flow.force, period) / flow.stiffness
    late = slice(150, -1)
    np.testing.assert_allclose(speed[late], run["velocity"][late], rtol=3e-3)
    assert np.ptp(pressures.sum(axis=0)[late]) > 1e5  # the pressures moved


def test_the_opening_inverts_the_speed():
    model, generator = FlowModel(PLAIN), np.random.default_rng(0)
    pressures = generator.uniform(1e6, 6e6, (2, 50))
    flow = model.at(generator.uniform(-0.1, 0.1, 50), pressures, np.full(50, 7e6))
    opening = generator.uniform(-1.0, 1.0, 50)
    np.testing.assert_allclose(model.opening(model.speed(opening, flow), flow), opening, atol=1e-12)


def test_the_pressures_at_rest_tell_the_supply_within_the_bounds_of_the_data_sheet():
    env = ServoHydraulicVectorEnv(40, TaskConfig(sensors={"enabled": False}), info=False)
    env.reset(seed=3, options={"parameters": {"leakage": {"external_resistance": np.inf}}})
    state = dict(zip(STATE_NAMES, env.axes.state.T, strict=True))
    pressures, model = np.array([state["pressure_a"], state["pressure_b"]]), FlowModel(PlantParameters())
    nominal = PlantParameters().supply.pressure
    known = np.clip(state["supply_pressure"], 0.8 * nominal, 1.5 * nominal)
    np.testing.assert_allclose(model.supply(pressures, np.zeros(40)), known, rtol=2e-3)
    np.testing.assert_array_equal(model.supply(pressures, np.full(40, 0.05)), nominal)


def test_the_filter_is_the_kalman_filter_of_the_textbook():
    period, noise = 0.005, 3e-5
    spread, motion, memory = np.array([3e-5, 0.1, 1e-12, 0.01]), 1e-4, np.array([2.0, 10.0, 0.5])
    kept = np.append(1.0, np.exp(-period / memory))  # the position is a random walk
    axes, generator = 3, np.random.default_rng(1)
    watched = MotionFilter(noise, spread, motion, memory, period)
    x, p = watched.start(np.zeros(axes), np.full(axes, 0.02), np.full(axes, 3e9), np.full(axes, 0.001))
    expected = [(x[i].copy(), p[i].copy()) for i in range(axes)]
    for _ in range(40):
        way, leak, other, y = (scale * generator.standard_normal(axes) for scale in (1e-3, 1e6, 1e-5, 1e-3))
        x, p = watched.advanced(x, p, way, leak, other, y)
        for i, (mean, covariance) in enumerate(expected):
            f = np.eye(4)
            f[0] = 1.0, way[i], leak[i], period
            mean = f @ mean + np.array([way[i] + other[i], 0.0, 0.0, 0.0])
            covariance = f @ covariance @ f.T + np.diag(
                np.r_[motion**2 * period, spread[1:] ** 2 * (1.0 - kept[1:] ** 2)]
            )
            k = covariance[:, 0] / (covariance[0, 0] + noise**2)
            expected[i] = (
                kept * (mean + k * (y[i] - mean[0])),
                kept[:, None] * (covariance - np.outer(k, covariance[0])) * kept,
            )
    np.testing.assert_allclose(x, [mean for mean, _ in expected], rtol=1e-9)
    np.testing.assert_allclose(p, [covariance for _, covariance in expected], rtol=1e-7, atol=1e-30)


@pytest.mark.parametrize("speed", [0.05, -0.05])
def test_in_steady_motion_it_holds_the_speed(speed):
    config = TaskConfig(
        plant=PLAIN.model_dump(), randomisation={}, sensors={"enabled": False}, episode_duration=1.0,
        references={"user": (speed * 0.005 * np.arange(200)).tolist(), "weights": {"user": 1.0}},
    )  # fmt: skip
    controller = FlowLinearising(FlowLinearisingGains(), config)
    run = run_cases(config, controller, Cases(np.array([0]), np.array([1e-6])))
    assert np.abs(run.reference[0, 120:-10].astype(float) - run.position[0, 120:-10]).max() < 5e-6
    assert np.ptp(run.command[0, 150:-10]) < 2e-3


def test_it_starts_without_a_bump():
    config = TaskConfig(sensors={"enabled": False})
    env = ServoHydraulicVectorEnv(12, config, info=False)
    observation, _ = env.reset(seed=0, options={"reference": ["ramp"] * 12})
    held = env.axes.column("command").copy()
    command, _ = FlowLinearising(FlowLinearisingGains(), config).predict(observation)
    np.testing.assert_allclose(command[:, 0], held, atol=1e-6)


def test_it_sets_off_before_a_jump_by_about_half_the_time_that_the_jump_takes():
    def first_command(size, share):
        reference = np.where(np.arange(200) >= 100, size, 0.0)
        config = TaskConfig(
            plant=PLAIN.model_dump(), randomisation={}, sensors={"enabled": False}, episode_duration=1.0,
            references={"user": reference.tolist(), "weights": {"user": 1.0}},
        )  # fmt: skip
        gains = FlowLinearisingGains(set_off_share=share, set_off_delay=1.0)
        run = run_cases(config, FlowLinearising(gains, config), Cases(np.array([0]), np.array([1e-6])))
        return 100 - int(np.flatnonzero(np.abs(run.command[0]) > 0.1)[0])  # periods before the jump

    assert first_command(0.004, 0.0) == 1  # the delay of 7.7 ms is one whole period
    assert first_command(0.004, 1.0) == 3  # and half of 4 mm at 0.19 m/s
    assert first_command(-0.015, 1.0) == 8  # as soon as the preview shows it


@pytest.mark.parametrize(
    "options",
    [
        {"references": {"preview_times": []}},
        {"control_period": 2e-3},
        {"control_period": 0.01},
        {"command_latency": 5e-3},
        *({"plant": read_rig(rig).plant, "randomisation": {}} for rig in RIGS),
    ],
)
def test_untuned_it_controls_every_rig_without_preview_at_other_periods_and_latencies(options):
    config = TaskConfig(**options)
    controller = make_controller("flow_linearising", config)
    run = run_cases(config, controller, Cases(np.arange(4), np.array([0.01, 1.0] * 2), np.array(["sine", "ramp"] * 2)))
    assert (run.failed_at < 0).all()
    assert 1e3 * np.abs(run.position - run.reference).mean() < 0.4
