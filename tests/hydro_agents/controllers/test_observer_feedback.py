"""Controllers with an observer, against known answers: poles, Riccati equations, margins, steady errors."""

import numpy as np
import pytest
from scipy.linalg import solve_discrete_are

from hydro_agents.controllers.adrc import ADRC, ADRCGains
from hydro_agents.controllers.lqg import LQG, LQGGains, kalman_gain, regulator
from hydro_agents.controllers.observer_feedback import SampledModel
from hydro_agents.controllers.preview import braked
from hydro_agents.controllers.registry import make_controller
from hydro_agents.running.cases import Cases, run_cases
from hydro_env import PlantParameters, TaskConfig

TASK = TaskConfig()
RIGS = ("kovari_2015", "symmetric_eha", "aalborg_svsdp_2017")
KINDS = ("adrc", "lqg")


def task_of_rig(name, **fields):
    """A task on a rig of configs/rigs, without randomisation."""
    return TaskConfig(plant=PlantParameters.from_yaml(f"configs/rigs/{name}.yaml"), randomisation={}, **fields)


def closed_loop(controller):
    """Transition matrix of the loop of controller and its own model: state, estimate, last command, (2n + 1, 2n + 1).

    Built by perturbing each of them, so that it tests the equations as they are used.
    """
    m = controller.model
    n = len(m.transition)
    steps = np.zeros((2 * n + 1, controller.preview.horizon + 1))
    x, estimate, before = np.split(np.eye(2 * n + 1), [n, 2 * n], axis=1)
    innovation = (x - estimate) @ m.outputs.T
    corrected = estimate + innovation @ controller.correction.T
    command = controller.speed(corrected, corrected[:, 0], before[:, 0], steps)
    moved = x @ m.transition.T + np.outer(before, m.input_old) + np.outer(command, m.input_new)
    expected = corrected @ m.transition.T + np.outer(before, m.input_old) + np.outer(command, m.input_new)
    return np.concatenate([moved, expected, command[:, None]], axis=1).T


def test_braking_is_a_root_and_joins_smoothly():
    near, small = 2e-3, 1e-9
    error = np.array([-near / 2, near / 2, near - small, near + small, 8.5 * near])
    reduced = braked(error, near)
    np.testing.assert_allclose(reduced[:2], error[:2])
    assert (reduced[3] - reduced[2]) / (2 * small) == pytest.approx(1.0, rel=1e-3)
    assert reduced[4] == pytest.approx(4.0 * near)


# ADRC ----------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("bandwidth", [0.5, 1.5, 4.0])
def test_all_poles_of_the_extended_state_observer_lie_at_its_bandwidth(bandwidth):
    controller = ADRC(ADRCGains(observer_bandwidth=bandwidth), TASK)
    m = controller.model
    errors = (np.eye(3) - controller.correction @ m.outputs) @ m.transition
    wanted = np.exp(-bandwidth / controller.lag * TASK.control_period)
    # The characteristic polynomial, because a triple eigenvalue is not well conditioned.
    np.testing.assert_allclose(
        np.poly(errors * [[1.0], [0.01], [1e-4]] / [1.0, 0.01, 1e-4]), np.poly([wanted] * 3), atol=1e-9
    )


def test_poles_of_adrc_are_those_of_observer_and_controller():
    controller = ADRC(ADRCGains(controller_bandwidth=0.5, observer_bandwidth=2.0), TASK)
    period = TASK.control_period / controller.lag
    inner, outer = np.exp(-0.5 * period), np.exp(-2.0 * period)
    # The disturbance is not controllable: its pole stays at 1, and it is cancelled.
    wanted = np.poly([inner, inner, 0.0, outer, outer, outer, 1.0])
    scale = np.array([1.0, 0.01, 1e-4, 1.0, 0.01, 1e-4, 0.01])
    np.testing.assert_allclose(np.poly(closed_loop(controller) * scale / scale[:, None]), wanted, atol=1e-6)


# LQG -----------------------------------------------------------------------------------------------------------------


def test_the_kalman_gain_is_that_of_the_riccati_equation():
    model = SampledModel(np.array([[1.0, 0.1], [0.0, 0.9]]), np.zeros(2), np.array([0.0, 1.0]), np.array([[1.0, 0.0]]))
    drift, noise = np.array([0.1, 0.3]), np.array([0.2])
    p = solve_discrete_are(model.transition.T, model.outputs.T, np.diag(drift**2), np.diag(noise**2))
    known = p @ model.outputs.T / (model.outputs @ p @ model.outputs.T + noise**2)
    for size in (np.ones(2), np.array([1e-3, 40.0])):
        np.testing.assert_allclose(kalman_gain(model, drift, noise, size), known, rtol=1e-8)


def test_the_regulator_is_that_of_the_riccati_equation_and_its_preview_sums_to_the_feedback():
    model = LQG(LQGGains(), TASK).model
    feedback, preview = regulator(model, 20.0, np.ones(6), 1.0)
    scaled, same = regulator(model, 20.0, np.array([1e-3, 0.2, 60.0, 0.2, 100.0, 0.3]), 0.2)
    np.testing.assert_allclose(feedback, scaled, rtol=1e-5)
    np.testing.assert_allclose(preview, same, rtol=1e-4, atol=1e-6)
    assert preview.sum() == pytest.approx(feedback[0], rel=1e-6)  # position and reference moved alike: no command


def test_preview_of_an_integrator_is_known():
    """x⁺ = x + u with Σ x² + r (Δu)²; optimal commands from one long least-squares problem."""
    weight, horizon = 0.7, 60
    model = SampledModel(np.array([[1.0]]), np.zeros(1), np.ones(1), np.ones((1, 1)))
    feedback, preview = regulator(model, weight, np.ones(1), 1.0)
    reference = np.zeros(horizon)
    reference[3:] = 1.0
    changes = np.tril(np.ones((horizon, horizon)))
    positions = np.tril(np.ones((horizon, horizon)), 0) @ changes  # after 1, 2, … periods
    target = np.concatenate([weight * reference, np.zeros(horizon)])
    best = np.linalg.lstsq(np.concatenate([weight * positions, np.eye(horizon)]), target, rcond=None)[0]
    assert preview[:horizon] @ reference == pytest.approx(best[0], rel=1e-6)
    assert feedback.shape == (2,)


LOOPS = [
    *(task_of_rig(name, control_period=5e-3, command_latency=latency) for name in RIGS for latency in (1e-3, 5e-3)),
    *(task_of_rig(name, control_period=2e-3, command_latency=0.0) for name in RIGS),
    *(TaskConfig(plant=PlantParameters().replace(valve={"model": valve})) for valve in ("spool", "ideal")),
]


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("task", LOOPS)
def test_the_loop_on_the_linear_model_is_stable_on_every_rig(kind, task):
    controller = make_controller(kind, task)
    radii = np.sort(np.abs(np.linalg.eigvals(closed_loop(controller))))
    disturbances = 1 if kind == "adrc" else 3
    assert np.all(radii[-disturbances:] == pytest.approx(1.0, abs=1e-5))  # nothing moves a constant disturbance
    assert radii[-disturbances - 1] < 0.995


@pytest.mark.parametrize("kind", KINDS)
def test_a_constant_load_leaves_no_error(kind):
    """Exact sensors, an axis that leaks and is lighter than the nominal one, and a force that stays."""
    config = TaskConfig(
        randomisation={"load.mass": {"uniform": (40.0, 40.0)}},
        sensors={"enabled": False},
        references={"weights": {"user": 1.0}, "user": [0.01]},
        disturbance={"kind": "step", "force_range": (400.0, 400.0), "start_range": (0.1, 0.1)},
    )
    run = run_cases(config, make_controller(kind, config), Cases(np.array([1, 2]), np.array([0.1, 4.0])))
    errors = np.abs(run.position - 0.01)
    assert np.all(errors.max(axis=1) > 10e-6)  # the force pushed the axis away
    assert np.all(errors[:, -20:] < 1e-6)


# What every controller with an observer does -------------------------------------------------------------------------
