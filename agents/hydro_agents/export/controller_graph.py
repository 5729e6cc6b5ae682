"""The graph of a controller, traced from measured signals to volts, for the writers of C and ONNX."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from hydro_agents.controllers.base import Controller
from hydro_agents.export.graph import Builder, Graph, Node
from hydro_agents.export.measured import MeasuredController, aligned
from hydro_agents.export.measured_signals import MeasuredSignals
from hydro_agents.export.tracing import TraceError, trace
from hydro_env import TaskConfig

STARTED, CONTINUED = "started.", "continued."


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

    @property
    def signals(self) -> MeasuredSignals:
        """The signals that it reads."""
        return self.measured.signals

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


def controller_graph(controller: Controller, config: TaskConfig) -> ControllerGraph:
    """Trace a controller.

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
        found = measured.step(signals, start, with_leaves(empty, values))
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

    graph = trace(step, {"signals": signals, "start": np.array(False), **leaves})
    after, _ = controller.predict(np.zeros((1, len(measured.signals.layout.names)), dtype=np.float32), None)
    if not isinstance(after, np.ndarray):
        raise TraceError(f"{who}: keeps its memory outside its state: cannot be exported")
    parts = tuple(Part(name, node.size, node.kind) for name, node in graph.inputs.items() if name in leaves)
    found = ControllerGraph(graph, parts, measured)
    for name in leaves:
        for way in [name] if name in graph.outputs else [STARTED + name, CONTINUED + name]:
            node = graph.outputs.get(way)
            if node is None or (node.size, node.kind) != (graph.inputs[name].size, graph.inputs[name].kind):
                raise TraceError(f"{who}: its memory '{name}' changes its shape or type: cannot be exported")
    return found


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
