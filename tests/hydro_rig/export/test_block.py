"""What a block does: its states and faults, how it takes over, and what it does when a cable breaks."""

import csv
import functools

import numpy as np
import pytest
from exported_code import InC, InPython, at_rest, closed, library

from hydro_agents.controllers.base import ObservationLayout
from hydro_agents.controllers.flow_linearising import FlowLinearisingGains
from hydro_agents.controllers.own_loop import LOST_TIME
from hydro_agents.controllers.registry import make_controller
from hydro_agents.learning.loading import shipped
from hydro_agents.running.seeds import VALIDATION_SEEDS
from hydro_env import ServoHydraulicVectorEnv, TaskConfig, equilibrium
from hydro_env.task.configuration import task_config
from hydro_rig.export.contract import FaultCode, State
from hydro_rig.export.controller import controller_code, controller_graph

SEED = VALIDATION_SEEDS.start + 710_900
EXACT = {"sensors": {"enabled": False}, "randomisation": {}, "leakage": {"healthy_range": [1e-3, 2e-3]}}
PAPER, OTHER = "the paper's rig", "a rig from nameplates"
PID_OF_OTHER = {"proportional": 30.0, "integral": 50.0, "feedforward_extending": 2.0, "feedforward_retracting": 2.4}
KINDS = [(kind, rig) for rig in (PAPER, OTHER) for kind in ("pid", "flow_linearising", "ppo")]
STARTS = {PAPER: -0.03, OTHER: -0.2}  # m
MOVES = {PAPER: 0.1, OTHER: 0.4}  # m, of a second and a half at least
FAST = {"output_rate": 1e9, "max_speed": 1e9, "max_acceleration": 1e9}
OFF, READY, CONTROLLING, MANUAL, HOLDING, FAULT = State
EVERY_TRANSITION = {
    *((OFF, READY), (OFF, MANUAL), (READY, OFF), (READY, CONTROLLING), (READY, MANUAL), (READY, HOLDING)),
    *((CONTROLLING, OFF), (CONTROLLING, READY), (CONTROLLING, MANUAL), (CONTROLLING, HOLDING), (CONTROLLING, FAULT)),
    *((MANUAL, OFF), (MANUAL, READY), (MANUAL, CONTROLLING), (MANUAL, HOLDING)),
    *((HOLDING, OFF), (HOLDING, READY), (HOLDING, MANUAL), (FAULT, OFF), (FAULT, READY)),
}


@pytest.fixture(scope="module")
def made(other_rig):
    """A function: graph and task of a controller on a rig, with exact sensors."""
    other = task_config(None, rig=other_rig, control_period="2 ms", command_latency="0.6 ms")
    tasks = {PAPER: TaskConfig(), OTHER: other}

    @functools.cache
    def make(kind, rig):
        task = tasks[rig]
        if kind == "pid" and rig == OTHER:
            controller = make_controller("pid", task, PID_OF_OTHER)
        else:
            controller = shipped(kind, task, lambda *_: FlowLinearisingGains())
        return controller_graph(controller, task), task_config(task, episode_duration=3.0, **EXACT)

    return make


@pytest.fixture(scope="module")
def in_c(made, tmp_path_factory):
    """A function: a new block in C."""

    @functools.cache
    def loaded(kind, rig):
        return library(tmp_path_factory.mktemp("c"), controller_code(made(kind, rig)[0]))

    return lambda kind, rig, **options: InC(loaded(kind, rig), made(kind, rig)[0], **options)


class Axis:
    """A simulated axis; ``drive(changes, count)`` lets a block control it, and keeps position and outputs.

    ``at``: its reference, m, a number or one for each sample.
    """

    def __init__(self, run, graph, task, at):
        self.run, self.graph, self.env = run, graph, ServoHydraulicVectorEnv(1, task)
        user = np.full(task.steps + 1 + max(task.preview_samples), at)
        self.env.reset(seed=[SEED], options={"leakage_flow_lpm": 0.0, "reference": user})
        self.positions, self.outputs = [], []

    def inputs(self):
        return {"enable": True, **self.graph.signals.inputs_of(self.env.axes)}

    def drive(self, changes, count):
        for _ in range(count):
            self.outputs.append(self.run({**self.inputs(), **changes}))
            self.positions.append(float(self.env.axes.column("position")[0]))
            self.env.step(np.array([[self.outputs[-1]["command"] / 10.0]]))
        return self.outputs[-1]

    def commands(self):
        return np.array([one["command"] for one in self.outputs])


def states(run, rows):
    return [State(run(row)["state"]) for row in rows]


# States --------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", ["pid", "ppo"])
def test_the_vectors_hold_every_transition_and_every_fault(kind, exported):
    rows = list(csv.DictReader((exported(kind).folder / "vectors.csv").open()))
    found, before = set(), OFF
    for row in rows:
        now = State(int(row["state"]))
        found |= {(OFF if row["start"] == "1" else before, now)}
        before = now
    assert {pair for pair in found if pair[0] != pair[1]} == EVERY_TRANSITION
    without = (
        {FaultCode.NOT_A_NUMBER} if exported(kind).graph.gains else {FaultCode.NOT_A_NUMBER, FaultCode.REFUSED_GAIN}
    )
    assert {int(row["fault_code"]) for row in rows} == {*FaultCode} - without
    command, rate, start = (
        np.array([float(row[name]) for row in rows]) for name in ("command", "output_rate", "start")
    )
    steps = np.abs(np.diff(command))[start[1:] == 0.0]
    allowed = np.where(rate > 0.0, rate, 1000.0)[1:][start[1:] == 0.0] * 0.005
    assert (steps <= allowed * (1.0 + 1e-12)).all()  # also at each transition


def test_nothing_moves_without_a_new_request(made):
    graph, task = made("flow_linearising", PAPER)
    row = at_rest(graph, equilibrium(task.plant, 0.01)[0])
    stop, closes, by_hand = {**row, "enable": False}, {**row, "control": True}, {**row, "manual": True}
    run = InPython(graph)
    assert states(run, [closes, closes, row, closes]) == [READY, READY, READY, CONTROLLING]
    assert states(run, [{**closes, "enable": False}, closes, closes, row, closes]) == [OFF, *[READY] * 3, CONTROLLING]
    assert states(run, [{**by_hand, "enable": False}, by_hand, row, by_hand, stop]) == [OFF, READY, READY, MANUAL, OFF]
    lost = {**closes, "valid_position": False}
    states(run, [row, closes])
    assert states(run, [lost] * (round(LOST_TIME / task.control_period) + 1))[-2:] == [CONTROLLING, HOLDING]
    assert states(run, [closes, row, closes, {**lost, "reset": True}]) == [HOLDING] * 4
    assert states(run, [{**closes, "reset": True}, closes, {**closes, "reset": True}]) == [HOLDING, HOLDING, READY]
    assert states(run, [row, closes, {**closes, "lost_limit": 5, "error_limit": 1e-9, "position": 0.0101}])[-1] == FAULT
    assert run({**by_hand, "error_limit": 1e-9})["fault_code"] == FaultCode.FOLLOWING_ERROR
    assert states(run, [closes, stop, by_hand, {**row, "reset": True}]) == [FAULT, FAULT, FAULT, READY]


def test_zeros_are_off_and_command_nothing(in_c, made):
    graph, task = made("flow_linearising", PAPER)
    run, row = in_c("flow_linearising", PAPER, reset=False), at_rest(graph, equilibrium(task.plant, 0.01)[0], 0.05)
    zeros = {each.name: each.kind() for each in graph.inputs}
    assert run(zeros)["state"] == OFF
    assert [run({**zeros, **row, "control": closes})["state"] for closes in (False, True)] == [READY, CONTROLLING]
    assert run({**zeros, **row, "control": True})["command"] == 0.0


class Exploding:
    """A controller whose command is no number once the pressure is high."""

    def __init__(self, config):
        self.layout = ObservationLayout.of(config)

    def predict(self, observation, state=None, episode_start=None, deterministic=True):
        count = np.zeros_like(observation[:, 0]) if state is None else state + np.float32(1.0)
        pressure = self.layout.si(observation, "pressure_a")
        return (np.sqrt(60e5 - pressure) / np.sqrt(60e5 - pressure) * 0.01 * count)[:, None], count


def test_a_command_that_is_no_number_is_a_fault(tmp_path):
    graph = controller_graph(Exploding(TaskConfig()), TaskConfig())
    row = {"enable": True, "valid_position": True, "pressure_a": 1e5, "valid_pressure_a": True}
    runs = InPython(graph), InC(library(tmp_path, controller_code(graph)), graph)
    for run in runs:
        closed(run, row)
        last = run({**row, "control": True})
        found = run({**row, "control": True, "pressure_a": 90e5})
        assert (found["state"], found["fault_code"]) == (FAULT, FaultCode.NOT_A_NUMBER)
        assert last["command"] > found["command"] == 0.0
        assert run({**row, "control": True})["state"] == FAULT


# Take-over and reference ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("kind", "rig"), KINDS)
@pytest.mark.parametrize("distance", [0.001, 0.01])
def test_it_takes_over_without_a_bump_from_any_reference(kind, rig, distance, made, in_c):
    graph, task = made(kind, rig)
    axis = Axis(in_c(kind, rig), graph, task, STARTS[rig])
    axis.drive({}, 2)
    axis.drive({"manual": True, "manual_command": 0.3}, 40)
    target = axis.positions[-1] + distance
    axis.drive({"control": True, "reference": target}, round(2.0 / task.control_period))
    bumps = np.abs(np.diff(axis.commands()[41:44]))
    assert bumps.max() < 0.35
    assert abs(axis.positions[-1] - target) < 1e-3


def test_it_takes_over_an_axis_in_motion_on_a_rig_that_nobody_tuned(made, in_c):
    graph, task = made("flow_linearising", OTHER)
    samples = np.arange(task.steps + 1 + max(task.preview_samples))
    ramp = np.clip(0.05 * task.control_period * (samples - 100.0), 0.0, None)  # m
    driver, axis = in_c("flow_linearising", OTHER), Axis(in_c("flow_linearising", OTHER), graph, task, ramp)
    for step in range(450):
        request = {"follow": True, "control": step > 0}
        by_hand = driver({**axis.inputs(), **request})["command"]
        axis.drive({**request, "manual": 0 < step < 250, "manual_command": by_hand}, 1)
    assert [State(axis.outputs[step]["state"]) for step in (249, 250)] == [MANUAL, CONTROLLING]
    assert (axis.positions[250] - axis.positions[249]) / task.control_period == pytest.approx(0.05, rel=0.2)
    assert np.abs(np.diff(axis.commands()[248:255])).max() < 0.15
    assert np.abs(axis.positions - ramp[:450])[250:].max() < 3e-4


def test_the_integral_does_not_wind_up_at_a_low_output_limit(made, in_c):
    graph, task = made("pid", PAPER)
    axis = Axis(in_c("pid", PAPER), graph, task, 0.0)
    axis.drive({}, 2)
    slow = {"control": True, "reference": 0.02, "output_limit": 2.0, "max_speed": 1.0, "max_acceleration": 50.0}
    axis.drive(slow, 400)
    assert np.abs(axis.commands()).max() == 2.0
    assert max(axis.positions) < 0.0205
    assert axis.positions[-1] == pytest.approx(0.02, abs=2e-4)


def test_the_internal_reference_goes_from_the_axis_to_its_target_within_its_limits(made, in_c):
    graph, task = made("flow_linearising", PAPER)
    axis, period = Axis(in_c("flow_linearising", PAPER), graph, task, 0.0), task.control_period
    limits = {"max_speed": 0.04, "max_acceleration": 0.5, "control": True}
    axis.drive({}, 2)
    axis.drive({**limits, "reference": 0.02}, 150)
    axis.drive({**limits, "reference": -0.01}, 30)
    axis.drive({**limits, "reference": 0.02}, 250)
    path = np.array([one["internal_reference"] for one in axis.outputs[2:]])
    speed = np.diff(path) / period
    assert path[0] == pytest.approx(axis.positions[2], abs=1e-4)
    assert np.abs(speed).max() == pytest.approx(0.04, rel=1e-6)
    assert np.abs(np.diff(speed)).max() <= 0.5 * period * (1.0 + 1e-6)
    assert path[149] == 0.02
    assert path[-1] == 0.02


def test_it_joins_a_motion_exactly(made):
    graph, task = made("flow_linearising", PAPER)
    run, (state, _) = InPython(graph), equilibrium(task.plant, 0.0)
    given = 0.008 + 0.03 * task.control_period * np.arange(400)
    found = []
    for step in range(300):
        row = at_rest(graph, state)
        for signal in graph.signals.signals:
            if not signal.sensor:
                row[signal.name] = given[step + signal.ahead]
        found.append(run({**row, "control": step > 0, "follow": True})["internal_reference"])
    gap = np.array(found) - given[:300]
    assert found[1] == pytest.approx(0.0, abs=1e-9)
    assert (
        np.abs(np.diff(found[1:])).max()
        <= (0.03 + next(row.default for row in graph.inputs if row.name == "max_speed")) * 0.0051
    )
    assert (gap[-50:] == 0.0).all()


def test_a_correction_of_0_is_flow_linearisation_bit_for_bit(made):
    policy, task = made("ppo", PAPER)
    base = controller_graph(policy.block.base, TaskConfig())
    axis, other = Axis(InPython(policy), policy, task, 0.0), InPython(base)
    for step in range(120):
        row = {**axis.inputs(), "control": step > 0, "reference": 0.02 if step < 60 else 0.0}
        found = axis.run({**row, "correction_limit": 0.0})
        assert found["command"] == other(row)["command"]
        assert found["correction"] == 0.0
        axis.env.step(np.array([[found["command"] / 10.0]]))
    assert axis.run({**row, "correction_limit": 10.0})["correction"] != 0.0


# A lost position -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("kind", "rig"), KINDS)
def test_a_lost_position_in_the_middle_of_a_move_ends_in_a_stand(kind, rig, made, in_c):
    graph, task = made(kind, rig)
    axis, per_second = Axis(in_c(kind, rig), graph, task, STARTS[rig]), round(1.0 / task.control_period)
    axis.drive({}, 2)
    axis.drive({"control": True, "reference": STARTS[rig] + MOVES[rig]}, per_second)
    assert abs(axis.positions[-1] - axis.positions[-2]) / task.control_period > 0.03  # m/s
    lost = len(axis.positions)
    last = axis.drive({"control": True, "reference": STARTS[rig] + MOVES[rig], "valid_position": False}, per_second)
    assert last["state"] == HOLDING
    assert np.abs(np.array(axis.positions[lost:]) - axis.positions[lost]).max() < 5e-3
    assert np.abs(np.diff(axis.positions[-per_second // 10 :])).max() / task.control_period < 2e-3
    _, holding = equilibrium(task.plant, axis.positions[-1])
    assert last["command"] == pytest.approx(holding, abs=0.2)


def test_a_broken_wire_of_a_current_loop_is_a_lost_signal(made):
    graph, task = made("flow_linearising", PAPER)
    row = at_rest(graph, equilibrium(task.plant, 0.01)[0])
    place = [signal.name for signal in graph.signals.signals].index("position")
    low, high = graph.signals.signals[place].low, graph.signals.signals[place].high
    for milliampere, lost in ((3.5, True), (3.7, False), (20.3, False), (21.0, True), (0.0, True)):
        found = InPython(graph)({**row, "position": low + (milliampere - 4.0) / 16.0 * (high - low)})
        assert found["lost_signals"] == (2**place if lost else 0), milliampere


# What is not a number ------------------------------------------------------------------------------------------------

FLAGS = """#include <fenv.h>
#include "controller.h"
int controller_raises(Controller *block)
{
    feclearexcept(FE_ALL_EXCEPT);
    controller_step(block);
    return fetestexcept(FE_INVALID | FE_DIVBYZERO | FE_OVERFLOW);
}
"""


@pytest.mark.parametrize(("kind", "rig"), KINDS[:3])
def test_no_input_raises_a_floating_point_exception_in_c(kind, rig, made, tmp_path):
    graph, task = made(kind, rig)
    loaded = library(tmp_path, controller_code(graph), {"flags.c": FLAGS})
    run, generator = InC(loaded, graph), np.random.default_rng(3)
    usual = at_rest(graph, equilibrium(task.plant, 0.01)[0])
    numbers = [row.name for row in graph.inputs if row.kind is float]
    for number in range(600):
        row = {**usual, "control": number % 20 > 1, "reset": number % 3 == 0}
        for _ in range(generator.integers(1, 3)):
            name = numbers[generator.integers(len(numbers))]
            row[name] = generator.choice([np.nan, np.inf, -np.inf, 1.7e308, -2e38, 0.0, -1.0])
            if number % 2:
                row[f"valid_{name}"] = False
        run.fill(row)
        assert loaded.controller_raises(run.buffer) == 0, (number, row)
        assert abs(run.self.command) <= 10.0
