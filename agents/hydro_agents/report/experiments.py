"""Sections of the experiments on one axis: frequency response, stiffness, standstill."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes

from hydro_agents.evaluation.experiments import bandwidths
from hydro_agents.report.canvas import INK, Plot, curve_plot, ticks
from hydro_agents.report.content import Content
from hydro_agents.report.sections import Block, Fold, Text, section
from hydro_agents.running.text import Table, number, setting

FREQUENCY_TICKS = (0.5, 1.0, 2.0, 5.0, 10.0, 20.0, 50.0)

BODE = {"gain": ("gain, dB", -3.0, [-20, -10, -3, 0, 10]), "phase_deg": ("phase, °", -90.0, [-270, -180, -90, 0])}
"""Columns of a frequency response: label, marked level, ticks."""

LEAST_DEVIATION = 1e-3
"""mm; a smaller deviation gives only a lower limit of the stiffness."""


def ends_of(table: pd.DataFrame) -> list[float]:
    """The smallest and the largest leak of a table, l/min at 100 bar; one if they are the same."""
    leaks = table["leakage_flow_lpm"]
    return list(dict.fromkeys((float(leaks.min()), float(leaks.max()))))


def by_controller(content: Content, table: pd.DataFrame) -> dict[str, pd.DataFrame]:
    """The rows of each controller that a table contains."""
    parts = {name: table[table["controller"] == name] for name in content.looks}
    return {name: part for name, part in parts.items() if len(part)}


def spread(
    caption: str,
    table: pd.DataFrame,
    cells: Mapping[str, Callable[[pd.DataFrame], str]],
    by: str = "leakage_flow_lpm",
    unit: str = " l/min",
    style: str = "",
) -> Table:
    """A row per controller, and for each value of the column ``by`` some cells, by their titles."""
    values, rows = table[by].unique(), []
    for name, own in table.groupby("controller", sort=False):
        parts = (own[own[by] == value] for value in values)
        rows.append((name, *(cell(part) for part in parts for cell in cells.values())))
    labels = [value if isinstance(value, str) else f"{setting(value)}{unit}" for value in values]
    if len(cells) == 1:
        return Table(caption, ("Controller", *labels), rows, style=style)
    groups = tuple((label, len(cells)) for label in labels)
    return Table(caption, ("Controller", *list(cells) * len(labels)), rows, groups, style)


def cell_of(column: str, decimals: int, how: str = "mean") -> Callable[[pd.DataFrame], str]:
    """The cell with the mean or the median of a column."""
    return lambda part: number(part[column].agg(how), decimals)


# Frequency response -------------------------------------------------------------------------------------------------


@section("Frequency response", needs=("frequency",))
def frequency(content: Content) -> list[Block]:
    """Bode plots and bandwidths, with and without preview."""
    note = (
        "A small sine as reference, one frequency after the other, on drawn plants with sensor noise; least-squares "
        "fit of the true position. With preview, a controller knows the sine ahead and can start early; with the "
        "preview hidden, it sees only the present reference. The controllers were not tuned again: without preview, "
        "its lead is missing. ∞: beyond the sweep."
    )
    return [Text(note), *bode_plots(content), *bandwidth_tables(content)]


def bode_plots(content: Content) -> list[Plot]:
    """Gain and phase over frequency for the tightest and the most leaking seal, with and without preview."""
    return [
        _bode(
            content, part, column, f"leak of {setting(leak)} l/min, {'with preview' if preview else 'preview hidden'}"
        )
        for preview in (True, False)
        for leak in ends_of(content.table("frequency"))
        if len(part := content.rows("frequency", preview=preview, leakage_flow_lpm=leak))
        for column in BODE
    ]


def _bode(content: Content, table: pd.DataFrame, column: str, what: str) -> Plot:
    label, level, places = BODE[column]
    curves = {name: own.groupby("frequency_hz")[column].median() for name, own in by_controller(content, table).items()}
    if column == "gain":
        curves = {name: 20.0 * np.log10(curve) for name, curve in curves.items()}

    def finish(axes: Axes) -> None:
        axes.axhline(level, color=INK, linewidth=0.8, linestyle=":")
        axes.set(xscale="log", yticks=places, ylim=(1.05 * places[0], 60.0 if level == -90.0 else 12.0))
        ticks(axes.xaxis, FREQUENCY_TICKS)

    name = label.partition(",")[0]
    named = (re.sub(r"\W+", "-", f"bode {name} {what}"), f"{name.capitalize()}, {what}")
    note = "Reference to true position, median of the plants; dotted: −3 dB or −90°."
    labels: dict[str, Any] = {"xlabel": "frequency, Hz", "ylabel": label}
    return curve_plot(*named, note, curves, content.looks, "", finish, " Hz", drawn="plain", **labels)


def bandwidth_tables(content: Content) -> list[Table]:
    """Frequencies at −3 dB and −90°, and the largest gain, by leak, with and without preview."""
    cells = {"−3 dB, Hz": cell_of("minus_3_db_hz", 1, "median"), "−90°, Hz": cell_of("minus_90_deg_hz", 1, "median")}
    cells["largest gain"] = cell_of("peak_gain", 2, "median")
    found = bandwidths(content.table("frequency"))
    texts = {True: "with the preview that the controller sees", False: "with the preview hidden"}
    return [
        spread(f"Bandwidth {text}; median of the plants", part, cells, style="dense")
        for preview, text in texts.items()
        if len(part := found[found["preview"] == preview])
    ]


# Stiffness ----------------------------------------------------------------------------------------------------------


@section("Stiffness", needs=("force_step",))
def stiffness(content: Content) -> list[Block]:
    """Deviations under a force step."""
    note = (
        "An external force pushes an axis that holds its position. Static stiffness: force ÷ remaining deviation. "
        "Dynamic stiffness: force ÷ largest deviation. The runs have no sensor noise, which would hide the recovery. "
        "With a leak the load moves until the controller responds; the same leak damps the oscillation of the oil "
        "columns."
    )
    return [Text(note), *stiffness_plots(content), stiffness_table(content)]


def stiffness_plots(content: Content) -> list[Plot]:
    """Largest and remaining deviation after a force step by leak."""
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
    return plots


def stiffness_table(content: Content) -> Table:
    """Static and dynamic stiffness by leak, medians of the plants."""
    table = content.table("force_step")
    caption = f"Stiffness against a force step of {number(table['force_n'].iloc[0], 0)} N; median of the plants"
    cells: dict[str, Callable[[pd.DataFrame], str]] = {
        "static, N/mm": lambda part: stiffness_text(part, "remaining_mm"),
        "dynamic, N/mm": lambda part: stiffness_text(part, "peak_mm"),
        "recovered after, ms": _recovery,
    }
    return spread(caption, table, cells, style="dense")


def _recovery(part: pd.DataFrame) -> str:
    """Median time of the plants that recovered, and their number if not all did."""
    times = part["recovery_s"].dropna()
    if times.empty and len(part):
        return "never"
    text = number(1e3 * times.median(), 0)
    return text if len(times) == len(part) else f"{text} ({len(times)} of {len(part)})"


def stiffness_text(part: pd.DataFrame, column: str) -> str:
    """Force over deviation, with ≥ if the deviation is too small."""
    force, deviation = float(part["force_n"].iloc[0]), float(part[column].median())
    text = number(force / max(deviation, LEAST_DEVIATION))
    return f"≥ {text}" if deviation <= LEAST_DEVIATION else text


# Standstill ---------------------------------------------------------------------------------------------------------


@section("Standstill", needs=("standstill",))
def standstill(content: Content) -> list[Block]:
    """Residual motion, offset and valve travel with noise; limit cycles without."""
    words = {
        "residual motion, µm RMS": cell_of("unrest_um", 1),
        "offset, µm": cell_of("offset_um", 1),
        "valve travel, strokes per s": cell_of("valve_travel_per_s", 2),
    }
    table = content.table("standstill").assign(all="all leaks")
    cycles = cycles_by_condition(content)
    note = (
        "Noise moves every stiff loop; a limit cycle is motion that remains without noise: after a small step, an "
        "oscillation of more than one step of the position sensor."
    )
    folded = [Fold("Limit cycles under each condition", cycles)] if cycles else []
    return [Text(note), spread("At rest under sensor noise, mean over all leaks", table, words, "all"), *folded]


def cycles_by_condition(content: Content) -> list[Table]:
    """Limit cycles at mid-stroke under every condition in which any controller has one."""
    table = content.table("limit_cycles")
    if table.empty:
        return []
    some = table[table.groupby("condition")["limit_cycle"].transform("sum") > 0]
    rows = []
    for condition, own in some.groupby("condition", sort=False):
        counts = own.groupby("controller")["limit_cycle"].agg(["sum", "count"]).astype(int)
        texts = counts["sum"].astype(str) + " of " + counts["count"].astype(str)
        rows.append((content.label(str(condition)), *texts.reindex(content.controllers, fill_value="–")))
    caption = "Limit cycles by condition; none under the others"
    return [Table(caption, ("Condition", *content.controllers), rows)] if rows else []
