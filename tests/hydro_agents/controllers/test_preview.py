"""The rebuilt preview is the true future reference."""

import numpy as np
import pytest

from hydro_agents.controllers.base import ObservationLayout
from hydro_agents.controllers.preview import Preview, braked, path_weights
from hydro_env import ServoHydraulicVectorEnv, TaskConfig
from hydro_env.task.reference_signals import MOVING_FAMILIES

FAMILIES = list(MOVING_FAMILIES)


@pytest.mark.parametrize(
    "options",
    [
        {},
        {"control_period": 2e-3},
        {"control_period": 0.01},  # two of the four previews show the same sample
        {"references": {"preview_times": [0.02]}},
        {"references": {"preview_times": []}},
    ],
)
def test_after_its_horizon_it_knows_every_sample(options):
    config = TaskConfig(episode_duration=0.8, sensors={"enabled": False}, **options)
    env = ServoHydraulicVectorEnv(len(FAMILIES), config, info=False)
    observation, _ = env.reset(seed=5, options={"reference": FAMILIES})
    preview, truth = Preview(config), env.axes.reference.copy()
    assert preview.horizon == max(config.preview_samples, default=0)
    samples = preview.start(observation)
    moved = np.zeros(len(FAMILIES))
    for step in range(1, config.steps - 1):
        observation, *_ = env.step(np.zeros((len(FAMILIES), 1)))
        samples = preview.advanced(samples, observation)
        assert samples.shape == (len(FAMILIES), preview.horizon + 2)
        if step >= max(preview.horizon, 1):
            np.testing.assert_allclose(samples, truth[:, step - 1 : step + preview.horizon + 1], atol=2e-8)
            moved = np.maximum(moved, np.ptp(samples, axis=1))
    assert (moved > 1e-4).all() or preview.horizon == 0  # the references moved meanwhile


def test_at_the_start_the_axis_has_rested_and_samples_in_between_are_interpolated():
    preview = Preview(TaskConfig(references={"preview_times": [0.01, 0.03]}))
    row = np.zeros((1, 11))
    row[0, :3] = 0.4, 0.1, 0.9  # reference in 0.1 m, previews in 0.01 m
    np.testing.assert_allclose(1e3 * preview.start(row), [[40.0, 40.0, 40.5, 41.0, 43.0, 45.0, 47.0, 49.0]])


def test_way_to_a_time():
    steps = np.array([0.5, 1.0, 2.0, 4.0])  # before now, and three periods ahead
    ways = {-1.0: -0.5, -0.4: -0.2, 0.0: 0.0, 0.25: 0.25, 1.0: 1.0, 2.5: 5.0, 3.0: 7.0, 3.5: 9.0}
    for periods, way in ways.items():
        assert steps @ path_weights(0.005 * periods, 3, 0.005) == pytest.approx(way)
    assert steps[:1] @ path_weights(0.01, 0, 0.005) == pytest.approx(1.0)  # without a preview: at the last speed


def test_a_preview_tells_the_time_of_the_sample_that_it_shows():
    times = [ObservationLayout.of(TaskConfig(control_period=period)).preview_times for period in (2e-3, 5e-3, 10e-3)]
    assert times[0] == pytest.approx((0.004, 0.01, 0.02, 0.04))
    assert times[1] == (0.005, 0.01, 0.02, 0.04)
    assert times[2] == (0.01, 0.01, 0.02, 0.04)


def test_braking_is_a_root_and_joins_smoothly():
    near, small = 2e-3, 1e-9
    error = np.array([-near / 2, near / 2, near - small, near + small, 8.5 * near])
    reduced = braked(error, near)
    np.testing.assert_allclose(reduced[:2], error[:2])
    assert (reduced[3] - reduced[2]) / (2 * small) == pytest.approx(1.0, rel=1e-3)
    assert reduced[4] == pytest.approx(4.0 * near)
