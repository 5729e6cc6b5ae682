"""The parts of a protocol: what is measured, and where it is done.

A part is a function of a protocol and its participants that yields :class:`Cell` by cell: one participant under one
condition, as jobs that can run anywhere. The runner (:mod:`hydro_agents.evaluation.runner`) runs the jobs of all parts
together, and joins the rows of a part into one table. A new part is such a function and an entry of :data:`PARTS`.

Participants may be anything: a part asks for those that it measures. A part of detectors, for example, yields one cell
per detector, condition and leak level; ``refused`` holds the answer of the detector's ``refuses``; windows of healthy
axes from validation seeds are further cells, whose rows give the threshold when a table is made. A part without
participants, such as a bound, yields cells under a name of its own.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from importlib import import_module
from typing import Any, NamedTuple

from hydro_agents.running.jobs import Job


@dataclass(frozen=True)
class Cell:
    """One participant under one condition.

    A participant that cannot act under a condition has a cell with the reason in ``refused``, and no jobs.
    """

    participant: str
    condition: str = ""  # empty: the part is about the task of the protocol
    known: Mapping[str, Any] = field(default_factory=dict)  # first columns of its rows: one value, or one per row
    jobs: tuple[Job, ...] = ()  # their columns follow each other
    refused: str = ""


class Part(NamedTuple):
    """A part of a protocol."""

    table: str  # name of the table of its rows
    cells: str  # module:function that yields its cells
    kinds: tuple[str, ...] = ("robustness",)  # of protocols that may have it


PARTS = {
    "tracking": Part("cases", "hydro_agents.evaluation.tracking:tracking", ("robustness", "study")),
    "episodes": Part("detection", "hydro_agents.evaluation.detection:episodes", ("study",)),
    "standstill": Part("limit_cycles", "hydro_agents.evaluation.tracking:standstill"),
    "best_found": Part("bound", "hydro_agents.evaluation.tracking:best"),
    "frequency": Part("frequency", "hydro_agents.evaluation.experiments:frequency"),
    "force_step": Part("force_step", "hydro_agents.evaluation.experiments:force_steps"),
    "force_sine": Part("force_sine", "hydro_agents.evaluation.experiments:force_sines"),
    "hold": Part("standstill", "hydro_agents.evaluation.experiments:hold"),
    "windows": Part("windows", "hydro_agents.evaluation.leak_windows:windows", ("leakage",)),
    "alarm": Part("alarms", "hydro_agents.evaluation.leak_alarm:alarm", ("leakage",)),
    "leak_bound": Part("bound", "hydro_agents.evaluation.leak_bound:leak_bound", ("leakage",)),
    "leak_price": Part("leak_price", "hydro_agents.evaluation.experiments:price"),
}
"""Every part by its name. Its module is imported when a protocol has the part."""


def cells_of(part: str) -> Callable[[Any, Any], Iterator[Cell]]:
    """The function that yields the cells of a part from a protocol and its participants."""
    module, _, name = PARTS[part].cells.partition(":")
    found: Callable[[Any, Any], Iterator[Cell]] = getattr(import_module(module), name)
    return found
