"""The page of ``hydro score``: curves of all detectors, then the tables of the console."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import pandas as pd
from matplotlib.axes import Axes

from hydro_agents.report.canvas import GREY, curve_plot, ticks
from hydro_agents.report.content import Content
from hydro_agents.report.page import Page
from hydro_agents.report.palette import Look, looks_of
from hydro_agents.report.sections import Block, Points, render_page, section
from hydro_agents.running.machine import Origin
from hydro_agents.running.text import Table
from hydro_rig.challenge.outcomes import BUDGETS, COST_RATIOS
from hydro_rig.challenge.scores import PERFECT, SILENT, Score, by_rank, notes, tables_of

SECTIONS = ("found_over_false_alarms", "costs_and_probabilities", "scores_in_numbers")
SOURCES = "Numbers: scores.csv beside this page."

RATES = (0.5, 1.0, 2.0, 5.0, 10.0, 20.0, 50.0)  # false alarms per hour, of the curves


def render_scores(scores: Sequence[Score], origin: Origin) -> Page:
    """The page of some detectors."""
    return render_page(
        "Leak detectors on leaking axes", SECTIONS, Content({}, others={"scores": list(scores)}), origin, SOURCES
    )


def _shown(content: Content) -> tuple[list[Score], dict[Any, Look]]:
    """The detectors without the bounds, the best first, and their looks."""
    scores = [one for one in by_rank(content.part("scores", list)) if one.name not in (PERFECT, SILENT)]
    return scores, looks_of([one.name for one in scores])


@section("Leaks found", needs=("scores",))
def found_over_false_alarms(content: Content) -> list[Block]:
    """The free-response ROC, and the share found in groups of recordings."""
    scores, looks = _shown(content)
    curves = {one.name: pd.Series({rate: 100.0 * one.outcomes.found_at(rate) for rate in RATES}) for one in scores}

    def scale(axes: Axes) -> None:
        axes.set_xscale("log")
        ticks(axes.xaxis, RATES)

    note = f"The ranking takes the mean at {', '.join(f'{rate:g}' for rate in BUDGETS)} false alarms per hour."
    whole = curve_plot(
        *("found", "Leaks found over false alarms", note, curves, looks, " %", scale),
        per=" per hour",
        xlabel="false alarms per hour",
        ylabel="leaks found, %",
        ylim=(0.0, 103.0),
    )
    names = list(dict.fromkeys(name for one in scores for name in one.groups))
    frames = {}
    for one in scores:
        rows = [one.groups[name]._asdict() if name in one.groups else {} for name in names]
        frames[one.name] = 100.0 * pd.DataFrame(rows, index=names, columns=["value", "low", "high"]).astype(float)
    note = "Mean share over the false-alarm rates of the ranking, each group with its own threshold; 95 % interval."
    named = ("groups", "Where leaks are found", note)
    return [whole, curve_plot(*named, frames, looks, " %", drawn="rows", xlabel="leaks found, %", xlim=(-2.0, 103.0))]


@section("Costs and probabilities", needs=("scores",))
def costs_and_probabilities(content: Content) -> list[Block]:
    """The cost of misses and false call-outs, and how often a probability holds."""
    scores, looks = _shown(content)
    costs = {one.name: pd.Series(one.outcomes.costs(), index=list(COST_RATIOS)) for one in scores}

    note = "1: no better than no detector. One leak per axis and year, 8760 h; each point has the best threshold."
    blocks: list[Block] = [
        curve_plot(
            *("costs", "Cost of misses and false call-outs", note, costs, looks, ""),
            finish=lambda axes: axes.set_xscale("log"),
            per=" to 1",
            xlabel="cost of a missed leak ÷ cost of a false call-out",
            ylabel="cost ÷ cost without a detector",
            ylim=(0.0, 1.05),
        )
    ]
    told = {one.name: one.reliability.set_index("told")["leaks"] for one in scores if len(one.reliability)}
    if told:
        note = "At the last look of each recording; on the line a probability holds."
        named = ("reliability", "Does the probability hold?", note, told, looks, "", _diagonal)
        blocks.append(curve_plot(*named, per="", xlabel="probability of a leak", ylabel="share that leaks"))
    return blocks


def _diagonal(axes: Axes) -> None:
    axes.plot([0.0, 1.0], [0.0, 1.0], color=GREY, linewidth=0.9)


@section("In numbers", needs=("scores",))
def scores_in_numbers(content: Content) -> list[Block]:
    """The tables of the console, and how they are read."""
    scores = content.part("scores", list)
    tables = tables_of(scores).items()
    blocks: list[Block] = [
        Table(title, tuple(header), [tuple(row) for row in rows]) for title, (header, rows) in tables if rows
    ]
    return [*blocks, Points(notes(scores))]
