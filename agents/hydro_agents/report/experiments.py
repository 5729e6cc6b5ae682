"""Sections of the experiments on one axis: frequency response, stiffness, standstill."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import chain
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from hydro_agents.evaluation.experiments import bandwidths
from hydro_agents.report.canvas import INK, Plot, add_legend, curve_plot, description, make_plot, ticks
from hydro_agents.report.content import Content
from hydro_agents.report.sections import Block, Fold, Text, section
from hydro_agents.running.text import Table, number, setting

FREQUENCY_TICKS = (0.5, 1.0, 2.0, 5.0, 10.0, 20.0, 50.0)

LEAST_DEVIATION = 1e-3
"""mm; a smaller deviation gives only a lower limit of the stiffness."""


def leaks_of(table: pd.DataFrame) -> list[float]:
    """The leaks of a table, l/min at 100 bar, from small to large."""
    leaks: list[float] = sorted(table["leakage_flow_lpm"].unique().tolist())
    return leaks


def by_controller(content: Content, table: pd.DataFrame) -> dict[str, pd.DataFrame]:
    """The rows of each controller that a table contains."""
    parts = {name: table[table["controller"] == name] for name in content.looks}
    return {name: part for name, part in parts.items() if len(part)}


def by_leak(table: pd.DataFrame) -> Iterator[tuple[str, list[pd.DataFrame]]]:
    """The rows of each controller at each leak of a table."""
    for name, own in table.groupby("controller", sort=False):
        yield name, [own[own["leakage_flow_lpm"] == leak] for leak in leaks_of(table)]


# Frequency response -------------------------------------------------------------------------------------------------


@section("Frequency response", needs=("frequency",))
def frequency(content: Content) -> list[Block]:
    """Bode plots and bandwidths, with and without preview."""
    note = (
        "A small sine as reference, one frequency after the other, on drawn plants with sensor noise; least-squares "
        "fit of the true position. With preview, a controller knows the sine ahead and can start early; with the "
        "preview hidden, it sees only the present reference. The controllers were not tuned again: without preview, "
        "its lead is missing."
    )
    return [Text(note), *bode_plots(content), *bandwidth_tables(content)]


def bode_plots(content: Content) -> list[Plot]:
    """Gain and phase over frequency for the tightest and the most leaking seal, with and without preview."""
    leaks = leaks_of(content.table("frequency"))
    return [
        _bode(content, part, preview, leak)
        for preview in (True, False)
        for leak in dict.fromkeys((leaks[0], leaks[-1]))
        if len(part := content.rows("frequency", preview=preview, leakage_flow_lpm=leak))
    ]


def _bode(content: Content, table: pd.DataFrame, preview: bool, leak: float) -> Plot:
    parts = by_controller(content, table)
    curves = {name: own.groupby("frequency_hz")[["gain", "phase_deg"]].median() for name, own in parts.items()}

    def paint(figure: Figure) -> None:
        above, below = figure.subplots(2, 1, sharex=True)
        for name, curve in curves.items():
            stroke = content.looks[name].stroke
            above.plot(curve.index, 20.0 * np.log10(curve["gain"]), label=name, **stroke)
            below.plot(curve.index, curve["phase_deg"], **stroke)
        for axes, level in ((above, -3.0), (below, -90.0)):
            axes.axhline(level, color=INK, linewidth=0.8, linestyle=":")
        above.set(ylabel="gain, dB", ylim=(-21.0, 12.0), yticks=[-20, -10, -3, 0, 10])
        below.set(ylabel="phase, °", xlabel="frequency, Hz", xscale="log", ylim=(-280.0, 60.0))
        below.set_yticks([-270, -180, -90, 0])
        ticks(below.xaxis, FREQUENCY_TICKS)
        figure.align_ylabels()
        add_legend(above)

    title = f"Frequency response, leak of {setting(leak)} l/min, {'with preview' if preview else 'preview hidden'}"
    note = "Reference to true position, median of the plants; dotted: −3 dB and −90°."
    rows = {name: [(f"{setting(f)} Hz", gain) for f, gain in curve["gain"].items()] for name, curve in curves.items()}
    key = f"bode-{'preview' if preview else 'hidden'}-{setting(leak)}"
    return make_plot(key, title, note, description(f"{title}: gain", rows, ""), paint, 4.2)


def bandwidth_tables(content: Content) -> list[Table]:
    """Frequencies at −3 dB and −90°, by leak, with and without preview."""
    table = content.table("frequency")
    highest = f"> {setting(table['frequency_hz'].max())}"
    found = bandwidths(table)
    tables = []
    for preview, text in ((True, "with the preview that the controller sees"), (False, "with the preview hidden")):
        rows = []
        part = found[found["preview"] == preview]
        for name, parts in by_leak(part):
            ends = pd.concat(parts)[["minus_3_db_hz", "minus_90_deg_hz"]].to_numpy().ravel()
            cells = (highest if np.isinf(value) else number(value, 1) for value in ends)
            rows.append((name, *cells, number(parts[0]["peak_gain"].iloc[0], 2)))
        leaks = leaks_of(part)
        header = ("Controller", *("−3 dB, Hz", "−90°, Hz") * len(leaks), "at the tight seal")
        groups = (*((f"{setting(leak)} l/min", 2) for leak in leaks), ("largest gain", 1))
        if rows:
            tables.append(Table(f"Bandwidth {text}; median of the plants", header, rows, groups))
    return tables


# Stiffness ----------------------------------------------------------------------------------------------------------


@section("Stiffness", needs=("force_step",))
def stiffness(content: Content) -> list[Block]:
    """Deviations under a force step and a sinusoidal force."""
    note = (
        "An external force pushes an axis that holds its position. Static stiffness: force ÷ remaining deviation. "
        "Dynamic stiffness: force ÷ largest deviation. The runs have no sensor noise, which would hide the recovery. "
        "With a leak the load moves until the controller responds; the same leak damps the oscillation of the oil "
        "columns."
    )
    return [Text(note), *stiffness_plots(content), stiffness_table(content)]


def stiffness_plots(content: Content) -> list[Plot]:
    """Peak deviation after a force step by leak, and compliance over frequency healthy and leaking."""
    note = "Largest and remaining deviation per force, median of the plants; bars: lowest and highest plant."
    titles = {"dynamic_mm_per_kn": "largest deviation", "static_mm_per_kn": "remaining deviation"}
    options: dict[str, Any] = {"ylabel": "deviation, mm per kN", "ylim": (0.0, None)}
    parts, plots = by_controller(content, content.table("force_step")), []
    for column, title in titles.items():
        curves = {
            name: own.groupby("leakage_flow_lpm")[column].agg(value="median", low="min", high="max")
            for name, own in parts.items()
        }
        named = (f"by-leak-{column}", f"Force step: {title}", note)
        plots.append(curve_plot(*named, curves, content.looks, " mm/kN", apart=0.04, drawn="levels", **options))
    leaks = leaks_of(content.table("force_sine")) if content.has("force_sine") else []
    return plots + [_compliance(content, leak) for leak in dict.fromkeys((*leaks[:1], *leaks[-1:]))]


def _compliance(content: Content, leak: float) -> Plot:
    parts = by_controller(content, content.rows("force_sine", leakage_flow_lpm=leak))
    curves = {name: own.groupby("frequency_hz")["compliance_mm_per_kn"].median() for name, own in parts.items()}
    values = pd.concat(curves)

    def finish(axes: Axes) -> None:
        axes.set(xscale="log", yscale="log", xlabel="frequency of the force, Hz", ylabel="deviation, mm per kN")
        ticks(axes.xaxis, [1.0, 2.0, 5.0, 10.0, 20.0])
        ticks(axes.yaxis, [0.003, 0.01, 0.03, 0.1, 0.3, 1.0, 3.0])
        axes.set_ylim(min(0.004, 0.8 * values.min()), max(0.6, 1.25 * values.max()))

    title = f"Sinusoidal force, leak of {setting(leak)} l/min"
    note = "Amplitude of the position per amplitude of the force, median of the plants; lower is stiffer."
    key = f"compliance-{setting(leak)}"
    return curve_plot(key, title, note, curves, content.looks, " mm/kN", finish, " Hz")


def stiffness_table(content: Content) -> Table:
    """Static and dynamic stiffness by leak, medians of the plants."""
    table = content.table("force_step")
    rows = []
    for name, parts in by_leak(table):
        cells = [
            (stiffness_text(part, "remaining_mm"), stiffness_text(part, "peak_mm"), _recovery(part)) for part in parts
        ]
        rows.append((name, *chain.from_iterable(cells)))
    leaks = leaks_of(table)
    header = ("Controller", *("static, N/mm", "dynamic, N/mm", "recovered after, ms") * len(leaks))
    groups = tuple((f"{setting(leak)} l/min", 3) for leak in leaks)
    caption = f"Stiffness against a force step of {number(table['force_n'].iloc[0], 0)} N; median of the plants"
    return Table(caption, header, rows, groups, "dense")


def _recovery(part: pd.DataFrame) -> str:
    """Median time of the plants that recovered, and their number if not all did."""
    times = part["recovery_s"].dropna()
    if times.empty and len(part):
        return "never"
    text = number(1e3 * times.median(), 0)
    return text if len(times) == len(part) else f"{text} ({len(times)} of {len(part)})"


def stiffness_text(part: pd.DataFrame, column: str) -> str:
    """Force over deviation, rounded to two digits, with ≥ if the deviation is too small."""
    force, deviation = float(part["force_n"].iloc[0]), float(part[column].median())
    value = force / max(deviation, LEAST_DEVIATION)
    size = 10.0 ** (int(np.floor(np.log10(value))) - 1)
    text = f"{size * round(value / size):,.0f}".replace(",", "\u2009")
    return f"≥ {text}" if deviation <= LEAST_DEVIATION else text


# Standstill ---------------------------------------------------------------------------------------------------------


@section("Standstill", needs=("standstill",))
def standstill(content: Content) -> list[Block]:
    """Limit cycles, and residual motion with noise."""
    cycles = cycles_by_condition(content)
    note = (
        "Noise moves every stiff loop; a limit cycle is motion that remains without noise. Each case runs twice: "
        "without sensor noise after a small step (a remaining oscillation of more than one step of the position sensor "
        "at 0.5 Hz or faster is a limit cycle), and with noise."
    )
    folded = [Fold("Limit cycles under each condition", cycles)] if cycles else []
    return [Text(note), *standstill_tables(content), *folded]


def standstill_tables(content: Content) -> list[Table]:
    """Limit cycles by leak, and residual motion, offset and valve travel with noise."""
    table = content.table("standstill")
    cycles = [(name, *map(_cycles, parts)) for name, parts in by_leak(table)]
    decimals = {"unrest_um": 1, "offset_um": 1, "valve_travel_per_s": 2}
    means = table.groupby("controller", sort=False)[list(decimals)].mean()
    rest = [(name, *map(number, own, decimals.values())) for name, own in means.iterrows()]
    leaks = (f"{setting(leak)} l/min" for leak in leaks_of(table))
    words = ("residual motion, µm RMS", "offset, µm", "valve travel, strokes per s")
    return [
        Table("Held positions with a limit cycle (largest amplitude, its frequency)", ("Controller", *leaks), cycles),
        Table("At rest under sensor noise, mean over all leaks", ("Controller", *words), rest),
    ]


def _cycles(part: pd.DataFrame) -> str:
    cycles = part[part["limit_cycle"].astype(bool)].sort_values("amplitude_um")
    count = f"{len(cycles)} of {len(part)}"
    if cycles.empty:
        return count
    largest = cycles.iloc[-1]
    return f"{count} ({number(largest['amplitude_um'], 0)} µm, {number(largest['frequency_hz'], 1)} Hz)"


def cycles_by_condition(content: Content) -> list[Table]:
    """Limit cycles at mid-stroke under every condition in which any controller has one."""
    table = content.table("limit_cycles")
    if table.empty:
        return []
    by_cell = table.groupby(["condition", "controller"], sort=False)["limit_cycle"].agg(["sum", "count"]).astype(int)
    texts = by_cell["sum"].astype(str) + " of " + by_cell["count"].astype(str)
    some = by_cell["sum"].groupby(level=0, sort=False).sum()
    cells = texts.unstack(fill_value="–").reindex(columns=content.controllers, fill_value="–")
    rows = [(content.label(condition), *cells.loc[condition]) for condition in some.index[some > 0]]
    quiet = len(some) - len(rows)
    caption = f"Limit cycles by condition; none under the other {quiet}" if quiet else "Limit cycles by condition"
    return [Table(caption, ("Condition", *content.controllers), rows)] if rows else []


# Pauses -------------------------------------------------------------------------------------------------------------


@section("Pauses and changes of the controller", needs=("pauses", "take_over"))
def transitions(content: Content) -> list[Block]:
    """Moves after pauses, and controllers that take over in motion."""
    note = (
        "One smooth move after a pause, and a controller that takes over from the first one while the axis moves. "
        "Errors in µm in the frame of the position sensor, means over plants and leaks."
    )
    return [Text(note), _pauses_table(content.table("pauses")), _take_over_table(content.table("take_over"))]


def _pauses_table(pauses: pd.DataFrame) -> Table:
    lengths, rows = pauses["pause_s"].unique(), []
    for name, own in pauses.groupby("controller", sort=False):
        by_pause = own.groupby("pause_s", sort=False)
        peaks = by_pause["peak_um"].agg(["mean", "max"]).loc[lengths]
        cells = (f"{number(mean, 0)} ({largest:.0f})" for mean, largest in peaks.to_numpy())
        rows.append((name, *cells, number(by_pause["rest_um"].mean()[lengths[-1]], 1)))
    caption = "Largest error in the first 0.3 s of a move after a pause (worst case); error at rest"
    return Table(caption, ("Controller", *(f"{setting(pause)} s" for pause in lengths), "at rest"), rows)


def _take_over_table(changes: pd.DataFrame) -> Table:
    words = {"largest_um": "largest", "never_switched_um": "never switched", "handed_over_um": "handed over"}
    families = changes["family"].unique()
    means = changes.groupby(["controller", "family"], sort=False)[list(words)].mean()
    rows = []
    for name in changes["controller"].unique():
        rows.append((name, *(number(value, 0) for value in means.loc[name].reindex(families).to_numpy().ravel())))
    caption = (
        "Largest error in the 0.2 s after a controller takes over; the same of a controller that drove from the start; "
        "error that the first controller hands over"
    )
    return Table(
        caption, ("Controller", *(f"{family}: {word}" for family in families for word in words.values())), rows
    )
