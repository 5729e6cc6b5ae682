"""A controller for a rig that nobody tuned: the command, its C code on that rig, and a take-over in motion."""

import numpy as np
import pytest
from command_line import assert_one_clear_line, hydro
from exported_code import InC, library, sources_in

from hydro_agents.controllers.flow_linearising import FlowLinearising, FlowLinearisingGains
from hydro_agents.learning.loading import shipped
from hydro_agents.running.seeds import VALIDATION_SEEDS
from hydro_env import ServoHydraulicVectorEnv, TaskConfig
from hydro_env.task.configuration import task_config
from hydro_rig.export.controller import controller_graph

TIMING = ("--period", "2ms", "--latency", "0.6ms")
SEED = VALIDATION_SEEDS.start + 710_500
TAKE_OVER = 250  # control periods; the axis is in motion then
RAMP = 0.05  # m/s
BUMP = 0.15  # V


@pytest.fixture(scope="module")
def task(other_rig):
    """Its task with the timing of the PLC, and a ramp as reference."""
    ramp = np.clip(RAMP * 0.002 * (np.arange(1001) - 100.0), 0.0, None)
    changes = {"references": {"user": ramp.tolist(), "weights": {"user": 1.0}}}
    return task_config(None, rig=other_rig, control_period="2 ms", command_latency="0.6 ms", **changes)


@pytest.fixture(scope="module")
def folder(other_rig):
    """What the command wrote for the rig."""
    out = other_rig.parent / "controller"
    answer = hydro("export", "flow_linearising", "--rig", other_rig, *TIMING, "--output", out)
    assert answer.returncode == 0, answer.stderr
    assert "gains for any rig" in answer.stdout
    assert answer.stderr == ""
    return out


@pytest.fixture(scope="module")
def in_c(folder, task, tmp_path_factory):
    """A function: a new instance of the exported C code."""
    graph = controller_graph(FlowLinearising(FlowLinearisingGains(), task), task)
    loaded = library(tmp_path_factory.mktemp("untuned"), sources_in(folder))

    def new():
        run = InC(loaded, graph)
        run.graph = graph
        return run

    return new


def test_it_is_made_for_this_rig_and_timing_with_the_gains_for_any(folder, task):
    assert shipped("flow_linearising", task).gains == FlowLinearisingGains()
    assert shipped("flow_linearising", TaskConfig()).gains != FlowLinearisingGains()  # the paper's rig has its own


def test_in_c_it_takes_over_an_axis_in_motion(task, in_c):
    driving, run = FlowLinearising(FlowLinearisingGains(), task), in_c()
    env = ServoHydraulicVectorEnv(1, task)
    observation, _ = env.reset(seed=[SEED + 1])
    memory, commands, errors = None, [], []
    for step in range(TAKE_OVER + 200):
        action, memory = driving.predict(observation, memory)
        row = run.graph.signals.inputs_of(env.axes) | {
            "enable": True,
            "follow": True,
            "manual": 0 < step < TAKE_OVER,
            "control": step > 0,
        }
        commands.append(run({**row, "manual_command": 10.0 * float(action[0, 0])})["command"])
        observation, *_ = env.step(np.array([[commands[-1] / 10.0]], dtype=np.float32))
        errors.append(driving.layout.si(observation, "tracking_error")[0])
    assert driving.layout.si(observation, "velocity_estimate")[0] == pytest.approx(RAMP, rel=0.2)
    assert np.abs(np.diff(commands[TAKE_OVER - 2 : TAKE_OVER + 5])).max() < BUMP
    assert np.abs(errors[TAKE_OVER:]).max() < 3e-4


@pytest.mark.parametrize(
    ("arguments", "what"),
    [
        (("flow_linearising", "--period", "2 bar"), "export flow_linearising: --period = '2 bar': unit 'bar'"),
        (("flow_linearising", "--latency", "26ms"), "--latency = 0.026 s must not exceed 5 times --period = 0.005 s"),
        (("plant", "--latency", "1ms"), "export plant: takes no --period and no --latency"),
    ],
)
def test_bad_input_is_one_line(arguments, what, tmp_path):
    assert_one_clear_line(hydro("export", *arguments, "--output", tmp_path / "out"), what)
    assert not (tmp_path / "out").exists()
