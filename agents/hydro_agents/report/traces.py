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
from hydro_agents.running.text import capitalised, family_name, number, setting

Replay = Callable[[Mapping[str, Any]], Rollout]
"""Runs one case again; its argument has the columns of ``cases``."""

CASE = ["condition", "family", "leakage_flow_lpm", "seed"]
"""Columns that identify a case."""

LEAK_GROUPS = ("leak", "leak_law", "schedule")
"""Groups of conditions whose label says the leak."""

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
    errors = cases[[*CASE, "controller", "training_seed", "mean_error_mm"]]
    errors = errors[errors["mean_error_mm"] > 0.0]
    is_base = errors["controller"] == baseline
    base, others = errors[is_base], errors[~is_base]
    best = others.loc[others.groupby(CASE)["mean_error_mm"].idxmin()]
    rivals = {"controller": "rival", "training_seed": "rival_seed", "mean_error_mm": "rival_error_mm"}
    paired = [others.merge(base.rename(columns=rivals), on=CASE), base.merge(best.rename(columns=rivals), on=CASE)]
    table = pd.concat(paired, ignore_index=True)
    table["ratio"] = table["mean_error_mm"] / table["rival_error_mm"]
    table = table[table["ratio"] > 1.0].sort_values("ratio", ascending=False, kind="stable")
    table = table.drop_duplicates(["controller", "condition"])  # a condition shows its worst case only
    table["rank"] = table.groupby("controller").cumcount() + 1
    order = [*others["controller"].unique(), baseline]
    worst = table[table["rank"] <= count]
    return worst.sort_values("controller", key=lambda names: names.map(order.index), kind="stable")


def with_traces(content: Content, replay: Replay, count: int = 2) -> Content:
    """The content with the worst cases of every controller, each run again with its rival (see :func:`worst_rows`).

    Args:
        content: with the table ``cases`` of the protocol.
        replay: runs one case.
        count: number of cases per controller.
    """
    if len(content.controllers) < 2:
        return content
    preview = max(content.task.references.preview_times, default=0.0)
    with_leak = content.in_groups(*LEAK_GROUPS)
    traces = []
    for case in worst_rows(content.table("cases"), content.baseline, count).to_dict("records"):
        name, rival, family = case["controller"], case["rival"], case["family"]
        runs = {name: replay(case)}
        runs[rival] = replay({**case, "controller": rival, "training_seed": case["rival_seed"]})
        where = [content.label(case["condition"]), family_name(family)]
        if case["condition"] not in with_leak:
            where.append(f"leak of {setting(case['leakage_flow_lpm'])} l/min")
        where.append(f"seed {case['seed']}")
        times = f"{number(case['ratio'])} times the error of {rival}"
        example = Example(
            title=f"Worst case {case['rank']} of {name}: {times} ({', '.join(where)})",
            time=runs[name].time,
            reference=runs[name].reference[0],
            position={who: np.asarray(run.position[0]) for who, run in runs.items()},
            command={who: np.asarray(run.command[0]) for who, run in runs.items()},
            preview=preview if family == "step" else 0.0,
        )
        traces.append(example)
    return replace(content, others={**content.others, "traces": traces})


def example_limits(examples: Sequence[Example]) -> tuple[float, float]:
    """Lowest and highest error (mm) of some episodes, for one scale in all their figures."""
    errors = [1e3 * (run.reference - position) for run in examples for position in run.position.values()]
    low, high = np.nanmin(errors), np.nanmax(errors)
    room = 0.05 * (high - low) or 1.0
    return float(low - room), float(high + room)


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
    time, reference = example.time, 1e3 * example.reference
    error = {name: 1e3 * (example.reference - position) for name, position in example.position.items()}
    jumps = time[1:][np.abs(np.diff(example.reference)) > JUMP] if example.preview > 0.0 else np.empty(0)
    ahead = f"{setting(1e3 * example.preview)} ms ahead"

    def paint(figure: Figure) -> None:
        above, middle, below = panels = figure.subplots(3, 1, sharex=True, height_ratios=[2.0, 1.5, 1.2])
        thin: dict[str, Any] = {"color": INK, "linewidth": 1.0}
        above.plot(time, reference, label="reference", **thin)
        if len(jumps):
            above.plot(time - example.preview, reference, label=f"preview, {ahead}", linestyle=":", **thin)
        for name, position in example.position.items():
            stroke = looks[name].stroke
            above.plot(time, 1e3 * position, label=name, linewidth=1.2, **stroke)
            middle.plot(time, error[name], linewidth=1.2, **stroke)
            below.plot(time, 10.0 * example.command[name], linewidth=0.9, **stroke)
        for axes in panels:
            for jump in jumps:
                axes.axvspan(jump - example.preview, jump, color=PALE, linewidth=0.0, zorder=0.5)
        middle.axhline(0.0, color=INK, linewidth=0.6)
        above.set_ylabel("position, mm")
        middle.set_ylabel("error, mm")
        below.set(ylabel="command, V", xlabel="time, s", ylim=(-10.8, 10.8), yticks=[-10, 0, 10])
        below.set_xlim(0.0, float(time[-1]))
        if limits is not None:
            middle.set_ylim(limits)
        for axes in (above, middle):
            axes.yaxis.set_major_locator(MaxNLocator(5))
        figure.align_ylabels()
        add_legend(above)

    means = (f"{name} {number(float(np.mean(np.abs(values))))} mm" for name, values in error.items())
    note = f"Mean error of this run: {', '.join(means)}."
    if len(jumps):
        note += f" Dotted: the preview shows the reference {ahead}, so the axis may start before the step (grey)."
    alt = f"Position, error and valve command over time: {example.title}. {note}"
    return make_plot(key, capitalised(example.title), note, alt, paint, 4.6)
