"""A controller as a graph, traced from measured signals to volts, and this graph as C99 and as an ONNX model."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Mapping, Sequence
from copy import copy
from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any

import numpy as np

from hydro_agents.controllers.base import Controller
from hydro_agents.controllers.registry import GainRow
from hydro_env import ConfigurationError, TaskConfig, __version__
from hydro_rig.export.c_files import CCode, c_code
from hydro_rig.export.c_writer import C_TYPES, CWriter
from hydro_rig.export.graph import Builder, Graph, Node
from hydro_rig.export.measured import MeasuredController, MeasuredSignals, aligned
from hydro_rig.export.onnx_writer import OnnxWriter
from hydro_rig.export.tracing import TraceError, trace

STARTED, CONTINUED = "started.", "continued."

GAINS = "gains."
OUTPUTS = ("voltage", "next_state", "lost_signals")
DOUBLE = np.dtype(np.float64)
_C_NAME = re.compile(r"[a-z][a-z0-9_]*")


@dataclass(frozen=True)
class Part:
    """A part of the memory: a named array."""

    name: str
    size: int
    kind: np.dtype[Any]


@dataclass(frozen=True)
class ControllerGraph:
    """A controller as a graph.

    Inputs: ``signals``, ``start`` and the parts of the memory. Outputs: ``begins`` (whether the controller starts
        here), ``lost`` (number of lost signals), and the parts that are the same in both cases. ``voltage`` and the
        other parts occur twice: with the prefix ``started.`` for a start, ``continued.`` for a continuation.
    """

    graph: Graph
    memory: tuple[Part, ...]
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
    def twice(self) -> tuple[str, ...]:
        """The outputs that depend on whether the controller starts."""
        return tuple(name.removeprefix(STARTED) for name in self.graph.outputs if name.startswith(STARTED))

    def chosen(self) -> dict[str, Node]:
        """Every output once, selected by ``begins``."""
        builder, outputs = Builder(), self.graph.outputs
        begins = outputs["begins"]
        found = {name: node for name, node in outputs.items() if not name.startswith((STARTED, CONTINUED))}
        for name in self.twice:
            ways = [outputs[prefix + name] for prefix in (STARTED, CONTINUED)]
            value = np.zeros(ways[0].size, ways[0].kind)
            found[name] = ways[0] if ways[0] is ways[1] else builder.node("where", [begins, *ways], value, name=name)
        return found


def controller_graph(controller: Controller, config: TaskConfig, gains: Sequence[GainRow] = ()) -> ControllerGraph:
    """Trace a controller.

    Args:
        controller: the controller.
        config: its task.
        gains: those that become inputs of the graph, of :func:`~hydro_rig.export.controller_folder.variable_gains`;
            the others are constants in it.

    Raises:
        TraceError: the controller contains data-dependent decisions that no fixed graph can represent.
        ConfigurationError: the observation cannot be computed from measured signals.
    """
    who = type(controller).__name__
    measured = MeasuredController(controller, MeasuredSignals(config, entries_read(controller, config)))
    empty = measured.empty()
    everything = leaves_of(empty)
    leaves = {name: leaf for name, leaf in everything.items() if hasattr(leaf, "dtype")}
    signals = empty.last

    def step(signals: Any, start: Any, **values: Any) -> dict[str, Any]:
        variable = {gain.name: values.pop(GAINS + gain.name) for gain in gains}
        varied = MeasuredController(_with_gains(controller, variable), measured.signals) if variable else measured
        found = varied.step(signals, start, with_leaves(empty, values))
        outputs: dict[str, Any] = {"begins": found.begins, "lost": found.lost, **leaves_of(found.common)}
        for prefix, way in ((STARTED, found.started), (CONTINUED, found.continued)):
            for name, leaf in leaves_of(way).items():
                if hasattr(leaf, "dtype"):
                    outputs[prefix + name] = leaf
                elif name in leaves or leaf != everything.get(name):
                    raise TraceError(
                        f"{who}: its memory '{name}' is a number that changes, no array: cannot be exported"
                    )
        return outputs

    given = {GAINS + gain.name: np.array(float(gain.value)) for gain in gains}
    graph = trace(step, {"signals": signals, "start": np.array(False), **given, **leaves})
    after, _ = controller.predict(np.zeros((1, len(measured.signals.layout.names)), dtype=np.float32), None)
    if not isinstance(after, np.ndarray):
        raise TraceError(f"{who}: keeps its memory outside its state: cannot be exported")
    parts = tuple(Part(name, node.size, node.kind) for name, node in graph.inputs.items() if name in leaves)
    found = ControllerGraph(graph, parts, measured, tuple(gains))
    for name in leaves:
        for way in [name] if name in graph.outputs else [STARTED + name, CONTINUED + name]:
            node = graph.outputs.get(way)
            if node is None or (node.size, node.kind) != (graph.inputs[name].size, graph.inputs[name].kind):
                raise TraceError(f"{who}: its memory '{name}' changes its shape or type: cannot be exported")
    return found


def _with_gains(controller: Controller, gains: Mapping[str, Any]) -> Controller:
    """The controller with other values, such as traced ones, in place of some gains."""
    changed = copy(controller)
    own: Any = controller
    changed.gains = SimpleNamespace(**{**dict(own.gains), **gains})  # type: ignore[attr-defined]
    return changed


def entries_read(controller: Controller, config: TaskConfig) -> set[str]:
    """Names of the entries of the observation on which the commands of a controller depend, now or later.

    Raises:
        TraceError: as :func:`controller_graph`.
    """
    signals = MeasuredSignals(config)
    empty = MeasuredController(controller, signals).empty().controller
    leaves = {name: leaf for name, leaf in leaves_of(empty, "memory").items() if hasattr(leaf, "dtype")}

    def predict(observation: Any, **values: Any) -> dict[str, Any]:
        outputs: dict[str, Any] = {}
        for prefix, memory in ((STARTED, None), (CONTINUED, with_leaves(empty, values, "memory"))):
            command, new = aligned(controller.predict(observation, memory))
            outputs |= {prefix + name: leaf for name, leaf in leaves_of(new, "memory").items() if name in leaves}
            outputs[f"{prefix}command"] = command
        return outputs

    observation = np.zeros((1, len(signals.layout.names)), dtype=np.float32)
    graph = trace(predict, {"observation": observation, **leaves})
    wanted, found = {"command"}, set[str]()
    while wanted != found:
        found = wanted
        outputs = [graph.outputs[prefix + name] for prefix in (STARTED, CONTINUED) for name in found]
        used = graph.used(outputs)
        wanted = found | {name for name in leaves if used[name].any()}
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
    inner = _entries(memory, name)
    leaves: dict[str, Any] = {}
    for key, value in inner.items():
        leaves |= leaves_of(value, f"{name}.{key}" if name else key)
    return leaves


def with_leaves(memory: Any, leaves: dict[str, Any], name: str = "") -> Any:
    """The memory with other arrays; the inverse of :func:`leaves_of`."""
    if memory is None or isinstance(memory, int):
        return memory
    if hasattr(memory, "dtype"):
        return leaves[name].reshape(memory.shape)
    inner = _entries(memory, name)
    values = {key: with_leaves(value, leaves, f"{name}.{key}" if name else key) for key, value in inner.items()}
    if isinstance(memory, dict):
        return values
    return type(memory)(**values) if hasattr(memory, "_fields") else type(memory)(values.values())


def _entries(memory: Any, name: str) -> dict[str, Any]:
    if hasattr(memory, "_asdict"):
        return dict(memory._asdict())
    if isinstance(memory, tuple | list):
        return {str(place): value for place, value in enumerate(memory)}
    if isinstance(memory, dict):
        return {str(key): value for key, value in memory.items()}
    raise TraceError(f"{name or 'memory'}: {type(memory).__name__} holds no arrays: cannot be exported")


def controller_code(controller: ControllerGraph, name: str = "controller") -> CCode:
    """C sources of a controller; ``name`` begins every symbol, so that one program can hold several.

    Raises:
        ConfigurationError: the name is not a valid name in C.
    """
    if not _C_NAME.fullmatch(name):
        raise ConfigurationError(f"name '{name}': must be a valid name in C, such as controller_1")
    fields = field_names(controller)
    inputs = {"signals": "signals", "start": "start"} | {part: f"memory->{text}" for part, text in fields.items()}
    inputs |= {GAINS + gain.name: f"{name}_gains.{gain.name}" for gain in controller.gains}
    writer = CWriter(inputs, places=element_names(controller, f"{name.upper()}_"))
    writer.plan(controller.graph)
    writer.reserve("voltage", "memory", "signals", "start", f"{name}_step", f"{name}_gains")
    step = written_step(controller, writer, {part: f"memory->{text}" for part, text in fields.items()})
    step["kept"] += f"\n    memory->lost_signals = (int){writer.element(controller.graph.outputs['lost'], 0)};"
    values = {
        "name": name,
        "type": memory_type(name),
        "gains_type": memory_type(name).removesuffix("Memory") + "Gains",
        "gains": controller.gains,
        "title": controller.title,
        "version": __version__,
        "sample_time": controller.signals.config.control_period,
        "signals": controller.signals.signals,
        "parts": [
            {"type": C_TYPES[part.kind], "field": fields[part.name], "size": part.size} for part in controller.memory
        ],
        **step,
        "helpers": writer.helpers,
        "tables": writer.tables,
    }
    return c_code(name, values, "controller")


def element_names(controller: ControllerGraph, prefix: str) -> dict[str, list[str]]:
    """Names of the elements of the arrays that hold one number per signal, by the name of the array."""
    names = [prefix + signal.name.upper() for signal in controller.signals.signals]
    return dict.fromkeys(("signals", "last", "present", "held"), names)


def field_names(controller: ControllerGraph) -> dict[str, str]:
    """Name of the variable of each part of the memory, by the name of the part."""
    short = Counter(_field(part.name) for part in controller.memory)
    return {
        part.name: _field(part.name) if short[_field(part.name)] == 1 else re.sub(r"\W", "_", part.name)
        for part in controller.memory
    }


def written_step(controller: ControllerGraph, writer: CWriter, fields: Mapping[str, str]) -> dict[str, str]:
    """The statements of a step: ``common``, then those of a start or of a continuation, then ``kept``.

    Args:
        controller: the controller.
        writer: of the language.
        fields: variable of each part of the memory, by the name of the part.
    """
    graph, outputs = controller.graph, controller.graph.outputs
    ways = {
        prefix: [node for name, node in outputs.items() if name.startswith(prefix)] for prefix in (STARTED, CONTINUED)
    }
    needed = {prefix: graph.nodes(nodes) for prefix, nodes in ways.items()}
    both = {id(node) for node in needed[STARTED]} & {id(node) for node in needed[CONTINUED]}
    shared = [node for name, node in outputs.items() if not name.startswith((STARTED, CONTINUED))]
    common = graph.nodes([*shared, *(node for node in needed[STARTED] if id(node) in both)])
    done = {id(node) for node in common}

    texts = {"common": writer.statements(common), "kept": []}
    begins, made = writer.kept("begins", outputs["begins"])
    texts["common"] += [f"    {line}" for line in made]
    if begins != "begins":
        texts["common"].append(f"    {writer.named_begins(begins)}")
    for part in controller.memory:
        if part.name in outputs:
            variable, made = writer.kept(f"new_{_field(part.name)}", outputs[part.name])
            texts["kept"] += [f"    {line}" for line in [*made, writer.copied(fields[part.name], variable, part.size)]]
    for prefix, key in ((STARTED, "started"), (CONTINUED, "continued")):
        lines = writer.statements([node for node in needed[prefix] if id(node) not in done], " " * 8)
        lines.append(f"        {writer.assign('voltage', writer.element(outputs[prefix + 'voltage'], 0))}")
        copies, stores = [], []
        for part in controller.memory:
            node = outputs.get(prefix + part.name)
            if node is not None and not (node.operation == "input" and node.name == part.name):
                # All values are read before the memory changes.
                variable, made = writer.kept(f"new_{_field(part.name)}", node)
                copies += [f"        {line}" for line in made]
                stores.append(f"        {writer.copied(fields[part.name], variable, part.size)}")
        texts[key] = [*lines, *copies, *stores]
    return {key: "\n".join(lines) for key, lines in texts.items()}


def memory_type(name: str) -> str:
    """Name in C of the type of a controller's memory."""
    return "".join(word.capitalize() for word in name.split("_")) + "Memory"


def _field(name: str) -> str:
    return re.sub(r"\W", "_", name.removeprefix("controller."))


def controller_model(controller: ControllerGraph) -> Any:
    """The model; inputs ``signals``, ``state``, ``start``, outputs ``voltage``, ``next_state``, ``lost_signals``.

    The state is one vector: the parts of the memory, one after the other, as ``double``, which represents every
    ``float`` and truth value exactly.

    Raises:
        ConfigurationError: the package onnx is not installed.
        HydroError: the model is wrong.
    """
    parts = controller.memory
    signals, size = len(controller.signals.signals), sum(part.size for part in parts)
    inputs = {"signals": (signals, DOUBLE), "state": (size, DOUBLE), "start": (1, np.dtype(np.bool_))}
    writer = OnnxWriter(inputs, OUTPUTS)
    first = 0
    for part in parts:
        tensor = writer.slice_of("state", first, part.size, f"state.{part.name}")
        writer.given[part.name] = writer.cast(tensor, DOUBLE, part.kind, f"state.{part.name}")
        first += part.size
    chosen = controller.chosen()
    pieces = []
    for part in parts:
        pieces.append(writer.cast(writer.tensor(chosen[part.name]), part.kind, DOUBLE, f"next.{part.name}"))
    joined = writer.add("Concat", pieces, "next_memory", axis=0)
    tensors = (writer.tensor(chosen["voltage"]), joined, writer.tensor(chosen["lost"]))
    outputs = {name: (one, n, DOUBLE) for name, one, n in zip(OUTPUTS, tensors, (1, size, 1), strict=True)}
    names = ", ".join(f"{signal.name} ({signal.unit})" for signal in controller.signals.signals)
    facts = {"signals": names, "sample_time": repr(controller.signals.config.control_period)}
    return writer.model(outputs, controller.title, facts)
