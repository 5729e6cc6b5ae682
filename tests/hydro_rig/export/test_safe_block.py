"""What an exported controller does with a memory of zeros, a broken wire, a gain that is none, and no start."""

import ctypes
import functools

import numpy as np
import pytest
from exported_code import InC, InPython, assert_it_holds_until_start, at_rest, library

from hydro_agents.controllers.flow_linearising import FlowLinearisingGains
from hydro_agents.controllers.own_loop import LOST_TIME
from hydro_agents.controllers.registry import make_controller
from hydro_agents.learning.loading import shipped
from hydro_agents.running.seeds import VALIDATION_SEEDS
from hydro_env import ServoHydraulicVectorEnv, TaskConfig, equilibrium
from hydro_env.task.configuration import task_config
from hydro_rig.export.controller import controller_code, controller_graph, variable_gains

SEED = VALIDATION_SEEDS.start + 710_900
EXACT = {"sensors": {"enabled": False}, "randomisation": {}, "leakage": {"healthy_range": [1e-3, 2e-3]}}
PAPER, OTHER = "the paper's rig", "a rig from nameplates"
PID_OF_OTHER = {"proportional": 30.0, "integral": 50.0, "feedforward_extending": 2.0, "feedforward_retracting": 2.4}
KINDS = [(kind, rig) for rig in (PAPER, OTHER) for kind in ("pid", "flow_linearising", "ppo")]
MOVES = {PAPER: (-0.03, 0.07), OTHER: (-0.1, 0.1)}  # m, from where to where the axis moves


@pytest.fixture(scope="module")
def made(other_rig):
    """A function: graph and task of a controller on a rig."""
    other = task_config(None, rig=other_rig, control_period="2 ms", command_latency="0.6 ms")
    tasks = {PAPER: TaskConfig(), OTHER: other}

    @functools.cache
    def make(kind, rig):
        task = tasks[rig]
        if kind == "pid" and rig == OTHER:
            controller = make_controller("pid", task, PID_OF_OTHER)
        else:
            controller = shipped(kind, task, lambda *_: FlowLinearisingGains())
        return controller_graph(controller, task), task

    return make


def move_of(rig, task):
    """The task with a move of a second and a half as its reference, and exact sensors."""
    rise = np.clip(np.linspace(-0.2, 1.0, round(1.5 / task.control_period) + 40), 0.0, 1.0)
    begin, end = MOVES[rig]
    move = begin + (end - begin) * (3.0 * rise**2 - 2.0 * rise**3)
    references = {"user": move.tolist(), "weights": {"user": 1.0}}
    return task_config(task, references=references, episode_duration=1.5, **EXACT)


@pytest.fixture(scope="module")
def block(made, tmp_path_factory):
    """A function: a new instance of an exported controller in C, or in Python."""

    @functools.cache
    def in_c(kind, rig):
        return library(tmp_path_factory.mktemp("c"), controller_code(made(kind, rig)[0]).files)

    return lambda language, *which: InC(in_c(*which)) if language == "c" else InPython(made(*which)[0].measured)


# Zeros ---------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("kind", "rig"), KINDS)
def test_a_memory_of_zeros_begins_where_the_axis_rests(kind, rig, made, block):
    graph, task = made(kind, rig)
    for position in np.linspace(-0.1, 0.05, 5) * task.plant.cylinder.stroke:
        voltage = block("c", kind, rig)(at_rest(graph, position), False)
        _, holding = equilibrium(task.plant, position)
        assert voltage == pytest.approx(holding, abs=0.2), f"{1e3 * position:.0f} mm"


# A lost position -----------------------------------------------------------------------------------------------------


def moved(run, graph, task, lost_from):
    """Position (m) and voltage of a move in which the position is lost from one sample on."""
    env = ServoHydraulicVectorEnv(1, task)
    env.reset(seed=[SEED], options={"leakage_flow_lpm": 0.0})
    place = [signal.name for signal in graph.signals.signals].index("position")
    positions, voltages = [], []
    for step in range(task.steps - 1):
        signals = graph.signals.of_axes(env.axes)[0]
        if step >= lost_from:
            signals[place] = np.nan
        voltages.append(run(signals, False))
        positions.append(float(env.axes.column("position")[0]))
        env.step(np.array([[voltages[-1] / 10.0]], dtype=np.float32))
    return np.array(positions), np.array(voltages)


@pytest.mark.parametrize(("kind", "rig"), KINDS)
def test_a_lost_position_in_the_middle_of_a_move_ends_in_a_stand(kind, rig, made, block):
    graph, task = made(kind, rig)
    task = move_of(rig, task)
    lost = int(0.55 * task.steps)
    whole, _ = moved(block("c", kind, rig), graph, task, task.steps)
    assert abs(whole[lost + 1] - whole[lost]) / task.control_period > 0.05  # m/s
    run = block("c", kind, rig)
    positions, voltages = moved(run, graph, task, lost)
    assert np.array_equal(positions[:lost], whole[:lost])
    assert np.abs(positions[lost:] - positions[lost]).max() < 5e-3
    assert np.abs(np.diff(positions[-round(0.1 / task.control_period) :])).max() / task.control_period < 2e-3
    _, holding = equilibrium(task.plant, positions[-1])
    assert voltages[-1] == pytest.approx(holding, abs=0.2)


@pytest.mark.parametrize(("kind", "rig"), KINDS[:2] + KINDS[4:5])
def test_it_says_that_it_holds_and_begins_only_with_start(kind, rig, made, block):
    graph, task = made(kind, rig)
    assert_it_holds_until_start(block("python", kind, rig), graph, round(LOST_TIME / task.control_period))


def test_a_broken_wire_of_a_current_loop_is_a_lost_signal(made):
    graph, _ = made("flow_linearising", PAPER)
    signals, place = at_rest(graph, 0.01), graph.signals.places["position"]
    low, high = graph.signals.signals[place].low, graph.signals.signals[place].high
    for milliampere, lost in ((3.5, True), (3.7, False), (20.3, False), (21.0, True), (0.0, True)):
        signals[place] = low + (milliampere - 4.0) / 16.0 * (high - low)
        _, memory = graph.measured(signals, None)
        assert bool(memory.lost_samples) is lost, milliampere


# What is not a number ------------------------------------------------------------------------------------------------

FLAGS = """#include <fenv.h>
#include "controller.h"
int controller_raises(ControllerMemory *memory, const double *signals, const int *valid, int start, double *voltage)
{
    feclearexcept(FE_ALL_EXCEPT);
    *voltage = controller_step(memory, signals, valid, start, 0);
    return fetestexcept(FE_INVALID | FE_DIVBYZERO | FE_OVERFLOW);
}
"""


@pytest.mark.parametrize(("kind", "rig"), KINDS[:3])
def test_no_signal_and_no_gain_raises_a_floating_point_exception_in_c(kind, rig, made, tmp_path):
    graph, task = made(kind, rig)
    graph = controller_graph(graph.measured.controller, task, variable_gains(graph.measured.controller))
    loaded = library(tmp_path, controller_code(graph).files, {"flags.c": FLAGS})
    step, memory, voltage = loaded.controller_raises, ctypes.create_string_buffer(100_000), ctypes.c_double()
    gains = (ctypes.c_double * len(graph.gains)).in_dll(loaded, "controller_gains") if graph.gains else []
    usual, generator = list(gains), np.random.default_rng(3)
    signals = graph.signals
    middle = np.array([0.5 * (one.low + one.high) for one in signals.signals])
    for number in range(400):
        row = middle + 0.2 * middle * generator.normal(size=len(middle))
        row[generator.integers(len(row))] = generator.choice([np.nan, np.inf, -np.inf, 1.7e308, -2e38, 0.0])
        for place, value in enumerate(usual):
            gains[place] = value
        if gains and number % 3 == 0:
            gains[int(generator.integers(len(usual)))] = generator.choice([np.nan, np.inf, 0.0, -1.0, 1e300])
        valid = np.isfinite(row).astype(np.intc) if number % 2 else np.ones(len(row), np.intc)
        pointers = (array.ctypes.data_as(ctypes.c_void_p) for array in (row, valid))
        raised = step(memory, *pointers, int(number % 20 == 0), ctypes.byref(voltage))
        assert raised == 0, (number, row.tolist(), list(gains))
        assert abs(voltage.value) <= 10.0
