"""A controller for a rig that nobody tuned: the command, its C code on that rig, and a take-over in motion."""

import numpy as np
import pytest
from command_line import assert_one_clear_line, hydro

from hydro_agents.controllers.flow_linearising import FlowLinearisingGains
from hydro_agents.learning.loading import shipped
from hydro_env import TaskConfig
from hydro_env.task.configuration import task_config

TIMING = ("--period", "2ms", "--latency", "0.6ms")
RAMP = 0.05  # m/s


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


def test_it_is_made_for_this_rig_and_timing_with_the_gains_for_any(folder, task):
    page = " ".join((folder / "README.md").read_text(encoding="utf-8").split())
    assert "every 2.0 ms" in page
    assert "from 0.6 ms after it" in page
    assert "Origin: gains for any rig, which nobody tuned for this one." in page
    assert shipped("flow_linearising", task).gains == FlowLinearisingGains()
    assert shipped("flow_linearising", TaskConfig()).gains != FlowLinearisingGains()  # the paper's rig has its own


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
