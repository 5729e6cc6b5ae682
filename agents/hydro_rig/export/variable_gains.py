"""Which gains of an exported controller may be changed while the machine runs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from hydro_agents.controllers.base import Controller
from hydro_agents.controllers.registry import CONTROLLERS, GainRow, gain_rows
from hydro_env import TaskConfig
from hydro_env.files import Group
from hydro_rig.export.controller import GAINS, controller_code, controller_graph
from hydro_rig.export.tracing import TraceError

_CLASSICAL = tuple(kind for kind, _ in CONTROLLERS.values())


def variable_gains(controller: Controller, config: TaskConfig) -> list[GainRow]:
    """The gains that can be changed while the exported code runs.

    A change must have the effect of a new controller with this gain: a gain from which the controller computes other
    numbers when it is made, or on which it decides, stays a constant.
    """
    if not isinstance(own := getattr(controller, "gains", None), Group) or type(controller) not in _CLASSICAL:
        return []
    rows = [row for row in gain_rows(own) if isinstance(row.value, float)]
    if _used(controller, config, rows) is None:
        rows = [row for row in rows if _used(controller, config, [row])]
    rows = [row for row in rows if row.name in (_used(controller, config, rows) or ())]
    text, make = _text_without(controller, config, rows), type(controller)
    free = []
    for row in rows:
        near = own.model_copy(update={row.name: 0.999 * row.value if row.value else 1e-3})
        if _text_without(make(near, config), config, rows) == text:  # type: ignore[call-arg]
            free.append(row)
    return free


def _used(controller: Controller, config: TaskConfig, rows: Sequence[GainRow]) -> set[str] | None:
    """Names of the gains on which the voltage depends, now or later; ``None`` if the controller decides on one."""
    try:
        graph = controller_graph(controller, config, rows).graph
    except (TraceError, TypeError):
        return None
    used = graph.used([*graph.outputs.values()])
    return {row.name for row in rows if used[GAINS + row.name].any()}


def _text_without(controller: Controller, config: TaskConfig, rows: Sequence[GainRow]) -> str:
    """The code without the values of these gains."""
    graph = controller_graph(controller, config, rows)
    return controller_code(replace(graph, gains=tuple(row._replace(value=0.0, in_practice="") for row in rows))).source
