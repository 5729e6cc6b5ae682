"""C99 code of a controller: one function from measured signals to the voltage of the valve."""

from __future__ import annotations

import re
from collections import Counter
from dataclasses import dataclass
from pathlib import Path

from hydro_agents.controllers.base import Controller
from hydro_agents.export.c_writer import C_TYPES, CWriter
from hydro_agents.export.controller_graph import CONTINUED, STARTED, ControllerGraph, controller_graph
from hydro_agents.export.graph import Node
from hydro_agents.export.plant_code import render
from hydro_env import ConfigurationError, TaskConfig, __version__

_C_NAME = re.compile(r"[a-z][a-z0-9_]*")


@dataclass(frozen=True)
class ControllerCode:
    """C sources of a controller, as text."""

    name: str
    header: str
    source: str

    @property
    def memory(self) -> str:
        """Name in C of the type of its memory."""
        return _memory(self.name)

    def write(self, folder: Path) -> None:
        """Write ``NAME.h`` and ``NAME.c``."""
        (folder / f"{self.name}.h").write_text(self.header, encoding="utf-8")
        (folder / f"{self.name}.c").write_text(self.source, encoding="utf-8")


def controller_code(controller: Controller, config: TaskConfig, name: str = "controller") -> ControllerCode:
    """C sources of a controller for a task; ``name`` begins every symbol, so that one program can hold several.

    Raises:
        TraceError: the controller cannot be exported exactly.
        ConfigurationError: the name is not a valid name in C.
    """
    return code_of(controller_graph(controller, config), name)


def code_of(controller: ControllerGraph, name: str = "controller") -> ControllerCode:
    """C sources of the graph of a controller; see :func:`controller_code`."""
    if not _C_NAME.fullmatch(name):
        raise ConfigurationError(f"name '{name}': must be a valid name in C, such as controller_1")
    graph, outputs = controller.graph, controller.graph.outputs
    short = Counter(_field(part.name) for part in controller.memory)
    fields = {
        part.name: _field(part.name) if short[_field(part.name)] == 1 else re.sub(r"\W", "_", part.name)
        for part in controller.memory
    }
    writer = CWriter(
        {"signals": "signals", "start": "start"} | {name: f"memory->{text}" for name, text in fields.items()}
    )
    writer.reserve("voltage", "memory", "signals", "start", f"{name}_step")
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
        texts["common"].append(f"    const int begins = {begins};")
    for part in controller.memory:
        if part.name in outputs:
            texts["kept"] += _stored(writer, fields[part.name], outputs[part.name], "    ")
    texts["kept"].append(f"    memory->lost_signals = (int){writer.element(outputs['lost'], 0)};")
    for prefix, key in ((STARTED, "started"), (CONTINUED, "continued")):
        lines = writer.statements([node for node in needed[prefix] if id(node) not in done], " " * 8)
        lines.append(f"        voltage = {writer.element(outputs[prefix + 'voltage'], 0)};")
        copies, stores = [], []
        for part in controller.memory:
            node = outputs.get(prefix + part.name)
            if node is not None and not (node.operation == "input" and node.name == part.name):
                # All values are read before the memory changes.
                variable, made = writer.kept(f"new_{fields[part.name]}", node)
                copies += [f"        {line}" for line in made]
                stores += _copied(fields[part.name], variable, part.size, "        ")
        texts[key] = [*lines, *copies, *stores]
    values = {
        "name": name,
        "type": _memory(name),
        "title": f"Controller of a hydraulic servo axis ({type(controller.measured.controller).__name__})",
        "version": __version__,
        "sample_time": controller.signals.config.control_period,
        "signals": controller.signals.signals,
        "parts": [
            {"type": C_TYPES[part.kind], "field": fields[part.name], "size": part.size} for part in controller.memory
        ],
        "helpers": writer.helpers,
        "tables": writer.tables,
        **{key: "\n".join(lines) for key, lines in texts.items()},
    }
    return ControllerCode(name, *(render(f"controller.{kind}.j2", values) for kind in ("h", "c")))


def _memory(name: str) -> str:
    return "".join(word.capitalize() for word in name.split("_")) + "Memory"


def _field(name: str) -> str:
    """Name in C of a part of the memory."""
    return re.sub(r"\W", "_", name.removeprefix("controller."))


def _stored(writer: CWriter, name: str, node: Node, indent: str) -> list[str]:
    """Statements that store a result in the memory."""
    variable, made = writer.kept(f"new_{name}", node)
    return [*(f"{indent}{line}" for line in made), *_copied(name, variable, node.size, indent)]


def _copied(name: str, variable: str, size: int, indent: str) -> list[str]:
    if size == 1:
        return [f"{indent}memory->{name} = {variable};"]
    return [f"{indent}for (int i = 0; i < {size}; ++i) memory->{name}[i] = {variable}[i];"]
