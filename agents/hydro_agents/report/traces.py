"""Single runs: the worst cases of every controller, run again with their rivals, and figures of runs over time."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from hydro_agents.report.canvas import INK, PALE, Array, Plot, add_legend, make_plot
from hydro_agents.report.content import Content
from hydro_agents.report.palette import Look
from hydro_agents.running.cases import Rollout
from hydro_agents.running.text import family_name, number, setting

Replay = Callable[[Mapping[str, Any]], Rollout]
"""Runs one case again; its argument has the columns of ``cases``."""

CASE = ["condition", "family", "leakage_flow_lpm", "seed"]
"""Columns that identify a case."""

JUMP = 2e-4
"""m between two samples; a larger change of the reference is a step."""


@dataclass(frozen=True)
class Example:
    """One test episode under every controller. Arrays (T,)."""

    title: str
    time: Array  # s
    reference: Array  # m
    position: dict[str, Array]  # controller → m
    command: dict[str, Array]  # controller → fraction of 10 V
    preview: float = 0.0  # s; the observation shows the reference this far ahead
    leak: float = 0.0  # l/min at 100 bar

    def renamed(self, names: Mapping[str, str]) -> Example:
        """The episode with new names of controllers."""
        return replace(
            self,
            position={names.get(name, name): trace for name, trace in self.position.items()},
            command={names.get(name, name): trace for name, trace in self.command.items()},
        )


@dataclass(frozen=True)
class Trace:
    """One of the worst cases of a controller, with its rival on the same case."""

    controller: str
    rival: str
    ratio: float  # error over that of the rival
    example: Example

    def renamed(self, names: Mapping[str, str]) -> Trace:
        """The case with new names of controllers."""
        controller, rival = (names.get(name, name) for name in (self.controller, self.rival))
        title = self.example.title.replace(f" of {self.controller}:", f" of {controller}:")
        title = title.replace(f"error of {self.rival} ", f"error of {rival} ")
        return replace(
            self, controller=controller, rival=rival, example=replace(self.example.renamed(names), title=title)
        )


def worst_rows(cases: pd.DataFrame, baseline: str, count: int = 2) -> pd.DataFrame:
    """The cases in which every controller has its largest ratio of errors, from different conditions.

    The rival of a controller is the baseline; the rival of the baseline is the controller with the smallest error in
    the case. With several training seeds, the worst seed counts.

    Args:
        cases: table ``cases`` of the protocol.
        baseline: its baseline.
        count: number of cases per controller.

    Returns:
        Rows of ``cases`` with rank, rival, rival_seed and ratio; those of the baseline come last.
    """
    columns = [*CASE, "controller", "training_seed", "mean_error_mm"]
    errors = cases[columns]
    errors = errors[errors["mean_error_mm"] > 0.0]
    base = errors[errors["controller"] == baseline]
    others = errors[errors["controller"] != baseline]
    best = others.loc[others.groupby(CASE)["mean_error_mm"].idxmin()]
    rivals = {"controller": "rival", "training_seed": "rival_seed", "mean_error_mm": "rival_error_mm"}
    paired = [others.merge(base.rename(columns=rivals), on=CASE), base.merge(best.rename(columns=rivals), on=CASE)]
    table = pd.concat(paired, ignore_index=True)
    table["ratio"] = table["mean_error_mm"] / table["rival_error_mm"]
    table = table[table["ratio"] > 1.0].sort_values("ratio", ascending=False, kind="stable")
    table = table.drop_duplicates(["controller", "condition"])  # a condition shows its worst case only
    table["rank"] = table.groupby("controller").cumcount() + 1
    table = table[table["rank"] <= count]
    order = [*others["controller"].unique(), baseline]
    return table.sort_values("controller", key=lambda names: names.map(order.index), kind="stable")


def worst_traces(
    replay: Replay,
    cases: pd.DataFrame,
    baseline: str,
    label: Callable[[str], str] = str,
    preview: float = 0.0,
    count: int = 2,
) -> list[Trace]:
    """Run the worst cases of every controller again, each with its rival (see :func:`worst_rows`).

    Args:
        replay: runs one case.
        cases: table ``cases`` of the protocol.
        baseline: its baseline.
        label: text of a condition.
        preview: s; the observation shows the reference this far ahead, which matters at steps.
        count: number of cases per controller.
    """
    traces = []
    for row in worst_rows(cases, baseline, count).to_dict("records"):
        case = {str(key): value for key, value in row.items()}
        name, rival = str(case["controller"]), str(case["rival"])
        runs = {name: replay(case)}
        runs[rival] = replay({**case, "controller": rival, "training_seed": case["rival_seed"]})
        where, one = label(str(case["condition"])), runs[name]
        leak = "" if "l/min" in where else f", leak of {setting(case['leakage_flow_lpm'])} l/min"
        title = (
            f"Worst case {case['rank']} of {name}: {number(float(case['ratio']))} times the error of {rival} "
            f"({where}, {family_name(str(case['family']))}{leak}, seed {case['seed']})"
        )
        example = Example(
            title=title,
            time=one.time,
            reference=one.reference[0],
            position={who: np.asarray(run.position[0]) for who, run in runs.items()},
            command={who: np.asarray(run.command[0]) for who, run in runs.items()},
            preview=preview if case["family"] == "step" else 0.0,
        )
        traces.append(Trace(name, rival, float(case["ratio"]), example))
    return traces


def with_traces(content: Content, replay: Replay) -> Content:
    """The content with the worst cases of every controller, run again (see :func:`worst_traces`)."""
    if len(content.controllers) < 2:
        return content
    preview = max(content.task.references.preview_times, default=0.0)
    traces = worst_traces(replay, content.table("cases"), content.baseline, content.label, preview)
    return replace(content, others={**content.others, "traces": traces})


def example_limits(examples: Sequence[Example]) -> tuple[float, float]:
    """Lowest and highest error (mm) of some episodes, for one scale in all their figures."""
    errors = [1e3 * (one.reference - position) for one in examples for position in one.position.values()]
    low, high = min(float(np.nanmin(e)) for e in errors), max(float(np.nanmax(e)) for e in errors)
    room = 0.05 * (high - low) or 1.0
    return low - room, high + room


def example_plot(
    example: Example, key: str, looks: Mapping[str, Look], limits: tuple[float, float] | None = None
) -> Plot:
    """Position and reference, error in mm, command in V of one episode under every controller.

    Args:
        example: the episode.
        key: name of the figure.
        looks: of the controllers.
        limits: of the error, mm.
    """
    names = list(example.position)
    jumps = example.time[1:][np.abs(np.diff(example.reference)) > JUMP] if example.preview > 0.0 else np.empty(0)
    ahead = setting(1e3 * example.preview)

    def paint(figure: Figure) -> None:
        above, middle, below = panels = figure.subplots(3, 1, sharex=True, height_ratios=[2.0, 1.5, 1.2])
        above.plot(example.time, 1e3 * example.reference, color=INK, linewidth=1.0, label="reference")
        if len(jumps):
            seen: dict[str, Any] = {"color": INK, "linewidth": 1.0, "linestyle": ":"}
            above.plot(
                example.time - example.preview, 1e3 * example.reference, label=f"preview, {ahead} ms ahead", **seen
            )
        for name in names:
            look = looks[name]
            above.plot(example.time, 1e3 * example.position[name], label=name, linewidth=1.2, **look.stroke)
            middle.plot(example.time, 1e3 * (example.reference - example.position[name]), linewidth=1.2, **look.stroke)
            below.plot(example.time, 10.0 * example.command[name], linewidth=0.9, **look.stroke)
        for axes in panels:
            for jump in jumps:
                axes.axvspan(jump - example.preview, jump, color=PALE, linewidth=0.0, zorder=0.5)
        middle.axhline(0.0, color=INK, linewidth=0.6)
        above.set_ylabel("position, mm")
        middle.set_ylabel("error, mm")
        below.set(ylabel="command, V", xlabel="time, s", ylim=(-10.8, 10.8), yticks=[-10, 0, 10])
        below.set_xlim(0.0, float(example.time[-1]))
        if limits is not None:
            middle.set_ylim(limits)
        for axes in (above, middle):
            axes.yaxis.set_major_locator(MaxNLocator(5))
        figure.align_ylabels()
        add_legend(above)

    errors = [
        f"{name} {number(1e3 * float(np.mean(np.abs(example.reference - example.position[name]))))} mm"
        for name in names
    ]
    note = f"Mean error of this run: {', '.join(errors)}."
    if len(jumps):
        note += (
            f" Dotted: the preview shows the reference {ahead} ms ahead, so the axis may start before the step (grey)."
        )
    alt = f"Position, error and valve command over time: {example.title}. {note}"
    return make_plot(key, example.title[:1].upper() + example.title[1:], note, alt, paint, 4.6)
