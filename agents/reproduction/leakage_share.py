"""Section 4 of the paper: is leakage negligible while the pressure difference is low? Its share of dF/dt, sorted."""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from agents.reproduction.drawing import LEAK_COLOURS, ReproducedFigure, panel_title, plain
from agents.reproduction.force_rate import DRIVE, LEAKS, TERMS, WATCH, force_rate_table
from agents.reproduction.rig import LAWS, Rig

BINS = 8
SHORT = {"laminar": "Laminar leak", "throttle": "Throttle in parallel"}
FEWEST = 10
"""Samples that a bin needs, so that its share means something."""


def share_table(rig: Rig) -> pd.DataFrame:
    """Leakage's share of the sizes of all four terms by law, leak and size of the pressure difference, bar.

    Over the move and the stop of :func:`~agents.reproduction.force_rate.force_rate_table`; bins with too few samples
    are left out.
    """
    tables = {law: force_rate_table(rig, law) for law in LAWS}
    moving = {law: table[table["time_s"] >= 0.0] for law, table in tables.items()}
    largest = max(float(table["pressure_difference_bar"].abs().quantile(0.99)) for table in moving.values())
    edges = np.linspace(0.0, max(largest, 1e-3), BINS + 1)
    rows = []
    for law, table in moving.items():
        for leak in LEAKS:
            part = table[table["leak_lpm"] == leak]
            size = part["pressure_difference_bar"].abs()
            for low, high in pairwise(edges):
                seen = part[(size >= low) & (size < high)]
                if len(seen) < FEWEST:
                    continue
                terms = seen[list(TERMS)].abs().sum()
                rows.append(
                    {
                        "law": law,
                        "leak_lpm": leak,
                        "difference_low_bar": low,
                        "difference_high_bar": high,
                        "samples": len(seen),
                        "leakage_share": float(terms["internal_leakage_n_s"] / terms.sum()),
                    }
                )
    return pd.DataFrame(rows)


def paint_share(figure: Figure, table: pd.DataFrame) -> None:
    """Share over pressure difference, one panel per law."""
    panels = figure.subplots(1, len(LAWS), sharey=True)
    for axes, law in zip(panels, LAWS, strict=True):
        for colour, leak in zip((LEAK_COLOURS[0], *LEAK_COLOURS[2:]), LEAKS, strict=True):
            part = table[(table["law"] == law) & (table["leak_lpm"] == leak)]
            middle = 0.5 * (part["difference_low_bar"] + part["difference_high_bar"])
            share = 100 * part["leakage_share"]
            axes.plot(middle, share, color=colour, marker="o", markersize=3.5, label=f"{leak:g} l/min")
        axes.set(yscale="log", xlabel="size of the pressure difference, bar")
        axes.yaxis.set_major_formatter(lambda value, _: f"{value:g}")
        panel_title(axes, SHORT[law])
    panels[0].set_ylabel("leakage's share of the terms of dF/dt, %")
    handles, labels = panels[0].get_legend_handles_labels()
    figure.legend(handles, labels, title="leak at 100 bar", loc="outside lower center", ncols=len(LEAKS), fontsize=8.0)


def leakage_share_figure(rig: Rig) -> ReproducedFigure:
    """The share with its words."""
    table = share_table(rig)
    found, differs = [], []
    for law in LAWS:
        part = table[(table["law"] == law) & (table["leak_lpm"] == LEAKS[-1])]
        low, high = part.iloc[0], part.iloc[-1]
        found.append(
            f"{SHORT[law]}, {LEAKS[-1]:g} l/min: {_percent(low)} of all terms while the difference "
            f"is {_span(low)}, {_percent(high)} at {_span(high)}."
        )
        if low["difference_low_bar"] == 0.0 and low["leakage_share"] > 0.25 * high["leakage_share"]:
            slow = (
                ": a throttle leaks most steeply where the difference is small"
                if law == "throttle" and low["leakage_share"] > 0.0
                else ""
            )
            differs.append(
                f"{SHORT[law]}: the share at {_span(low)} is still "
                f"{low['leakage_share'] / high['leakage_share']:.2g} times that at {_span(high)}, so that leakage is "
                f"not negligible at low differences only because they are low{slow}."
            )
    lowest = float(table["difference_low_bar"].min())
    if lowest > 0.0:
        differs.append(
            f"On this rig the difference never comes near zero: fewer than {FEWEST} samples lie below {lowest:.1f} bar "
            f"at any leak, since areas and load ask for unequal pressures all the time. When the leak would be "
            f"negligible cannot be told from the difference here."
        )
    ends = table.groupby(["law", "leak_lpm"])["leakage_share"].agg(["first", "last"])
    ratio = ends["last"] / ends["first"]
    found.append(
        f"From the lowest difference to the highest the share changes by factors of {plain(ratio.min(), 2)} to "
        f"{plain(ratio.max(), 2)} over all laws and leaks; "
        + (
            "it grows in every case, as the paper's remark asks."
            if ratio.min() > 1.0
            else f"it grows in {int((ratio > 1.0).sum())} of {len(ratio)} cases."
        )
    )
    return ReproducedFigure(
        table=table,
        paint=paint_share,
        height=3.6,
        equations="(10), (24)",
        paper="While the difference P_a − P_b is low, leakage is negligible; when it grows, so does leakage, and the "
        "force builds up more slowly.",
        how=f"The move and the stop of the two figures above ({(DRIVE + WATCH) * rig.stretch:.2f} s). Samples are "
        f"sorted by |P_a − P_b|; share = sum of |internal leakage term| over the sum of all four sizes.",
        found=found,
        differs=differs,
    )


def _percent(row: pd.Series) -> str:
    share = 100 * float(row["leakage_share"])
    digits = max(0, 1 - math.floor(math.log10(share))) if share > 0.0 else 1
    return f"{share:.{digits}f} %"


def _span(row: pd.Series) -> str:
    return f"{row['difference_low_bar']:.1f} to {row['difference_high_bar']:.1f} bar"
