"""A controller and its block as a graph, traced from measured signals to volts, and this graph as C99."""

import re
from collections.abc import Callable, Mapping
from copy import copy
from dataclasses import dataclass, replace
from types import SimpleNamespace
from typing import Any, Self

import numpy as np

from hydro_agents.controllers.base import Controller
from hydro_agents.controllers.flow_linearising import FlowLinearising
from hydro_agents.controllers.pid import PID
from hydro_agents.controllers.registry import GainRow, gain_rows
from hydro_env import TaskConfig, __version__
from hydro_env.types import ByName
from hydro_rig.export.block import Block
from hydro_rig.export.c_files import c_code
from hydro_rig.export.c_writer import Writer, declaration
from hydro_rig.export.contract import OUTPUTS, BlockInput, MeasuredSignals, State
from hydro_rig.export.graph import Graph, Kind, Node, in_order, in_single, needed
from hydro_rig.export.tracing import TraceError, named, trace

STARTED, CONTINUED = "started.", "continued."
GAINS, OUTPUT, ANSWER = "gains.", "output.", "answer."
VARIABLE_GAINS = {
    PID: (
        *("proportional", "integral", "derivative", "derivative_filter_time", "feedforward_extending"),
        *("feedforward_retracting", "anti_windup_time"),
    ),
    FlowLinearising: ("position_gain", "braking", "force_rate", "damping_filter", "friction"),
}
"""Gains that may change while the exported code runs: it has the effect of a new controller with this gain. The others
are part of numbers that a controller computes when it is made, or decisions."""


@dataclass(frozen=True)
class ControllerGraph:
    """A block with its controller as a graph.

    Inputs: those of the block by name, ``gains.NAME``, the parts of the memory, and ``answer.NAME``: what the
    controller answers. Outputs: ``controls`` (whether the controller answers at all) and ``begins`` (whether it starts
    here), ``output.NAME`` and the parts of the memory. Answers and the controller's own parts of the memory occur
    twice: with the prefix ``started.`` for a start, ``continued.`` for a continuation. An answer of 0 stands where the
    controller gives none.
    """

    graph: Graph
    memory: tuple[Node, ...]  # the inputs of the graph that hold its parts
    block: Block
    gains: list[GainRow]  # inputs ``gains.NAME``: numbers that may change while the controller runs
    inputs: list[BlockInput]  # of the block, and its gains

    @property
    def signals(self) -> MeasuredSignals:
        """The signals that it reads."""
        return self.block.signals

    @property
    def real(self) -> Kind:
        """Type of its numbers."""
        return self.graph.inputs["output_limit"].kind

    def in_single(self) -> Self:
        """The same block in single precision."""
        graph = in_single(self.graph)
        return replace(self, graph=graph, memory=tuple(graph.inputs[part.name] for part in self.memory))

    @property
    def outputs(self) -> list[str]:
        """Names of its outputs."""
        return [*self.case(OUTPUT), *self.block.answers[1:]]

    @property
    def common(self) -> dict[str, Node]:
        """The outputs of the block, and its memory but that of the controller."""
        return {name: node for name, node in self.graph.outputs.items() if not name.startswith((STARTED, CONTINUED))}

    def case(self, prefix: str) -> dict[str, Node]:
        """The other outputs of a start or of a continuation."""
        outputs = self.graph.outputs.items()
        return {name.removeprefix(prefix): node for name, node in outputs if name.startswith(prefix)}


def controller_graph(controller: Controller, config: TaskConfig) -> ControllerGraph:
    """Trace a controller and its block; :func:`variable_gains` become inputs.

    Raises:
        TraceError: the controller contains data-dependent decisions that no fixed graph can represent.
        ConfigurationError: the observation cannot be computed from measured signals.
    """
    who, gains = type(controller).__name__, variable_gains(controller)
    block = Block(controller, MeasuredSignals(config, entries_read(controller, config)))
    inputs = [*block.inputs, *(BlockInput(GAINS + g.name, g.meaning, float, float(g.value)) for g in gains)]
    empty = block.empty()
    zeros = leaves_of(empty)

    def step(**values: Any) -> ByName:
        refused: Any = np.False_
        variable = {}
        for gain in gains:
            present_gain = values[GAINS + gain.name]
            within = np.logical_and(present_gain >= gain.low, present_gain <= gain.high)
            refused = np.logical_or(refused, np.logical_not(within))
            variable[gain.name] = named(f"{gain.name}_used", np.where(within, present_gain, float(gain.value)))
        varied = copy(block)
        if variable:
            changed: Any = copy(controller)
            changed.gains = SimpleNamespace(**{**dict(changed.gains), **variable})
            varied.controller = changed
        memory = with_leaves(empty, values)
        sample = varied.before(values, memory)
        outputs: ByName = {"controls": sample.controls, "begins": sample.begins}
        for prefix, before in ((STARTED, None), (CONTINUED, memory.controller)):
            answer, new = varied.answer(sample.observation, values, before)
            outputs |= {prefix + ANSWER + name: value for name, value in answer.items()}
            outputs |= {prefix + name: leaf for name, leaf in leaves_of({"controller": new}).items()}
        found, new_memory = varied.after(sample, values, memory, values[f"{ANSWER}wanted"], refused)
        outputs |= {OUTPUT + name: value for name, value in found.items()}
        return outputs | leaves_of(new_memory)

    given: ByName = {row.name: np.array(row.default, row.kind) for row in inputs}
    given |= {ANSWER + name: np.zeros(()) for name in block.answers}
    graph = trace(step, {**given, **zeros})
    after, _ = controller.predict(np.zeros((1, len(block.signals.layout.names)), np.float32), None)
    if not isinstance(after, np.ndarray):
        raise TraceError(f"{who}: keeps its memory outside its state: cannot be exported")
    for name, before in zeros.items():
        own = name.startswith("controller")
        for case in (STARTED + name, CONTINUED + name) if own else (name,):
            node = graph.outputs.get(case)
            if node is None or (node.size, node.kind) != (before.size, before.dtype):
                raise TraceError(f"{who}: its memory '{name}' changes its shape or type: cannot be exported")
    return ControllerGraph(graph, tuple(graph.inputs[name] for name in zeros), block, gains, inputs)


def variable_gains(controller: Any) -> list[GainRow]:
    """The gains that can be changed while the exported code runs."""
    names = set(VARIABLE_GAINS.get(type(controller), ()))
    if isinstance(controller, PID) and controller.gains.overlap_compensation * controller.config.plant.valve.overlap:
        names.discard("proportional")  # the compensation of the overlap is as wide as the noise that it makes
    return [row for row in gain_rows(controller.gains) if row.name in names] if names else []


def entries_read(controller: Controller, config: TaskConfig) -> set[str]:
    """Names of the entries of the observation on which the commands of a controller depend, now or later.

    Raises:
        TraceError: as :func:`controller_graph`.
    """
    signals = MeasuredSignals(config)
    empty = Block(controller, signals).empty().controller
    memory = leaves_of(empty, "memory")

    def predict(**values: Any) -> ByName:
        outputs = {}
        observation = np.stack([values[name] for name in signals.layout.names])[None]
        for prefix, before in ((STARTED, None), (CONTINUED, with_leaves(empty, values, "memory"))):
            outputs[f"{prefix}command"], new = controller.predict(observation, before)
            outputs |= {prefix + name: leaf for name, leaf in leaves_of(new, "memory").items() if name in memory}
        return outputs

    graph = trace(predict, {**dict.fromkeys(signals.layout.names, np.array(0.0, np.float32)), **memory})
    wanted, before = {"command"}, set[str]()
    while wanted != before:
        before = wanted
        used = needed([graph.outputs[prefix + name] for prefix in (STARTED, CONTINUED) for name in wanted])
        wanted = wanted | {name for name in memory if graph.inputs[name] in used}
    return {name for name in signals.layout.names if graph.inputs[name] in used}


def leaves_of(memory: Any, name: str = "") -> ByName:
    """The arrays of a memory by name; it consists of named tuples, tuples, lists and dictionaries.

    Raises:
        TraceError: the memory contains other objects.
    """
    leaves: ByName = {}
    _rebuilt(memory, name, leaves.__setitem__)
    return leaves


def with_leaves(memory: Any, leaves: ByName, name: str = "") -> Any:
    """The memory with other arrays; the inverse of :func:`leaves_of`."""
    return _rebuilt(memory, name, lambda place, array: leaves[place].reshape(array.shape))


def _rebuilt(memory: Any, name: str, leaf: Callable[[str, Any], Any]) -> Any:
    """The memory with what a function of name and array gives in place of each array."""
    if memory is None:
        return None
    if hasattr(memory, "dtype"):
        return leaf(name, memory)
    parts = memory._asdict() if hasattr(memory, "_asdict") else memory
    if isinstance(parts, tuple | list):
        parts = dict(enumerate(parts))
    if not isinstance(parts, dict):
        raise TraceError(f"{name or 'memory'}: {type(memory).__name__} holds no arrays: cannot be exported")
    new = [_rebuilt(part, f"{name}.{key}" if name else str(key), leaf) for key, part in parts.items()]
    if isinstance(memory, dict):
        return dict(zip(memory, new, strict=True))
    return type(memory)(*new) if hasattr(memory, "_fields") else type(memory)(new)


# As text -----------------------------------------------------------------------------------------------------------


def controller_code(controller: ControllerGraph, name: str = "Controller") -> dict[str, str]:
    """C sources of a block by file; ``name`` begins every symbol, so that one program can hold several."""
    texts = {part.name: f"self->{field(part.name)}" for part in controller.memory}
    texts |= {row.name: f"self->{row.name}" for row in controller.inputs}
    outputs = {name: f"self->{name}" for name in controller.outputs}
    writer = Writer(controller.graph, {}, taken=("self", "wanted"))
    values = facts_of(controller, name) | written_step(controller, writer, texts, outputs)
    return c_code(c_name(name), values, "controller")


def c_name(name: str) -> str:
    """What begins the names of functions and files of a block with a name: ``LiftAxis`` → ``lift_axis``."""
    return re.sub(r"(?<=[a-z0-9])(?=[A-Z])", "_", name).lower()


def facts_of(controller: ControllerGraph, name: str) -> ByName:
    """What all templates say about a block with a name."""
    return {
        "name": name,
        "prefix": c_name(name),
        "title": f"Controller of a hydraulic servo axis ({type(controller.block.controller).__name__})",
        "version": __version__,
        "graph": controller,
        "block": controller.block,
        "config": controller.signals.config,
        "states": State,
        "outputs": [(output, *OUTPUTS[output]) for output in controller.outputs],
        "whole": ("state", "fault_code", "lost_signals"),
    }


def written_step(
    controller: ControllerGraph, writer: Writer, texts: Mapping[str, str], outputs: Mapping[str, str]
) -> ByName:
    """What the templates of C and Structured Text write beside the facts: tables, memory, the statements of a step.

    These are ``common``, then those of a start or of a continuation or ``idle`` ones, then ``after``. ``texts``: the
    variable of each input of the graph and part of the memory by name; ``outputs``: of each output, of which some are
    parts of the memory too.
    """
    shared, language = controller.common, writer.language
    parts = {part.name: part for part in controller.memory}
    texts = {**texts, **{name: outputs[name] for name in parts if name in outputs}}
    answers = {ANSWER + name: outputs.get(name, name) for name in controller.block.answers}
    writer.inputs = {**texts, **answers}
    before, last = _around_answers(controller)

    def store(new: Mapping[str, Node], lines: list[str]) -> None:
        """Add statements that keep what changes in the memory, after all values of it are read."""
        stored = []
        for name, node in new.items():
            if name in parts and node is not parts[name]:
                variable = writer.kept(f"new_{field(name)}", node, lines)
                stored.append(writer.stored(texts[name], variable, node.size))
        lines += stored

    def case(new: dict[str, Node]) -> str:
        """The statements of a case."""
        lines = writer.statements([node for node in in_order([*new.values()]) if node not in before])
        for name, text in answers.items():
            lines.append(language.assign.format(text, writer.element(new[name], 0)))
        store(new, lines)
        writer.release(*new.values())
        return "\n".join(lines)

    common = writer.statements(before)
    for name in ("controls", "begins"):
        writer.kept(name, shared[name], common)
    cases = {"started": case(controller.case(STARTED)), "continued": case(controller.case(CONTINUED))}
    idle = [language.assign.format(text, language.number(0.0)) for text in answers.values()]
    after = writer.statements(last)
    store(shared, after)
    for name, text in outputs.items():
        if name not in parts and OUTPUT + name in shared:
            after.append(language.assign.format(text, writer.element(shared[OUTPUT + name], 0)))
    return {
        **cases,
        "common": "\n".join(common),
        "idle": "\n".join(idle),
        "after": "\n".join(after),
        "tables": writer.tables,
        "real": language.types[controller.real],
        "types": {kind: language.types[np.dtype(kind)] for kind in (bool, int)}
        | {float: language.types[controller.real]},
        "parts": [
            declaration(language, field(part.name), part.size, part.kind)
            for part in controller.memory
            if part.name not in outputs
        ],
    }


def _around_answers(controller: ControllerGraph) -> tuple[list[Node], list[Node]]:
    """What start and continuation share: nodes before the controller's answers, and those that follow from them."""
    later = set(in_order([*controller.case(CONTINUED).values()]))
    both = [node for node in in_order([*controller.case(STARTED).values()]) if node in later]
    following = {controller.graph.inputs[ANSWER + name] for name in controller.block.answers}
    before, after = [], []
    for node in in_order([*controller.common.values(), *both]):
        if following.isdisjoint(operand.whole for operand in node.operands):
            before.append(node)
        else:
            following.add(node)
            after.append(node)
    return before, after


def field(name: str) -> str:
    """Name of the variable of a part of the memory."""
    plain = re.sub(r"\W", "_", name.removeprefix("controller."))
    return f"own_{plain}" if name.startswith("controller.") else f"{plain}_before"
