"""Sections of the experiments on one axis: frequency response, stiffness, standstill."""

from __future__ import annotations

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


# Frequency response -------------------------------------------------------------------------------------------------


@section("Frequency response", needs=("frequency",))
def frequency(content: Content) -> list[Block]:
    """Bode plots and bandwidths, with and without preview."""
    return [
        Text(
            "A small sine as reference, one frequency after the other, on drawn plants with sensor noise; "
            "least-squares fit of the true position. With preview, a controller knows the sine ahead and can start "
            "early; with the preview hidden, it sees only the present reference. The controllers were not tuned "
            "again: without preview, its lead is missing."
        ),
        *bode_plots(content),
        *bandwidth_tables(content),
    ]


def leaks_of(table: pd.DataFrame) -> list[float]:
    """The leaks of a table, l/min at 100 bar, from small to large."""
    return sorted(float(leak) for leak in table["leakage_flow_lpm"].unique())


def by_controller(content: Content, table: pd.DataFrame) -> dict[str, pd.DataFrame]:
    """The rows of each controller that a table contains."""
    parts = {name: table[table["controller"] == name] for name in content.looks}
    return {name: part for name, part in parts.items() if len(part)}


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
    curves = {
        name: own.groupby("frequency_hz")[["gain", "phase_deg"]].median()
        for name, own in by_controller(content, table).items()
    }

    def paint(figure: Figure) -> None:
        above, below = figure.subplots(2, 1, sharex=True)
        for name, curve in curves.items():
            stroke = content.looks[name].stroke
            above.plot(curve.index, 20.0 * np.log10(curve["gain"]), label=name, **stroke)
            below.plot(curve.index, curve["phase_deg"], **stroke)
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
    rows = {name: [(f"{setting(f)} Hz", gain) for f, gain in curve["gain"].items()] for name, curve in curves.items()}
    alt = description(f"{title}: gain", rows, "")
    key = f"bode-{'preview' if preview else 'hidden'}-{setting(leak)}"
    return make_plot(key, title, note, alt, paint, 4.2)


def bandwidth_tables(content: Content) -> list[Table]:
    """Frequencies at −3 dB and −90°, by leak, with and without preview."""
    table = content.table("frequency")
    found = bandwidths(table)
    highest = float(table["frequency_hz"].max())
    tables = []
    for preview, text in ((True, "with the preview that the controller sees"), (False, "with the preview hidden")):
        part = found[found["preview"] == preview]
        leaks, rows = leaks_of(part), []
        for name, own in part.groupby("controller", sort=False):
            by_leak = own.set_index("leakage_flow_lpm")
            ends = by_leak.loc[leaks, ["minus_3_db_hz", "minus_90_deg_hz"]].to_numpy().ravel()
            cells = (f"> {setting(highest)}" if np.isinf(value) else number(value, 1) for value in ends)
            rows.append((str(name), *cells, number(float(by_leak.loc[leaks[0], "peak_gain"]), 2)))
        header = ("Controller", *("−3 dB, Hz", "−90°, Hz") * len(leaks), "at the tight seal")
        groups = (*((f"{setting(leak)} l/min", 2) for leak in leaks), ("largest gain", 1))
        if rows:
            tables.append(Table(f"Bandwidth {text}; median of the plants", header, rows, groups))
    return tables


# Stiffness ----------------------------------------------------------------------------------------------------------


@section("Stiffness", needs=("force_step",))
def stiffness(content: Content) -> list[Block]:
    """Deviations under a force step and a sinusoidal force."""
    return [
        Text(
            "An external force pushes an axis that holds its position. Static stiffness: force ÷ remaining deviation. "
            "Dynamic stiffness: force ÷ largest deviation. The runs have no sensor noise, which would hide the "
            "recovery. With a leak the load moves until the controller responds; the same leak damps the oscillation "
            "of the oil columns."
        ),
        *stiffness_plots(content),
        stiffness_table(content),
    ]


def stiffness_plots(content: Content) -> list[Plot]:
    """Peak deviation after a force step by leak, and compliance over frequency healthy and leaking."""
    note = "Largest and remaining deviation per force, median of the plants; bars: lowest and highest plant."
    titles = {"dynamic_mm_per_kn": "largest deviation", "static_mm_per_kn": "remaining deviation"}
    plots = []
    for column, title in titles.items() if content.has("force_step") else ():
        curves = {
            name: own.groupby("leakage_flow_lpm")[column].agg(value="median", low="min", high="max")
            for name, own in by_controller(content, content.table("force_step")).items()
        }

        def finish(axes: Axes) -> None:
            axes.set(ylabel="deviation, mm per kN", ylim=(0.0, None))

        named = (f"by-leak-{column}", f"Force step: {title}", note)
        plots.append(curve_plot(*named, curves, content.looks, " mm/kN", finish, levels=True, apart=0.04))
    leaks = leaks_of(content.table("force_sine")) if content.has("force_sine") else []
    return plots + [_compliance(content, leak) for leak in dict.fromkeys((*leaks[:1], *leaks[-1:]))]


def _compliance(content: Content, leak: float) -> Plot:
    table = content.rows("force_sine", leakage_flow_lpm=leak)
    curves = {
        name: own.groupby("frequency_hz")["compliance_mm_per_kn"].median()
        for name, own in by_controller(content, table).items()
    }

    def finish(axes: Axes) -> None:
        axes.set(xscale="log", yscale="log", xlabel="frequency of the force, Hz", ylabel="deviation, mm per kN")
        ticks(axes.xaxis, [1.0, 2.0, 5.0, 10.0, 20.0])
        ticks(axes.yaxis, [0.003, 0.01, 0.03, 0.1, 0.3, 1.0, 3.0])
        axes.set_ylim(min(0.004, 0.8 * min(map(min, curves.values()))), max(0.6, 1.25 * max(map(max, curves.values()))))

    title = f"Sinusoidal force, leak of {setting(leak)} l/min"
    note = "Amplitude of the position per amplitude of the force, median of the plants; lower is stiffer."
    key = f"compliance-{setting(leak)}"
    return curve_plot(key, title, note, curves, content.looks, " mm/kN", finish, " Hz")


def stiffness_table(content: Content) -> Table:
    """Static and dynamic stiffness by leak, medians of the plants."""
    table = content.table("force_step")
    leaks = leaks_of(table)
    rows = []
    for name, own in table.groupby("controller", sort=False):
        parts = [own[own["leakage_flow_lpm"] == leak] for leak in leaks]
        columns = ("remaining_mm", "peak_mm")
        cells = [(*(stiffness_text(part, column) for column in columns), _recovery(part)) for part in parts]
        rows.append((str(name), *(text for part in cells for text in part)))
    header = ("Controller", *("static, N/mm", "dynamic, N/mm", "recovered after, ms") * len(leaks))
    groups = tuple((f"{setting(leak)} l/min", 3) for leak in leaks)
    force = number(float(table["force_n"].iloc[0]), 0)
    caption = f"Stiffness against a force step of {force} N; median of the plants"
    return Table(caption, header, rows, groups, "dense")


def _recovery(part: pd.DataFrame) -> str:
    """Median time of the plants that recovered, and their number if not all did."""
    times = part["recovery_s"].dropna()
    text = number(1e3 * float(times.median()), 0)
    return text if len(times) == len(part) else f"{text} ({len(times)} of {len(part)})" if len(times) else "never"


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
    return [
        Text(
            "Noise moves every stiff loop; a limit cycle is motion that remains without noise. Each case runs twice: "
            "without sensor noise after a small step (a remaining oscillation of more than one step of the position "
            "sensor at 0.5 Hz or faster is a limit cycle), and with noise."
        ),
        *standstill_tables(content),
        *([Fold("Limit cycles under each condition", cycles)] if cycles else []),
    ]


def standstill_tables(content: Content) -> list[Table]:
    """Limit cycles by leak, and residual motion, offset and valve travel with noise."""
    table = content.table("standstill")
    leaks = leaks_of(table)
    header = ("Controller", *(f"{setting(leak)} l/min" for leak in leaks))
    cycles, rest = [], []
    for name, own in table.groupby("controller", sort=False):
        parts = [own[own["leakage_flow_lpm"] == leak] for leak in leaks]
        cycles.append((str(name), *(_cycles(part) for part in parts)))
        cells = [number(float(own[key].mean()), 1) for key in ("unrest_um", "offset_um")]
        rest.append((str(name), *cells, number(float(own["valve_travel_per_s"].mean()), 2)))
    words = ("Controller", "residual motion, µm RMS", "offset, µm", "valve travel, strokes per s")
    return [
        Table("Held positions with a limit cycle (largest amplitude, its frequency)", header, cycles),
        Table("At rest under sensor noise, mean over all leaks", words, rest),
    ]


@section("Pauses and changes of the controller", needs=("pauses", "take_over"))
def transitions(content: Content) -> list[Block]:
    """Moves after pauses, and controllers that take over in motion."""
    pauses, changes = content.table("pauses"), content.table("take_over")
    after, taken = [], []
    for name, own in pauses.groupby("controller", sort=False):
        parts = [own[own["pause_s"] == pause] for pause in pauses["pause_s"].unique()]
        cells = [f"{number(float(part['peak_um'].mean()), 0)} ({part['peak_um'].max():.0f})" for part in parts]
        after.append((str(name), *cells, number(float(parts[-1]["rest_um"].mean()), 1)))
    for name, own in changes.groupby("controller", sort=False):
        parts = [own[own["family"] == family] for family in changes["family"].unique()]
        columns = ("largest_um", "never_switched_um", "handed_over_um")
        taken.append((str(name), *(number(float(part[key].mean()), 0) for part in parts for key in columns)))
    lengths = [f"{setting(pause)} s" for pause in pauses["pause_s"].unique()]
    words = ("largest", "never switched", "handed over")
    return [
        Text(
            "One smooth move after a pause, and a controller that takes over from the first one while the axis moves. "
            "Errors in µm in the frame of the position sensor, means over plants and leaks."
        ),
        Table(
            "Largest error in the first 0.3 s of a move after a pause (worst case); error at rest",
            ("Controller", *lengths, "at rest"),
            after,
        ),
        Table(
            "Largest error in the 0.2 s after a controller takes over; the same of a controller that drove from the "
            "start; error that the first controller hands over",
            ("Controller", *(f"{family}: {word}" for family in changes["family"].unique() for word in words)),
            taken,
        ),
    ]


def cycles_by_condition(content: Content) -> list[Table]:
    """Limit cycles at mid-stroke under every condition in which any controller has one."""
    table, names = content.table("limit_cycles"), content.controllers
    if table.empty:
        return []
    counts = table.groupby(["condition", "controller"], sort=False)["limit_cycle"].agg(["sum", "count"]).astype(int)
    rows = []
    for condition in table["condition"].unique():
        own = {name: counts.loc[(condition, name)] for name in names if (condition, name) in counts.index}
        if any(part["sum"] for part in own.values()):
            cells = [f"{own[name]['sum']} of {own[name]['count']}" if name in own else "–" for name in names]
            rows.append((content.label(str(condition)), *cells))
    quiet = table["condition"].nunique() - len(rows)
    caption = f"Limit cycles by condition; none under the other {quiet}" if quiet else "Limit cycles by condition"
    return [Table(caption, ("Condition", *names), rows)] if rows else []


def _cycles(part: pd.DataFrame) -> str:
    found = part[part["limit_cycle"].astype(bool)].sort_values("amplitude_um")
    if found.empty:
        return f"0 of {len(part)}"
    largest = found.iloc[-1]
    size, frequency = number(float(largest["amplitude_um"]), 0), number(float(largest["frequency_hz"]), 1)
    return f"{len(found)} of {len(part)} ({size} µm, {frequency} Hz)"
