"""A controller in a loop that is not ours: the same commands as in the environment, and lost samples."""

import numpy as np
import pytest

from hydro_agents.controllers.flow_linearising import FlowLinearisingGains
from hydro_agents.controllers.own_loop import LOST_TIME, OwnLoop
from hydro_agents.controllers.pid import PIDGains
from hydro_agents.detection.monitor import HeadDetector
from hydro_agents.learning.loading import shipped
from hydro_env import ConfigurationError, ServoHydraulicVectorEnv, TaskConfig
from hydro_env.task.configuration import task_config
from hydro_env.task.sensors import CHANNELS

TASK = TaskConfig()
UNITS = np.array([1e-3, 1e5, 1e5, 1e-2])


def driven(controller, periods=300, si=True, head=None, family="multi_sine", task=TASK):
    """Voltages of the environment's own loop, those of :class:`OwnLoop` with the same signals, and this loop."""
    env = ServoHydraulicVectorEnv(1, task, info=False)
    fitted = [name for name in CHANNELS if getattr(task.sensors, name).fitted]
    observation, _ = env.reset(seed=[3], options={"reference": [family], "leakage_flow_lpm": [1.0]})
    loop = OwnLoop(controller, task, head=head, si=si)
    loop.reset(10.0 * env.axes.column("command")[0])
    theirs, ours, memory, watching, leak = [], [], None, None, None
    for step in range(periods):
        samples = env.axes.column("measured")[0] / (1.0 if si else UNITS)
        wanted = env.axes.reference[0, step + np.array([0, *task.preview_samples])] / (1.0 if si else 1e-3)
        read = dict(zip(CHANNELS, map(float, samples), strict=True))
        ours.append(loop.step(wanted, **{name: read[name] for name in fitted}))
        if head is not None:
            leak, watching = head.predict(observation, watching)
        action, memory = loop.controller.predict(observation, memory)
        theirs.append(10.0 * float(np.clip(np.float64(action[0, 0]), -1.0, 1.0)))
        observation, *_ = env.step(action)
    env.close()
    if head is not None:
        np.testing.assert_array_equal(loop.leak, leak)
        assert np.isfinite(loop.leak).all() == (periods >= head.settings.window)
    return np.array(theirs), np.array(ours), loop


@pytest.mark.parametrize("kind", ["pid", "flow_linearising", "ppo"])
def test_it_gives_the_commands_of_the_environment_bit_for_bit(kind):
    theirs, ours, loop = driven(kind)
    np.testing.assert_array_equal(ours, theirs)
    assert np.ptp(ours) > 0.5
    assert (loop.lost, loop.holding) == (0, False)


def rig(period=0.002, latency=0.0006, absent=(), **more):
    sensors = {name: {"fitted": False} for name in absent}
    return task_config(
        None, rig="symmetric_eha", control_period=period, command_latency=latency, sensors=sensors, **more
    )


@pytest.mark.parametrize(
    ("kind", "task"),
    [
        ("ppo", rig()),
        ("ppo", rig(absent=["spool_position"])),
        ("flow_linearising", rig(0.001, 0.0, absent=["spool_position"])),
        ("flow_linearising", rig(0.010, 0.012)),
        ("pid", rig(absent=["pressure_b"])),
        ("pid", rig(absent=["pressure_a", "pressure_b", "spool_position"])),
    ],
    ids=[
        "any axis",
        "any axis, no spool",
        "1 ms, no spool",
        "10 ms, later than that",
        "no pressure b",
        "position alone",
    ],
)
def test_other_rigs_sensors_and_periods_give_the_commands_of_the_environment(kind, task):
    usual = {"pid": PIDGains(proportional=20.0), "flow_linearising": FlowLinearisingGains()}  # a choice takes a minute
    controller = shipped(kind, task, lambda name, _: usual[name])
    theirs, ours, loop = driven(controller, min(300, task.steps), task=task)
    np.testing.assert_array_equal(ours, theirs)
    assert np.ptp(ours) > 0.5
    assert (loop.lost, loop.holding) == (0, False)


def test_engineering_units_differ_by_rounding_alone():
    theirs, ours, _ = driven("flow_linearising", si=False)
    np.testing.assert_allclose(ours, theirs, atol=1e-4)


def test_the_head_reads_what_it_reads_in_the_environment():
    driven("pid", periods=TASK.steps - 1, head=HeadDetector.load().on(TASK))


def at_rest(loop, **changed):
    return loop.step(0.0, **{"position": 0.0, "pressure_a": 30.0, "pressure_b": 40.0, "spool_position": 0.0, **changed})


@pytest.mark.parametrize("value", [None, np.nan, 1e4])
def test_a_lost_sample_is_bridged_and_a_lasting_loss_holds_the_axis(value):
    loop = OwnLoop("pid", TASK)
    at_rest(loop)
    at_rest(loop, position=value)
    assert (loop.lost, loop.holding) == (1, False)
    at_rest(loop)
    assert loop.lost == 0
    voltages = [at_rest(loop, position=value) for _ in range(round(LOST_TIME / TASK.control_period) + 3)]
    assert loop.holding
    assert voltages[-1] == pytest.approx(10.0 * float(loop._at_rest))
    at_rest(loop)
    assert loop.holding
    loop.reset()
    at_rest(loop)
    assert not loop.holding


def test_before_the_first_complete_sample_the_valve_keeps_its_voltage():
    loop = OwnLoop(shipped("pid", TASK), TASK)
    loop.reset(volts=0.3)
    assert at_rest(loop, pressure_a=None) == pytest.approx(0.3)
    assert loop.step(None, position=0.0, pressure_a=30.0, pressure_b=40.0, spool_position=0.0) == pytest.approx(0.3)


@pytest.mark.parametrize(("reference", "signals"), [(0.0, {"pressure": 1.0}), ([0.0, 1.0], {"position": 0.0})])
def test_a_wrong_call_is_refused(reference, signals):
    with pytest.raises(ConfigurationError, match="own loop"):
        OwnLoop("pid", TASK).step(reference, **signals)
