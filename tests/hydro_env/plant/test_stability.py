"""Nothing leaves the model's validity over the whole randomised range; stiff plants get the steps that they need."""

import numpy as np
import pytest

from hydro_env import PlantParameters, equilibrium, simulate
from hydro_env.axes import Axes
from hydro_env.plant.kernel import FIRST_STEP, STABLE_PRODUCT, STAGES
from hydro_env.plant.linearisation import fastest_motion
from hydro_env.plant.simulate import valid_ranges
from hydro_env.plant.states import TYPICAL_SIZE
from hydro_env.plant.workable import fastest_rate
from hydro_env.task.configuration import task_config
from hydro_env.task.record import FAILURES

COUNT, STEPS, SAMPLES = 128, 400, 8


def lively_actions(rng, count, steps):
    """Commands of three characters: white noise, held levels, and full opening held long enough to meet an end stop."""
    noise = rng.uniform(-1, 1, (steps, count))
    held = np.repeat(rng.uniform(-1.2, 1.2, (steps // 20, count)), 20, axis=0)
    full = np.repeat(np.sign(rng.uniform(-1, 1, (steps // 200, count))), 200, axis=0)
    kind = np.arange(count) % 3
    return np.where(kind == 0, noise, np.where(kind == 1, held, full))


@pytest.fixture(scope="module")
def rollout():
    """States (sample, axis, 10) of randomised plants along lively rollouts, the axes, and all failures met."""
    axes = Axes(task_config(None), COUNT)
    for axis in range(COUNT):
        axes.seed(axis, np.random.default_rng([11, axis]))
    axes.begin(np.arange(COUNT))
    states, failures, worst = [], set(), 0.0
    rng = np.random.default_rng(12)
    for step, action in enumerate(lively_actions(rng, COUNT, STEPS)):
        axes.step(action)
        failures |= set(np.unique(axes.column("failure")).astype(int))
        worst = max(worst, np.abs(axes.observation / axes.limit).max())
        assert np.isfinite(axes.observation).all()
        assert np.isfinite(axes.column("reward")).all()
        if step % (STEPS // SAMPLES) == 7:
            states.append(axes.state.copy())
    return np.array(states), axes, failures, worst


def test_the_stable_product_is_that_of_the_method():
    """|R(z)| ≤ 1 along rays of the left half-plane up to it, and not much beyond."""
    size = len(STAGES)
    a = np.zeros((size, size))
    for row, weights in enumerate(STAGES[:-1], 1):
        a[row, : len(weights)] = weights
    ones, b = np.ones(size), np.array(STAGES[-1])

    def amplification(z):
        return abs(1.0 + z * b @ np.linalg.solve(np.eye(size) - z * a, ones))

    rays = np.exp(1j * np.radians([180, 150, 120, 105]))
    assert max(amplification(h * ray) for ray in rays for h in np.linspace(0.01, STABLE_PRODUCT, 200)) < 1.0 + 1e-9
    assert max(amplification(1.15 * STABLE_PRODUCT * ray) for ray in rays) > 1.0


STIFF = {
    "friction": {"friction": {"transition_velocity": 1e-4}},
    "oil": {
        "cylinder": {"dead_volume": 1e-6, "stroke": 0.01},
        "fluid": {"bulk_modulus": 1e10, "air_fraction": 0.0},
        "load": {"mass": 5.0},
    },
    "light mass": {"load": {"mass": 1.0}, "cylinder": {"piston_mass": 0.2}},
    "spool": {"valve": {"natural_frequency": 5000.0, "damping_ratio": 2.0}},
}


@pytest.mark.parametrize("changes", STIFF.values(), ids=STIFF)
def test_stiff_plants_get_the_shorter_steps_that_they_need(changes):
    """The first step tried is unstable for them; the integrator shortens it, and meets the implicit solver."""
    parameters = PlantParameters().replace(**changes)
    rest, _ = equilibrium(parameters)
    rate, _ = fastest_motion(parameters, np.array(list(rest.values())))
    assert FIRST_STEP * rate > 3.5
    assert fastest_rate(parameters)[0] > 0.95 * rate
    voltage = np.repeat([0.5, -0.5, 0.0], 2)
    fast, exact = (simulate(parameters, voltage, 5e-3, method=method) for method in ("fast", "radau"))
    size = np.maximum(np.ptp(exact.states, axis=0), 0.01 * TYPICAL_SIZE)
    assert (np.abs(fast.states - exact.states).max(axis=0) / size).max() < 1e-3


def test_no_state_leaves_its_valid_range(rollout):
    states, axes, failures, worst = rollout
    assert np.isfinite(states).all()
    names = {FAILURES[code] for code in failures}
    assert not any("valid range" in name for name in names)
    assert "end stop hit at speed" in names  # the rollouts reach the ends of the stroke
    for axis in range(0, COUNT, 16):
        low, high = valid_ranges(axes.parameters(axis))
        assert ((states[:, axis] >= low) & (states[:, axis] <= high)).all()
    assert worst <= 1.0
    assert np.abs(states[..., 4]).max() <= 1.0  # spool stroke
