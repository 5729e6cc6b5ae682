"""The PID against its formula, and its behaviour on the axis."""

import numpy as np
import pytest

from hydro_agents.controllers import PID, ObservationLayout, PIDGains
from hydro_agents.running.cases import Cases, run_cases
from hydro_agents.running.folders import config_folder
from hydro_env import ConfigurationError, TaskConfig

CONFIG = TaskConfig()
LAYOUT = ObservationLayout.of(CONFIG)
PLAIN = {"integral": 0.0, "derivative": 0.0, "feedforward_extending": 0.0, "feedforward_retracting": 0.0}


def observation(**si):
    row = np.zeros(len(LAYOUT.names))
    for name, value in si.items():
        row[LAYOUT.index(name)] = value / LAYOUT.scale[LAYOUT.index(name)]
    return row.astype(np.float32)


def test_proportional_part():
    pid = PID(PIDGains(proportional=30.0, **PLAIN), CONFIG)
    action, _ = pid.predict(observation(tracking_error=0.004))
    assert action.shape == (1,)
    assert action[0] == pytest.approx(0.12, rel=1e-5)


def test_integral_part_grows_by_gain_times_error():
    pid = PID(PIDGains(proportional=0.0, **PLAIN | {"integral": 50.0}), CONFIG)
    memory, command = None, []
    for _ in range(10):
        action, memory = pid.predict(observation(tracking_error=0.002), memory)
        command.append(float(action[0]))
    assert command == pytest.approx([50.0 * 0.002 * 0.005 * (n + 1) for n in range(10)], rel=1e-5)


def test_starts_without_a_bump():
    pid = PID(PIDGains(**PLAIN), CONFIG)
    action, _ = pid.predict(observation(previous_command=-0.03))
    assert action[0] == pytest.approx(-0.03, rel=1e-5)


def test_feedforward_takes_the_speed_from_the_preview_and_knows_the_direction():
    gains = PIDGains(proportional=0.0, **PLAIN | {"feedforward_extending": 5.0, "feedforward_retracting": 8.0})
    pid = PID(gains, CONFIG)
    for speed, gain in ((0.06, 5.0), (-0.06, 8.0)):
        ahead = {f"reference_preview_{1e3 * t:g}ms": speed * t for t in LAYOUT.preview_times}
        _, at_rest = pid.predict(observation())
        action, _ = pid.predict(observation(**ahead), at_rest)
        assert action[0] == pytest.approx(gain * speed, rel=1e-4)
        taken_over, _ = pid.predict(observation(previous_command=0.4, **ahead))
        assert taken_over[0] == pytest.approx(0.4, rel=1e-5)


def test_a_jump_of_the_reference_does_not_wind_up_the_integral():
    pid = PID(
        PIDGains(proportional=0.0, **PLAIN | {"feedforward_extending": 5.0, "feedforward_retracting": 5.0}), CONFIG
    )
    jump = {f"reference_preview_{1e3 * t:g}ms": -0.01 for t in LAYOUT.preview_times if t > 0.005}
    _, at_rest = pid.predict(observation())
    action, memory = pid.predict(observation(**jump), at_rest)
    assert action[0] == -1.0
    assert memory.integral[0] == 0.0


def test_anti_windup_lets_the_integral_recover():
    error = observation(tracking_error=0.03)
    recovery = {}
    for time in (0.01, 1e1):
        pid = PID(PIDGains(proportional=50.0, **PLAIN | {"integral": 500.0}, anti_windup_time=time), CONFIG)
        memory = None
        for _ in range(100):
            action, memory = pid.predict(error, memory)
        assert action[0] == 1.0
        steps = 0
        while action[0] > 0.0 and steps < 500:
            action, memory = pid.predict(observation(tracking_error=-0.002), memory)
            steps += 1
        recovery[time] = steps
    assert recovery[0.01] < 0.2 * recovery[1e1]


def test_batch_equals_single_and_episode_start_resets():
    generator = np.random.default_rng(0)
    batch = (0.1 * generator.standard_normal((30, 4, len(LAYOUT.names)))).astype(np.float32)
    pid = PID(PIDGains(), CONFIG)
    memory, alone = None, [None] * 4
    for row in batch:
        together, memory = pid.predict(row, memory)
        for axis in range(4):
            action, alone[axis] = pid.predict(row[axis], alone[axis])
            assert action[0] == together[axis, 0]
    restarted = np.array([False, True, False, False])
    together, _ = pid.predict(batch[0], memory, restarted)
    fresh, _ = pid.predict(batch[0, 1])
    assert together[1, 0] == fresh[0]


def test_shipped_gains_hold_the_axis_at_every_leak():
    pid = PID(PIDGains.from_yaml(config_folder() / "agents" / "pid.yaml"), CONFIG)
    cases = Cases(np.arange(16), np.repeat([0.01, 4.0], 8), np.array(["point_to_point"] * 16))
    run = run_cases(CONFIG, pid, cases)
    assert (run.failed_at < 0).all()
    assert 1e3 * np.abs(run.position - run.reference).mean() < 0.2


def test_wrong_gains_are_named(tmp_path):
    file = tmp_path / "pid.yaml"
    file.write_text("proportional: -3\n")
    with pytest.raises(ConfigurationError, match=r"pid.yaml: line 1: proportional = -3: .*within 0 to"):
        PIDGains.from_yaml(file)
    with pytest.raises(ConfigurationError, match="holds no 'flow'"):
        LAYOUT.index("flow")
