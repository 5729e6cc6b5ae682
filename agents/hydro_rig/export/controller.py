"""A controller as a graph, traced from measured signals to volts, and this graph as C99."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from copy import copy
from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any

import numpy as np

from hydro_agents.controllers.base import Controller
from hydro_agents.controllers.flow_linearising import FlowLinearising
from hydro_agents.controllers.pid import PID
from hydro_agents.controllers.registry import GainRow, gain_rows
from hydro_env import TaskConfig, __version__
from hydro_rig.export.c_files import CCode, c_code
from hydro_rig.export.c_writer import C_TYPES, Writer
from hydro_rig.export.graph import Graph, Node, in_order, needed
from hydro_rig.export.measured import LOST_RULE, MeasuredController, MeasuredSignals
from hydro_rig.export.tracing import TraceError, named, trace

STARTED, CONTINUED = "started.", "continued."
GAINS = "gains."
INPUTS = ("signals", "valid", "start", "lost_limit")
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
    """A controller as a graph.

    Inputs: :data:`INPUTS` and the parts of the memory. Outputs: ``begins`` (whether the controller starts
        here), ``lost`` (number of lost signals), and the parts that are the same in both cases. ``voltage`` and the
        other parts occur twice: with the prefix ``started.`` for a start, ``continued.`` for a continuation.
    """

    graph: Graph
    memory: tuple[Node, ...]  # the inputs of the graph that hold its parts
    measured: MeasuredController
    gains: tuple[GainRow, ...] = ()  # inputs ``gains.NAME``: numbers that may change while the controller runs

    @property
    def signals(self) -> MeasuredSignals:
        """The signals that it reads."""
        return self.measured.signals

    @property
    def title(self) -> str:
        """What it is, in one line."""
        return f"Controller of a hydraulic servo axis ({type(self.measured.controller).__name__})"

    @property
    def common(self) -> dict[str, Node]:
        """The outputs that are the same in both cases."""
        return {name: node for name, node in self.graph.outputs.items() if not name.startswith((STARTED, CONTINUED))}

    def case(self, prefix: str) -> dict[str, Node]:
        """The other outputs of a start or of a continuation."""
        outputs = self.graph.outputs.items()
        return {name.removeprefix(prefix): node for name, node in outputs if name.startswith(prefix)}


def controller_graph(controller: Controller, config: TaskConfig, gains: Sequence[GainRow] = ()) -> ControllerGraph:
    """Trace a controller.

    Args:
        controller: the controller.
        config: its task.
        gains: those that become inputs of the graph, of :func:`variable_gains`; the others are constants in it.

    Raises:
        TraceError: the controller contains data-dependent decisions that no fixed graph can represent.
        ConfigurationError: the observation cannot be computed from measured signals.
    """
    who = type(controller).__name__
    measured = MeasuredController(controller, MeasuredSignals(config, entries_read(controller, config)))
    empty = measured.empty()
    arrays = leaves_of(empty)

    def step(signals: Any, valid: Any, start: Any, lost_limit: Any, **values: Any) -> dict[str, Any]:
        sound, variable = [], dict[str, Any]()
        for gain in gains:
            present_gain = values.pop(GAINS + gain.name)
            within = np.logical_and(present_gain >= gain.low, present_gain <= gain.high)
            sound.append(named(f"{gain.name}_sound", within))
            usable_gain = np.where(within, present_gain, float(gain.value))
            variable[gain.name] = named(f"{gain.name}_used", usable_gain)
        varied = MeasuredController(_with_gains(controller, variable), measured.signals) if variable else measured
        now = varied.step(signals, valid, start, lost_limit, with_leaves(empty, values), sound)
        outputs: dict[str, Any] = {"begins": now.begins, "lost": now.lost, **leaves_of(now.common)}
        for prefix, case in ((STARTED, now.started), (CONTINUED, now.continued)):
            outputs |= {prefix + name: leaf for name, leaf in leaves_of(case).items()}
        return outputs

    starts = {GAINS + gain.name: np.array(float(gain.value)) for gain in gains}
    valid = np.ones(len(empty.last), np.bool_)
    given = {"signals": empty.last, "valid": valid, "start": np.array(False), "lost_limit": np.array(0)}
    graph = trace(step, {**given, **starts, **arrays})
    after, _ = controller.predict(np.zeros((1, len(measured.signals.layout.names)), dtype=np.float32), None)
    if not isinstance(after, np.ndarray):
        raise TraceError(f"{who}: keeps its memory outside its state: cannot be exported")
    for name in arrays:
        before = graph.inputs[name]
        for case in [name] if name in graph.outputs else [STARTED + name, CONTINUED + name]:
            node = graph.outputs.get(case)
            if node is None or (node.size, node.kind) != (before.size, before.kind):
                raise TraceError(f"{who}: its memory '{name}' changes its shape or type: cannot be exported")
    return ControllerGraph(graph, tuple(graph.inputs[name] for name in arrays), measured, tuple(gains))


def _with_gains(controller: Any, gains: Mapping[str, Any]) -> Controller:
    """The controller with other values, such as traced ones, in place of some gains."""
    changed = copy(controller)
    changed.gains = SimpleNamespace(**{**dict(controller.gains), **gains})
    return changed  # type: ignore[no-any-return]


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
    empty = MeasuredController(controller, signals).empty().controller
    memory = leaves_of(empty, "memory")

    def predict(**values: Any) -> dict[str, Any]:
        outputs: dict[str, Any] = {}
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


def leaves_of(memory: Any, name: str = "") -> dict[str, Any]:
    """The arrays of a memory by name; it consists of named tuples, tuples, lists and dictionaries.

    Raises:
        TraceError: the memory contains other objects.
    """
    if memory is None:
        return {}
    if hasattr(memory, "dtype"):
        return {name: memory}
    leaves: dict[str, Any] = {}
    for place, value in _entries(memory, name).items():
        leaves |= leaves_of(value, place)
    return leaves


def with_leaves(memory: Any, leaves: Mapping[str, Any], name: str = "") -> Any:
    """The memory with other arrays; the inverse of :func:`leaves_of`."""
    if memory is None:
        return None
    if hasattr(memory, "dtype"):
        return leaves[name].reshape(memory.shape)
    values = [with_leaves(value, leaves, place) for place, value in _entries(memory, name).items()]
    if isinstance(memory, dict):
        return dict(zip(memory, values, strict=True))
    return type(memory)(*values) if hasattr(memory, "_fields") else type(memory)(values)


def _entries(memory: Any, name: str) -> dict[str, Any]:
    """What a part of the memory holds, by the name of its place."""
    entries = memory._asdict() if hasattr(memory, "_asdict") else memory
    if isinstance(entries, tuple | list):
        entries = dict(enumerate(entries))
    if not isinstance(entries, dict):
        raise TraceError(f"{name or 'memory'}: {type(memory).__name__} holds no arrays: cannot be exported")
    return {f"{name}.{key}" if name else str(key): value for key, value in entries.items()}


# In C -----------------------------------------------------------------------------------------------------------------


def controller_code(controller: ControllerGraph, name: str = "controller") -> CCode:
    """C sources of a controller; ``name`` begins every symbol, so that one program can hold several."""
    fields = field_names(controller)
    names = inputs_of(controller, INPUTS, f"{name}_gains.")
    variables = {part: f"memory->{field}" for part, field in fields.items()}
    taken = ("voltage", "memory", *INPUTS, f"{name}_step", f"{name}_gains")
    elements = element_names(controller, f"{name.upper()}_")
    writer = Writer(controller.graph, names | variables, places=elements, taken=taken)
    values = written_step(controller, writer, variables)
    values["kept"] += f"\n    memory->lost_signals = (int){values['lost']};"
    parts = [{"type": C_TYPES[part.kind], "field": fields[part.name], "size": part.size} for part in controller.memory]
    values |= {
        "name": name,
        "type": memory_type(name),
        "gains_type": memory_type(name).removesuffix("Memory") + "Gains",
        "gains": controller.gains,
        "parts": parts,
    }
    return c_code(name, values, "controller")


def inputs_of(controller: ControllerGraph, texts: Sequence[str], gains: str) -> dict[str, str]:
    """Text of each input of the graph but the memory, by name; ``gains`` stands before the name of each gain."""
    return dict(zip(INPUTS, texts, strict=True)) | {GAINS + gain.name: gains + gain.name for gain in controller.gains}


def element_names(controller: ControllerGraph, prefix: str) -> dict[str, list[str]]:
    """Names of the elements of the arrays that hold one number per signal, by the name of the array."""
    names = [prefix + signal.name.upper() for signal in controller.signals.signals]
    return dict.fromkeys(("signals", "valid", "reading", "inside", "present", "last", "held"), names)


def field_names(controller: ControllerGraph) -> dict[str, str]:
    """Name of the variable of each part of the memory, by the name of the part."""
    short = [_field(part.name) for part in controller.memory]
    names = {}
    for part, name in zip(controller.memory, short, strict=True):
        names[part.name] = name if short.count(name) == 1 else re.sub(r"\W", "_", part.name)
    return names


def written_step(controller: ControllerGraph, writer: Writer, fields: Mapping[str, str]) -> dict[str, Any]:
    """What the templates of C and Structured Text write: contract, tables, and the statements of a step.

    These are ``common``, then those of a start or of a continuation, then ``kept``; ``lost`` counts the lost signals.

    Args:
        controller: the controller.
        writer: of the language.
        fields: variable of each part of the memory, by the name of the part.
    """
    shared = controller.common
    started, continued = controller.case(STARTED), controller.case(CONTINUED)
    later = set(in_order([*continued.values()]))
    both = [node for node in in_order([*started.values()]) if node in later]
    before = in_order([*shared.values(), *both])

    def stores(outputs: dict[str, Node], lines: list[str], indent: str = "    ") -> list[str]:
        """Statements that keep what changes in the memory; ``lines``: those before, to which others may be added."""
        stored = []
        for part in controller.memory:
            node = outputs.get(part.name, part)
            if node is not part:
                variable = writer.kept(f"new_{_field(part.name)}", node, lines, indent)
                stored.append(indent + writer.stored(fields[part.name], variable, part.size))
        return stored

    def case(outputs: dict[str, Node]) -> str:
        """The statements of a case; all values are read before the memory changes."""
        indent = " " * 8
        lines = writer.statements([node for node in in_order([*outputs.values()]) if node not in before], indent)
        lines.append(indent + writer.stored("voltage", writer.element(outputs["voltage"], 0), 1))
        stored = stores(outputs, lines, indent)
        return "\n".join([*lines, *stored])

    common = writer.statements(before)
    writer.kept("begins", shared["begins"], common)
    kept: list[str] = []
    kept += stores(shared, kept)
    return {
        "title": controller.title,
        "version": __version__,
        "sample_time": controller.signals.config.control_period,
        "signals": controller.signals.signals,
        "lost_rule": LOST_RULE,
        "common": "\n".join(common),
        "started": case(started),
        "continued": case(continued),
        "kept": "\n".join(kept),
        "lost": writer.element(shared["lost"], 0),
        "tables": writer.tables,
    }


def memory_type(name: str) -> str:
    """Name in C of the type of a controller's memory."""
    return "".join(word.capitalize() for word in name.split("_")) + "Memory"


def _field(name: str) -> str:
    return re.sub(r"\W", "_", name.removeprefix("controller."))
