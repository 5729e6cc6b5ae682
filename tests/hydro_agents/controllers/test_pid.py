"""The PID against its formula, and its behaviour on the axis."""

import numpy as np
import pytest

from hydro_agents.controllers import PID, ObservationLayout, PIDGains
from hydro_agents.running.cases import Cases, run_cases
from hydro_agents.running.tasks import noiseless, own_reference
from hydro_env import TaskConfig
from hydro_env.task.configuration import task_config

CONFIG = TaskConfig()
LAYOUT = ObservationLayout.of(CONFIG)
PLAIN = {"integral": 0.0, "derivative": 0.0, "feedforward_extending": 0.0, "feedforward_retracting": 0.0}


def observation(**si):
    row = np.zeros(len(LAYOUT.names))
    for name, value in si.items():
        row[LAYOUT.index(name)] = value / LAYOUT.scale[LAYOUT.index(name)]
    return row.astype(np.float32)


def test_proportional_part_and_a_start_without_a_bump():
    pid = PID(PIDGains(proportional=30.0, **PLAIN), CONFIG)
    for before, wanted in ((0.0, 0.12), (-0.03, 0.09)):
        action, _ = pid.predict(observation(tracking_error=0.004, previous_command=before))
        assert action.shape == (1,)
        assert action[0] == pytest.approx(wanted, rel=1e-5)


def test_integral_part_grows_by_gain_times_error():
    pid = PID(PIDGains(proportional=0.0, **PLAIN | {"integral": 50.0}), CONFIG)
    memory, command = None, []
    for _ in range(10):
        action, memory = pid.predict(observation(tracking_error=0.002), memory)
        command.append(float(action[0]))
    assert command == pytest.approx([50.0 * 0.002 * 0.005 * (n + 1) for n in range(10)], rel=1e-5)


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


def overlapped(share):
    return task_config(None, plant={"valve": {"overlap": share, "underlap": 0.002}, "friction": {"model": "none"}})


@pytest.mark.parametrize("share", [0.5, 1.0])
def test_the_compensation_adds_a_share_of_the_overlap_beyond_a_ramp_as_wide_as_the_noise(share):
    pid = PID(PIDGains(proportional=100.0, **PLAIN, overlap_compensation=share), overlapped(0.1))
    added, ramp = share * 0.1, 2.0 * 100.0 * CONFIG.sensors.position.noise
    for error, wanted in (
        (0.5 * ramp, 0.5 * (ramp + added)),
        (-ramp, -ramp - added),
        (0.3, 0.3 + added),
        (-0.99, -1.0),
    ):
        action, _ = pid.predict(observation(tracking_error=error / 100.0))
        assert action[0] == pytest.approx(wanted, rel=1e-4)


def test_a_valve_with_an_overlap_of_3_percent_is_no_dead_band_in_the_loop():
    """A proportional loop stands where its command no longer leaves the dead band; compensated, within the ramp.

    The loop begins anywhere in the dead band, so that it may have to cross it as a whole: twice the overlap.
    """
    gain, dead = 100.0, 0.03
    task = task_config(overlapped(dead), randomisation={}, sensors={"position": {"bias": 0.0}})
    still = own_reference(noiseless(task), np.repeat([0.0, 0.01], [20, 1000]))
    ramp = 2.0 * gain * task.sensors.position.noise
    uncovered = ramp * dead / (ramp + dead)
    for share, least, most in ((0.0, dead, 2.0 * dead), (1.0, 0.0, 2.0 * uncovered)):
        pid = PID(PIDGains(proportional=gain, **PLAIN, overlap_compensation=share), task)
        run = run_cases(still, pid, Cases(np.arange(4), np.full(4, 0.01)))
        command = gain * np.abs(run.position - run.reference)[:, -1]
        assert (least <= command).all()
        assert (command <= most).all()
