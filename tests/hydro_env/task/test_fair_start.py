"""The start in the sensor's frame, drawn latencies, forces as shares of the supply's, and the reward's frames."""

import numpy as np

from hydro_env import ServoHydraulicVectorEnv
from hydro_env.task.reference_signals import REFERENCE_FAMILIES
from hydro_env.task.sensors import CHANNELS

COUNT, PERIOD = 400, 5e-3
POSITION = CHANNELS.index("position")
ZERO = np.zeros((COUNT, 1), np.float32)


def begun(options=None, seed=3, **config):
    envs = ServoHydraulicVectorEnv(COUNT, **config)
    first, _ = envs.reset(seed=seed, options=options)
    return envs, first


def errors(envs):
    return envs.axes.column("reference") - envs.axes.column("position")


def test_an_episode_begins_where_the_sensor_reads_the_reference():
    envs, first = begun()
    bias = envs.axes.column("bias")[:, POSITION]
    np.testing.assert_allclose(errors(envs), bias, rtol=0, atol=1e-12)
    assert 0.9 * 80e-6 < np.abs(bias).max() <= 80e-6
    place = envs.axes.observation_names.index("tracking_error")
    # Noise of 30 µm and half a step of the acquisition remain; nothing of the bias does.
    assert abs(0.01 * first[:, place].mean()) < 4 * 30e-6 / np.sqrt(COUNT)
    assert abs(np.corrcoef(first[:, place], bias)[0, 1]) < 4 / np.sqrt(COUNT)
    actual, first = begun(start="actual")
    assert np.corrcoef(first[:, place], actual.axes.column("bias")[:, POSITION])[0, 1] < -0.7  # which tells the bias
    exact, _ = begun(sensors={"enabled": False})
    for envs in (actual, exact):
        np.testing.assert_array_equal(errors(envs), 0.0)
    np.testing.assert_array_equal(exact.axes.column("bias"), 0.0)


def test_a_drawn_latency_delays_the_command_as_a_configured_one_does():
    drawn, _ = begun(command_latency_range=(0.5e-3, 5e-3))
    latency = drawn.axes.column("latency").copy()
    assert 0.5e-3 <= latency.min() < 0.55e-3 < 4.95e-3 < latency.max() <= 5e-3
    chosen = int(np.argmax(latency))
    configured, _ = begun(command_latency=float(latency[chosen]))
    for envs in (drawn, configured):
        for _ in range(5):
            envs.step(ZERO + 0.3)
    np.testing.assert_array_equal(drawn.axes.state[chosen], configured.axes.state[chosen])
    others = latency < latency[chosen] - 1e-4
    assert (drawn.axes.state[others, 0] != configured.axes.state[others, 0]).all()
    np.testing.assert_array_equal(begun()[0].axes.column("latency"), 1e-3)


def test_the_reward_may_leave_out_the_bias_and_weigh_families():
    factors = {"step": 5.0, "sine": 0.5}
    plain, _ = begun()
    sensor, _ = begun(reward={"frame": "sensor", "family_scale": factors})
    for envs in (plain, sensor):
        for _ in range(20):
            envs.step(ZERO)
    axes = sensor.axes
    np.testing.assert_array_equal(axes.column("position"), plain.axes.column("position"))
    families = axes.column("reference_family").astype(int)
    scale = np.array([0.01 * factors.get(name, 1.0) for name in REFERENCE_FAMILIES])[families]
    seen = np.abs(errors(sensor) - axes.column("bias")[:, POSITION])
    np.testing.assert_allclose(axes.column("costs")[:, 0], np.minimum(seen / scale, 5.0), rtol=1e-12)
    np.testing.assert_allclose(plain.axes.column("costs")[:, 0], np.minimum(np.abs(errors(plain)) / 0.01, 5.0))
