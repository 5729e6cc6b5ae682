"""The model predictive controller against known answers: LQ without limits, bounded least squares with them."""

import numpy as np
import pytest
from scipy.optimize import lsq_linear

from hydro_agents.controllers.lqg import LQG, LQGGains
from hydro_agents.controllers.mpc import MPC, MPCGains
from hydro_agents.controllers.observer_feedback import ObserverState
from hydro_agents.learning.loading import shipped
from hydro_agents.running.cases import Cases, run_cases
from hydro_agents.running.tasks import noiseless, own_reference
from hydro_env import TaskConfig
from hydro_env.task.configuration import task_config

TASK = TaskConfig()
AXES = 5


def situation(controller, size, seed=0):
    """Estimates and references of some axes at pressures of the middle, of a size in m; and the flow there."""
    generator = np.random.default_rng(seed)
    scale = size * np.array([1.0, 20.0, 4e3, 20.0, 4e3, 20.0, 3.0, 400.0, 1.0])
    estimate = scale * generator.standard_normal((AXES, 9))
    reference = np.cumsum(0.3 * size * generator.standard_normal((AXES, controller.preview.horizon + 2)), axis=1)
    command, supply = 20.0 * size * generator.standard_normal(AXES), np.full(AXES, 70e5)
    state = ObserverState(estimate, command, supply, np.tile([1.0, 1.0, 0.0], (AXES, 1)), reference)
    return state, controller.flow.at(np.zeros(AXES), np.full((2, AXES), 40e5), supply)


@pytest.mark.parametrize("horizon", [0.5, 6.0, 15.0])
@pytest.mark.parametrize("task", [TASK, task_config("no_preview")])
def test_without_limits_its_speeds_are_those_of_the_lq_regulator(horizon, task):
    mpc, lqg = MPC(MPCGains(horizon=horizon), task), LQG(LQGGains(), task)
    now, flow = situation(mpc, 2e-5)
    error = now.estimate[:, 0] - now.reference[:, 1]
    known = lqg.speed(now.estimate, error, now.command_before, np.diff(now.reference, axis=1))
    np.testing.assert_allclose(mpc.wanted(now, flow, np.zeros(AXES)), known, rtol=1e-8, atol=1e-10)


def test_within_limits_its_speed_is_that_of_a_bounded_least_squares_problem_of_many_periods():
    """The same cost over 200 periods, with the limits in those of the horizon, from the impulse response of the model.

    The small terms of the disturbances are left out, so that they need no model here.
    """
    mpc, many = MPC(MPCGains(), TASK), 200
    now, flow = situation(mpc, 6e-3)
    now.estimate[:, 6:] = 0.0
    m, horizon = mpc.model, len(mpc._program.hessian)
    one = type(flow)(*(values[:1] for values in flow))
    limits = [float(mpc.flow.speed(np.array([end]), one)[0]) for end in (-1.0, 1.0)]
    answer, bounded = mpc.wanted(now, flow, np.zeros(AXES)), 0
    for axis in range(AXES):
        start = now.estimate[axis].copy()
        ahead = now.reference[axis, 2:]
        last = now.reference[axis, -1] - now.reference[axis, -2]
        last = last if abs(last) <= mpc.jump else 0.0  # no axis goes on at such a speed
        reference = np.concatenate([ahead, ahead[-1] + last * np.arange(1, many - len(ahead) + 1)])

        def positions(commands, before, start=start):
            state, found = start, []
            for command in commands:
                state = m.transition @ state + m.input_old * before + m.input_new * command
                before = command
                found.append(state[0])
            return np.array(found)

        free = positions(np.zeros(many), now.command_before[axis])
        pulse = positions(np.eye(many)[0], 0.0, np.zeros(9))
        effect = np.array([[pulse[k - j] if k >= j else 0.0 for j in range(many)] for k in range(many)])
        differences = np.eye(many) - np.eye(many, k=-1)
        matrix = np.concatenate([mpc.weight * effect, differences])
        target = np.concatenate([mpc.weight * (reference - free), np.zeros(many)])
        target[many] = now.command_before[axis]
        within = np.arange(many) < horizon
        low, high = np.where(within, limits[0], -np.inf), np.where(within, limits[1], np.inf)
        best = lsq_linear(matrix, target, (low, high), tol=1e-14, lsq_solver="exact").x[0]
        assert answer[axis] == pytest.approx(best, abs=1e-4 * mpc.full_speed)
        bounded += abs(lsq_linear(matrix, target).x[0] - best) > 0.01 * mpc.full_speed
    assert bounded >= 3


def test_on_the_plant_of_the_data_sheet_a_move_settles_without_overshoot():
    exact = task_config(TASK, randomisation={}, sensors={"position": {"bias": 0.0}})
    task = own_reference(noiseless(exact), np.repeat([0.0, 0.03], [20, 300]))
    run = run_cases(task, shipped("mpc", task), Cases(np.arange(3), np.full(3, 0.01)))
    error = run.position - run.reference
    assert np.abs(error[:, -60:]).max() < 20e-6
    assert (run.position.max(axis=1) < 0.0301).all()
    jump = np.flatnonzero(np.diff(run.reference[0]))[0]
    assert (np.abs(run.command[:, jump - 4]) > 0.5).all()  # it sets off before the jump
    assert np.abs(error[:, jump + 60 :]).max() < 20e-6
