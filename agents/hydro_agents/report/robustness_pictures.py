"""The figures of the page: performance profiles, normalised gap, Bode plots, stiffness, cost of a leak."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from hydro_agents.report.canvas import (
    HEIGHT,
    INK,
    Look,
    Plot,
    add_legend,
    bars,
    description,
    dodge,
    level_axis,
    looks_of,
    make_plot,
    one_panel,
    row_axis,
    ticks,
)
from hydro_agents.report.plots import example_plot
from hydro_agents.report.robustness_record import Record, interval
from hydro_agents.report.text import setting

FREQUENCY_TICKS = (0.5, 1.0, 2.0, 5.0, 10.0, 20.0, 50.0)


def profile_plots(record: Record) -> list[Plot]:
    """Share of cases whose error is at most tau times that of the best controller, and of the baseline."""
    table = record.table("profiles")
    notes = {
        "best": "Share of cases in which the error is at most τ times the smallest error of any controller in that "
        "case (Dolan and Moré). Higher is better; at τ = 1: share of cases won.",
        "baseline": f"The same against {record.baseline}: the curve at τ = 1 is the share of cases with a smaller "
        "error, and its right end shows the worst cases.",
    }
    titles = {
        "best": "Performance profile against the best",
        "baseline": f"Performance profile against {record.baseline}",
    }
    if table.empty:
        return []
    return [
        _profile(record, table[table["against"] == against], against, titles[against], notes[against])
        for against in ("best", "baseline")
        if (table["against"] == against).any()
    ]


def _profile(record: Record, table: pd.DataFrame, key: str, title: str, note: str) -> Plot:
    looks = looks_of(record.names)
    parts = {name: table[table["controller"] == name].sort_values("tau") for name in record.names}
    parts = {name: part for name, part in parts.items() if len(part)}

    def paint(axes: Axes) -> None:
        axes.set_xscale("log")
        for name, part in parts.items():
            axes.step(part["tau"], 100.0 * part["share"], where="post", label=name, **looks[name].stroke)
        ends = (float(table["tau"].min()), float(table["tau"].max()))
        ticks(
            axes.xaxis,
            [tick for tick in (0.25, 0.5, 0.71, 1.0, 1.5, 2.0, 3.0, 5.0, 10.0) if ends[0] <= tick <= ends[1]],
        )
        axes.set(xlabel="τ", ylabel="share of cases, %", ylim=(0.0, 102.0), xlim=ends)
        axes.axvline(1.0, color=INK, linewidth=0.8)

    places = (1.0, 1.5, 2.0)
    rows = {
        name: [(f"τ = {setting(tau)}", 100.0 * float(np.interp(tau, part["tau"], part["share"]))) for tau in places]
        for name, part in parts.items()
    }
    return one_panel(f"profile-{key}", title, note, description(title, rows, " %"), paint)


def gap_plot(record: Record) -> list[Plot]:
    """Share of the gap between the baseline and the best found that each controller closes."""
    rows = {name: interval(record.against(name), "gap") for name in record.names[1:]}
    rows = {name: value for name, value in rows.items() if np.isfinite(value.value)}
    if not rows:
        return []
    looks = looks_of(record.names)

    def paint(axes: Axes) -> None:
        for place, (name, value) in enumerate(rows.items()):
            axes.barh(place, 100.0 * value.value, height=0.55, color=looks[name].colour)
            lengths = np.nan_to_num(100.0 * np.array([[value.value - value.low], [value.high - value.value]]))
            axes.errorbar(100.0 * value.value, place, xerr=np.maximum(lengths, 0.0), color=INK)
        axes.axvline(0.0, color=INK, linewidth=0.8)
        axes.axvline(100.0, color=INK, linewidth=0.8, linestyle="--")
        row_axis(axes, list(rows))
        axes.set_xlabel(f"closed share of the gap, %: 0 = {record.baseline}, 100 = best found")

    title = "Share of the gap to the best found"
    note = f"(error of {record.baseline} − error) ÷ (error of {record.baseline} − best found); bars: 95 % interval."
    alt = description(title, {name: [("gap", 100.0 * value.value)] for name, value in rows.items()}, " %")
    return [one_panel("gap", title, note, alt, paint, max(HEIGHT - 0.8, 0.9 + 0.35 * len(rows)))]


def failure_plots(record: Record) -> list[Plot]:
    """The worst cases of every controller, with the baseline beside it; the same colours as elsewhere."""
    looks = looks_of(record.names)
    return [example_plot(trace.example, f"worst-{number}", looks) for number, trace in enumerate(record.traces, 1)]


def bode_plots(record: Record) -> list[Plot]:
    """Gain and phase over frequency for the tightest and the most leaking seal, with and without preview."""
    table = record.table("frequency")
    if table.empty:
        return []
    leaks = sorted(float(leak) for leak in table["leakage_flow_lpm"].unique())
    plots = []
    for preview in (True, False):
        for leak in dict.fromkeys((leaks[0], leaks[-1])):
            part = table[(table["preview"] == preview) & (table["leakage_flow_lpm"] == leak)]
            if len(part):
                plots.append(_bode(record, part, preview, leak))
    return plots


def _bode(record: Record, table: pd.DataFrame, preview: bool, leak: float) -> Plot:
    looks = {name: look for name, look in looks_of(record.names).items() if (table["controller"] == name).any()}
    curves = {
        name: table[table["controller"] == name].groupby("frequency_hz")[["gain", "phase_deg"]].median()
        for name in looks
    }

    def paint(figure: Figure) -> None:
        above, below = figure.subplots(2, 1, sharex=True)
        for name, curve in curves.items():
            above.plot(curve.index, 20.0 * np.log10(curve["gain"]), label=name, **looks[name].stroke)
            below.plot(curve.index, curve["phase_deg"], **looks[name].stroke)
        above.axhline(-3.0, color=INK, linewidth=0.8, linestyle=":")
        below.axhline(-90.0, color=INK, linewidth=0.8, linestyle=":")
        above.set(ylabel="gain, dB", ylim=(-21.0, 12.0), yticks=[-20, -10, -3, 0, 10])
        below.set(ylabel="phase, °", xlabel="frequency, Hz", xscale="log", ylim=(-280.0, 60.0))
        below.set_yticks([-270, -180, -90, 0])
        ticks(below.xaxis, FREQUENCY_TICKS)
        figure.align_ylabels()
        add_legend(above)

    seal = f"leak of {setting(leak)} l/min"
    title = f"Frequency response, {seal}, {'with preview' if preview else 'preview hidden'}"
    note = "Reference to true position, median of the plants; dotted: −3 dB and −90°."
    rows = {
        name: [(f"{setting(f)} Hz", float(curve["gain"].iloc[i])) for i, f in enumerate(curve.index)]
        for name, curve in curves.items()
    }
    alt = description(f"{title}: gain", rows, "")
    key = f"bode-{'preview' if preview else 'hidden'}-{setting(leak)}"
    return make_plot(key, title, note, alt, paint, 4.2)


def stiffness_plots(record: Record) -> list[Plot]:
    """Peak deviation after a force step by leak, and compliance over frequency healthy and leaking."""
    plots = []
    step, sine = record.table("force_step"), record.table("force_sine")
    looks = looks_of(record.names)
    if not step.empty:
        note = "Largest and remaining deviation per force, median of the plants; bars: lowest and highest plant."
        for column, title in (
            ("dynamic_mm_per_kn", "Force step: largest deviation"),
            ("static_mm_per_kn", "Force step: remaining deviation"),
        ):
            plots.append(_by_leak(step, column, title, note, looks))
    if not sine.empty:
        leaks = sorted(float(leak) for leak in sine["leakage_flow_lpm"].unique())
        for leak in dict.fromkeys((leaks[0], leaks[-1])):
            plots.append(_compliance(sine[sine["leakage_flow_lpm"] == leak], leak, looks))
    return plots


def _by_leak(table: pd.DataFrame, column: str, title: str, note: str, looks: Mapping[Any, Look]) -> Plot:
    leaks = sorted(float(leak) for leak in table["leakage_flow_lpm"].unique())
    names = [name for name in looks if (table["controller"] == name).any()]
    parts = {
        name: table[table["controller"] == name]
        .groupby("leakage_flow_lpm")[column]
        .agg(value="median", low="min", high="max")
        for name in names
    }

    def paint(axes: Axes) -> None:
        places = level_axis(axes, leaks)
        for index, (name, part) in enumerate(parts.items()):
            at = np.array([places[float(leak)] for leak in part.index]) + dodge(len(parts), index, 0.04)
            bars(axes, at, part, "value", looks[name], name)
        axes.set(ylabel="deviation, mm per kN", ylim=(0.0, None))
        axes.margins(x=0.06)

    rows = {
        name: [(f"{setting(leak)} l/min", value) for leak, value in part["value"].items()]
        for name, part in parts.items()
    }
    return one_panel(f"by-leak-{column}", title, note, description(title, rows, " mm/kN"), paint)


def _compliance(table: pd.DataFrame, leak: float, looks: Mapping[Any, Look]) -> Plot:
    names = [name for name in looks if (table["controller"] == name).any()]
    curves = {
        name: table[table["controller"] == name].groupby("frequency_hz")["compliance_mm_per_kn"].median()
        for name in names
    }

    def paint(axes: Axes) -> None:
        for name, curve in curves.items():
            axes.plot(curve.index, curve, label=name, marker=looks[name].marker, **looks[name].stroke)
        axes.set(xscale="log", yscale="log", xlabel="frequency of the force, Hz", ylabel="deviation, mm per kN")
        ticks(axes.xaxis, [1.0, 2.0, 5.0, 10.0, 20.0])
        ticks(axes.yaxis, [0.003, 0.01, 0.03, 0.1, 0.3, 1.0, 3.0])
        axes.set_ylim(min(0.004, 0.8 * min(map(min, curves.values()))), max(0.6, 1.25 * max(map(max, curves.values()))))

    title = f"Sinusoidal force, leak of {setting(leak)} l/min"
    note = "Amplitude of the position per amplitude of the force, median of the plants; lower is stiffer."
    rows = {name: [(f"{setting(f)} Hz", value) for f, value in curve.items()] for name, curve in curves.items()}
    alt = description(title, rows, " mm/kN")
    return one_panel(f"compliance-{setting(leak)}", title, note, alt, paint)
