"""Disturbing forces: what acts when, and what it does to the axis."""

import numpy as np
import pytest

from hydro_env import ServoHydraulicEnv, ServoHydraulicVectorEnv, simulate
from hydro_env.plant.states import STATE_NAMES

PERIOD = 5e-3


def forces(steps=100, count=40, plant=None, **disturbance):
    """External force in the middle of each period (step, axis), and the drawn amplitude, start and frequency."""
    envs = ServoHydraulicVectorEnv(count, disturbance=disturbance, episode_duration=steps * PERIOD, plant=plant or {})
    envs.reset(seed=0, options={"reference": "step", "initial_position": 0.0})
    axes = envs.axes
    drawn = [axes.column(name).copy() for name in ("force_amplitude", "force_start_time", "force_frequency")]
    rows = []
    for _ in range(steps):
        envs.step(np.zeros((count, 1)))
        rows.append([axes.external_force(axis) for axis in range(count)])
    return np.array(rows), *drawn


def middle(steps=100):
    return PERIOD * (np.arange(steps)[:, None] + 0.5)


@pytest.mark.parametrize(
    ("kind", "settings"),
    [
        ("step", {"force_range": [200.0, 1000.0]}),
        ("pulse", {"force_range": [200.0, 1000.0], "pulse_duration": 0.05}),
        ("sine", {"force_range": [200.0, 1000.0], "frequency_range": [1.0, 5.0]}),
    ],
)
def test_what_acts_when(kind, settings):
    force, amplitude, start, frequency = forces(kind=kind, plant={"load": {"external_force": 50.0}}, **settings)
    since = middle() - start
    shape = np.sin(2 * np.pi * frequency * since) if kind == "sine" else 1.0
    inside = (since >= 0.0) & (since < (0.05 if kind == "pulse" else np.inf))
    np.testing.assert_allclose(force, 50.0 + np.where(inside, amplitude * shape, 0.0), rtol=0, atol=1e-9)
    size = np.abs(amplitude)
    assert 200.0 <= size.min() < 300.0 < 900.0 < size.max() <= 1000.0
    assert 10 <= (amplitude > 0).sum() <= 30
    assert 0.2 * 0.5 <= start.min() <= start.max() <= 0.6 * 0.5
    if kind == "sine":
        assert 1.0 <= frequency.min() < 1.5 < 4.5 < frequency.max() <= 5.0
    if kind == "pulse":
        assert set(inside.sum(axis=0)) <= {9, 10, 11}


def test_a_disturbed_axis_moves_as_the_plant_with_that_force():
    env = ServoHydraulicEnv(
        disturbance={"kind": "step", "force_range": [800.0, 800.0], "start_range": [0.0, 0.0]}, command_latency=0.0
    )
    env.reset(seed=2, options={"initial_position": 0.01, "reference": "step"})
    start = dict(zip(STATE_NAMES, env.axes.state[0], strict=True))
    force = env.axes.column("force_amplitude")[0]
    run = simulate(env.parameters.replace(load={"external_force": force}), np.full(30, 1.0), PERIOD, start)
    positions = [env.step(np.full(1, 0.1))[-1]["position"] for _ in range(30)]
    np.testing.assert_allclose(positions, run.position[1:], rtol=0, atol=1e-12)
    assert abs(positions[-1] - 0.01) > 1e-4
