"""A controller as a graph, traced from measured signals to volts, and this graph as C99."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from copy import copy
from dataclasses import dataclass, replace
from types import SimpleNamespace
from typing import Any

import numpy as np

from hydro_agents.controllers.base import Controller
from hydro_agents.controllers.registry import CONTROLLERS, GainRow, gain_rows
from hydro_env import ConfigurationError, TaskConfig, __version__
from hydro_env.files import Group
from hydro_rig.export.c_files import CCode, c_code
from hydro_rig.export.c_writer import C_TYPES, CWriter
from hydro_rig.export.graph import Graph, Node, in_order
from hydro_rig.export.measured import LOST_RULE, MeasuredController, MeasuredSignals
from hydro_rig.export.tracing import TraceError, named, trace

STARTED, CONTINUED = "started.", "continued."
GAINS = "gains."
INPUTS = ("signals", "valid", "start", "lost_limit")
_C_NAME = re.compile(r"[a-z][a-z0-9_]*")


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
    everything = leaves_of(empty)
    arrays = arrays_of(everything)

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
            for name, leaf in leaves_of(case).items():
                if hasattr(leaf, "dtype"):
                    outputs[prefix + name] = leaf
                elif name in arrays or leaf != everything.get(name):
                    raise TraceError(f"{who}: its memory '{name}' is a number that changes: cannot be exported")
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


def variable_gains(controller: Any, config: TaskConfig) -> list[GainRow]:
    """The gains that can be changed while the exported code runs.

    A change must have the effect of a new controller with this gain: a gain from which the controller computes other
    numbers when it is made, or on which it decides, stays a constant.
    """
    make, gains = type(controller), getattr(controller, "gains", None)
    if not isinstance(gains, Group) or make not in {kind for kind, _ in CONTROLLERS.values()}:
        return []
    rows = [row for row in gain_rows(gains) if isinstance(row.value, float) and _is_used(controller, config, row)]

    def text(controller: Controller) -> str:
        """The code without the values of these gains."""
        graph = controller_graph(controller, config, rows)
        blank = tuple(row._replace(value=0.0, in_practice="") for row in rows)
        return controller_code(replace(graph, gains=blank)).source

    def changed(row: GainRow) -> Controller:
        """A new controller with another gain."""
        return make(gains.model_copy(update={row.name: 0.999 * row.value or 1e-3}), config)

    same = text(controller)
    return [row for row in rows if text(changed(row)) == same]


def _is_used(controller: Controller, config: TaskConfig, row: GainRow) -> bool:
    """Whether the voltage depends on a gain, now or later, and the controller does not decide on it."""
    try:
        graph = controller_graph(controller, config, [row]).graph
    except (TraceError, TypeError):
        return False
    given = graph.inputs[GAINS + row.name]
    return any(node.operation == "where" and given in node.operands for node in graph.nodes())


def entries_read(controller: Controller, config: TaskConfig) -> set[str]:
    """Names of the entries of the observation on which the commands of a controller depend, now or later.

    Raises:
        TraceError: as :func:`controller_graph`.
    """
    signals = MeasuredSignals(config)
    empty = MeasuredController(controller, signals).empty().controller
    arrays = arrays_of(leaves_of(empty, "memory"))

    def predict(observation: Any, **values: Any) -> dict[str, Any]:
        outputs: dict[str, Any] = {}
        for prefix, memory in ((STARTED, None), (CONTINUED, with_leaves(empty, values, "memory"))):
            command, new = controller.predict(observation, memory)
            outputs[f"{prefix}command"] = command
            for name, leaf in leaves_of(new, "memory").items():
                if name in arrays:
                    outputs[prefix + name] = leaf
        return outputs

    observation = np.zeros((1, len(signals.layout.names)), dtype=np.float32)
    graph = trace(predict, {"observation": observation, **arrays})
    wanted, needed = {"command"}, set[str]()
    while wanted != needed:
        needed = wanted
        used = graph.used([graph.outputs[prefix + name] for prefix in (STARTED, CONTINUED) for name in needed])
        wanted = needed | {name for name in arrays if used[name].any()}
    return {name for name, read in zip(signals.layout.names, used["observation"], strict=True) if read}


def leaves_of(memory: Any, name: str = "") -> dict[str, Any]:
    """The arrays and whole numbers of a memory by name; it consists of named tuples, tuples, lists and dictionaries.

    Raises:
        TraceError: the memory contains other objects.
    """
    if memory is None:
        return {}
    if hasattr(memory, "dtype") or isinstance(memory, int):
        return {name: memory}
    leaves: dict[str, Any] = {}
    for place, value in _entries(memory, name).items():
        leaves |= leaves_of(value, place)
    return leaves


def arrays_of(leaves: Mapping[str, Any]) -> dict[str, Any]:
    """The arrays among the leaves of a memory."""
    return {name: leaf for name, leaf in leaves.items() if hasattr(leaf, "dtype")}


def with_leaves(memory: Any, leaves: dict[str, Any], name: str = "") -> Any:
    """The memory with other arrays; the inverse of :func:`leaves_of`."""
    if memory is None or isinstance(memory, int):
        return memory
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
    """C sources of a controller; ``name`` begins every symbol, so that one program can hold several.

    Raises:
        ConfigurationError: the name is not a valid name in C.
    """
    if not _C_NAME.fullmatch(name):
        raise ConfigurationError(f"name '{name}': must be a valid name in C, such as controller_1")
    fields = field_names(controller)
    names = inputs_of(controller, INPUTS, f"{name}_gains.")
    variables = {part: f"memory->{field}" for part, field in fields.items()}
    writer = CWriter(names | variables, places=element_names(controller, f"{name.upper()}_"))
    writer.reserve("voltage", "memory", *INPUTS, f"{name}_step", f"{name}_gains")
    values = written_step(controller, writer, variables)
    values["kept"] += f"\n    memory->lost_signals = (int){values['lost']};"
    parts = [{"type": C_TYPES[part.kind], "field": fields[part.name], "size": part.size} for part in controller.memory]
    values |= {
        "name": name,
        "type": memory_type(name),
        "gains_type": memory_type(name).removesuffix("Memory") + "Gains",
        "gains": controller.gains,
        "parts": parts,
        "helpers": writer.helpers,
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


def written_step(controller: ControllerGraph, writer: CWriter, fields: Mapping[str, str]) -> dict[str, Any]:
    """What the templates of C and Structured Text write: contract, tables, and the statements of a step.

    These are ``common``, then those of a start or of a continuation, then ``kept``; ``lost`` counts the lost signals.

    Args:
        controller: the controller.
        writer: of the language.
        fields: variable of each part of the memory, by the name of the part.
    """
    shared = controller.common
    writer.plan(controller.graph)
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
                stored.append(writer.stored(fields[part.name], f"new_{_field(part.name)}", node, lines, indent))
        return stored

    def case(outputs: dict[str, Node]) -> str:
        """The statements of a case; all values are read before the memory changes."""
        indent = " " * 8
        lines = writer.statements([node for node in in_order([*outputs.values()]) if node not in before], indent)
        lines.append(indent + writer.assign("voltage", writer.element(outputs["voltage"], 0)))
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
