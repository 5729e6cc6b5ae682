"""What the transducers make of the truth: noise, bias, steps, limits, delay; and how the observation is laid out."""

import numpy as np
import pytest
from scipy import stats

from hydro_env import ServoHydraulicEnv, ServoHydraulicVectorEnv, equilibrium
from hydro_env.task.sensors import CHANNELS, SENSORS, Sensors
from hydro_env.task.settings import ERROR_INTEGRAL_LIMIT, ERROR_INTEGRAL_TIME

PERIOD = 5e-3
IDEAL = {"noise": 0.0, "bias": 0.0, "resolution": 0.0}


def of_channel(axes, field, name):
    """``measured`` or ``bias`` of one channel, shape (N,)."""
    return axes.column(field)[:, CHANNELS.index(name)]


def sensors(**channels):
    """Settings of ideal transducers, some of them changed."""
    default = Sensors()
    ends = {name: {"low": getattr(default, name).low, "high": getattr(default, name).high} for name in SENSORS}
    return {name: {**ends[name], **IDEAL, **channels.get(name, {})} for name in SENSORS}


def errors(count, **config):
    """Measured minus true value of each channel of many axes at rest, and the axes."""
    envs = ServoHydraulicVectorEnv(count, **config)
    envs.reset(seed=0)
    axes = envs.axes
    true = dict(zip(SENSORS, axes.state[:, [0, 2, 3, 4]].T, strict=True))
    return {name: of_channel(axes, "measured", name) - true[name] for name in SENSORS}, axes


@pytest.mark.parametrize("name", SENSORS)
def test_noise_is_normal_and_bias_uniform_as_configured(name):
    own = getattr(Sensors(), name)
    assert min(own.noise, own.bias) > 0.0
    error, _ = errors(4000, sensors=sensors(**{name: {"noise": own.noise}}))
    assert stats.kstest(error[name] / own.noise, "norm").pvalue > 1e-3
    assert error[name].std() == pytest.approx(own.noise, rel=4 / np.sqrt(2 * 4000))
    for other, row in zip(SENSORS, (0.4, 100e5, 400e5, 2.0), strict=True):
        assert other == name or np.abs(error[other]).max() < 1e-14 * row
        if other in ("position", "pressure_a", "pressure_b"):  # 4–20 mA over 500 Ω, on 16 bits of ±10 V
            assert row / getattr(Sensors(), other).resolution == pytest.approx(26214.4)
    error, axes = errors(3000, sensors=sensors(**{name: {"bias": own.bias}}))
    assert stats.kstest(error[name] / own.bias, stats.uniform(-1, 2).cdf).pvalue > 1e-3
    np.testing.assert_allclose(of_channel(axes, "bias", name), error[name], rtol=1e-6, atol=1e-12)


@pytest.mark.parametrize("name", SENSORS)
def test_readings_lie_on_the_steps_of_the_acquisition(name):
    sensor = getattr(Sensors(), name)
    error, axes = errors(500)
    steps = (of_channel(axes, "measured", name) - sensor.low) / sensor.resolution
    assert np.abs(steps - np.round(steps)).max() < 1e-6
    assert len(np.unique(np.round(steps))) > 20
    exact, _ = errors(500, sensors=sensors(**{name: {"resolution": sensor.resolution}}))
    assert np.abs(exact[name]).max() <= 0.5 * sensor.resolution * (1 + 1e-6)
    assert np.abs(exact[name]).max() > 0.4 * sensor.resolution
    assert np.abs(error[name]).max() < sensor.bias + 6 * sensor.noise


def test_readings_stay_within_the_range_of_the_transducer():
    narrow = {"low": 18e5, "high": 20e5, "noise": 3e5}
    error, axes = errors(2000, sensors=sensors(pressure_a=narrow))
    reading = of_channel(axes, "measured", "pressure_a")
    assert reading.min() == 18e5
    assert reading.max() == 20e5
    assert np.abs(error["pressure_a"]).max() > 1e6
    # Quantisation must not lead out of the range either, where its end is no step.
    _, axes = errors(2000, sensors=sensors(pressure_a={**narrow, "resolution": 0.7e5}))
    assert of_channel(axes, "measured", "pressure_a").max() <= 20e5


def test_pressure_transducers_lag_as_a_first_order_system():
    """Against the closed form: a jump decays with τ = rise time / ln 9, a ramp is followed τ late."""
    rise = 0.02
    env = ServoHydraulicEnv(sensors={**sensors(), "pressure_rise_time": rise}, randomisation={}, command_latency=0.0)
    env.reset(seed=0)
    tau = rise / np.log(9.0)
    times = np.linspace(0.0, PERIOD, 2001)
    rng = np.random.default_rng(0)
    expected = {name: env.axes.column(f"true_{name}")[0] for name in "ab"}
    last = dict(expected)
    seen = 0.0
    for _ in range(60):
        observation = env.step(rng.uniform(-1, 1, 1))[0]
        for name, row in (("a", 2), ("b", 3)):
            new = env.axes.state[0, row]
            # y' = (p(t) − y)/τ, p linear between the samples: y(T) = ∫ p(s) exp(−(T−s)/τ)/τ ds + y(0) exp(−T/τ).
            pressure = last[name] + (new - last[name]) * times / PERIOD
            integral = np.trapezoid(pressure * np.exp(-(PERIOD - times) / tau) / tau, times)
            expected[name] = integral + expected[name] * np.exp(-PERIOD / tau)
            last[name] = new
            measured = of_channel(env.axes, "measured", f"pressure_{name}")[0]
            assert measured == pytest.approx(expected[name], rel=1e-5)
            index = env.observation_names.index(f"pressure_{name}")
            assert observation[index] * env.observation_scale[index] == pytest.approx(measured, rel=1e-6)
            seen = max(seen, abs(measured - new))
    assert seen > 1e5  # the lag matters in this run


def test_velocity_estimate_of_a_steady_move():
    """A filtered difference: exact at constant speed, with the time constant of the filter on the way there."""
    plant = {"load": {"spring_stiffness": 0.0}, "supply": {"model": "constant"}}
    env = ServoHydraulicEnv(sensors={"enabled": False}, plant=plant, randomisation={})
    _, info = env.reset(seed=0, options={"initial_position": -0.1, "reference": "step"})
    index = env.observation_names.index("velocity_estimate")
    blend = PERIOD / (PERIOD + 0.010)
    estimate, position = 0.0, info["position"]
    for _ in range(120):
        observation, _, _, _, info = env.step(np.array([0.5]))
        estimate += blend * ((info["position"] - position) / PERIOD - estimate)
        position = info["position"]
        assert observation[index] * env.observation_scale[index] == pytest.approx(estimate, abs=1e-7)
    assert info["velocity"] > 0.05
    assert estimate == pytest.approx(info["velocity"], rel=1e-4)


def test_error_integral_is_leaky_and_limited():
    env = ServoHydraulicEnv(sensors={"enabled": False}, episode_duration=10.0)
    _, info = env.reset(seed=0, options={"reference": np.full(2000, 0.02), "initial_position": 0.0})
    index = env.observation_names.index("error_integral")
    integral, reached = 0.0, 0.0
    while True:
        position = info["position"]
        observation, _, terminated, truncated, info = env.step(np.array([0.5 * (-0.02 - position) / 0.02]))
        assert not terminated
        integral += PERIOD * (info["tracking_error"] - integral / ERROR_INTEGRAL_TIME)
        integral = np.clip(integral, -ERROR_INTEGRAL_LIMIT, ERROR_INTEGRAL_LIMIT)
        assert observation[index] * env.observation_scale[index] == pytest.approx(integral, abs=1e-8)
        reached = max(reached, integral)
        if truncated:
            break
    assert reached == ERROR_INTEGRAL_LIMIT


def test_switched_off_sensors_tell_the_exact_truth():
    env = ServoHydraulicEnv(sensors={"enabled": False}, command_latency=0.0)
    rng = np.random.default_rng(0)
    observation, info = env.reset(seed=3)
    rest, voltage = equilibrium(env.parameters, info["position"])
    command = voltage / 10.0
    for step in range(50):
        state = env.axes.state[0]
        si = dict(zip(env.observation_names, observation * env.observation_scale, strict=True))
        expected = {
            "position": state[0],
            "pressure_a": state[2],
            "pressure_b": state[3],
            "spool_position": state[4],
            "reference": info["reference"],
            "tracking_error": info["reference"] - state[0],
            "previous_command": command,
        }
        if step == 0:  # the equilibrium
            expected |= {name: rest[name] for name in ("pressure_a", "pressure_b", "spool_position")}
            expected |= {"velocity_estimate": 0.0, "error_integral": 0.0}
        for name, value in expected.items():
            exact = {"rel": 2e-7, "abs": 1e-9} if step else {"rel": 1e-6, "abs": 1e-7}
            assert si[name] == pytest.approx(value, **exact), name
        assert (info["position"], info["velocity"]) == (state[0], state[1])
        action = rng.uniform(-1, 1, 1)
        command = action[0]
        observation, _, _, _, info = env.step(action)
