"""The figures of the report about leakage detection: detection rate, ROC, precision and recall, estimated size."""

from __future__ import annotations

from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes

from hydro_agents.evaluation.detection import LeakBounds
from hydro_agents.report.canvas import (
    GREY,
    INK,
    PALE,
    PAPER,
    Array,
    Plot,
    bars_by,
    description,
    one_panel,
    ticks,
)
from hydro_agents.report.content import Content
from hydro_agents.report.hover import name_categories
from hydro_agents.running.text import number, setting

FEWEST_FALSE_ALARMS = 1e-3
"""Lowest false-alarm rate in the ROC."""

POINTS = 350
"""Dots per controller."""

SIZE_TICKS = (0.003, 0.01, 0.03, 0.1, 0.3, 1.0, 3.0, 10.0, 30.0)


def detection_plots(content: Content) -> list[Plot]:
    """All figures about detection; an empty list without a leakage head."""
    if not content.has("detection"):
        return []
    return [_rates(content), _roc(content), _size(content), _precision_recall(content)]


def _rates(content: Content) -> Plot:
    rates = content.table("detection_rates")
    by_size = (rates["group"] == "range") & ~rates["value"].str.startswith("≥")
    frame = rates[(rates["value"] == "healthy") | by_size]
    frame = frame.assign(**{column: 100.0 * frame[column] for column in ("flagged_share", "low", "high")})
    looks = content.looks
    values = list(dict.fromkeys(str(value) for value in frame["value"]))
    parts = {name: frame[frame["controller"] == name] for name in looks}

    def paint(axes: Axes) -> None:
        axes.axvline(0.5, color=GREY, linewidth=0.8, linestyle=":")
        bars_by(axes, parts, "value", values, "flagged_share", looks, "points")
        name_categories(axes.xaxis, range(len(values)), values)
        axes.grid(visible=False, axis="x")
        axes.set_ylim(-2.0, 102.0)
        axes.set_ylabel("flagged, % of episodes")
        axes.set_xlabel("leak, l/min at 100 bar")

    title = "Flagged episodes by leak size"
    rows = {name: list(zip(part["value"], part["flagged_share"], strict=True)) for name, part in parts.items()}
    note = "Bars: 95 % interval. Flags on healthy seals (left) are false alarms."
    return one_panel("rates", title, note, description(title, rows, " %"), paint)


def _curve(content: Content, controller: str, name: str) -> tuple[Array, Array]:
    curves = content.table("curves")
    part = curves[(curves["controller"] == controller) & (curves["curve"] == name)]
    return part["x"].to_numpy(dtype=np.float64), part["y"].to_numpy(dtype=np.float64)


def _corners(x: Array, y: Array) -> tuple[Array, Array]:
    """A staircase from its left end, without the points on its straight stretches."""
    start = int(np.flatnonzero(x == x[0])[-1])
    x, y = x[start:], y[start:]
    kept = np.ones(len(x), dtype=np.bool_)
    kept[1:-1] = ~(((x[1:-1] == x[:-2]) & (x[1:-1] == x[2:])) | ((y[1:-1] == y[:-2]) & (y[1:-1] == y[2:])))
    return x[kept], y[kept]


def _operating_point(detection: pd.DataFrame, controller: str, bounds: LeakBounds) -> tuple[float, float]:
    """False-alarm rate and detection rate of all leaks at the head's threshold."""
    part = detection[detection["controller"] == controller]
    flow, flagged = part["leakage_flow_lpm"].to_numpy(), part["flagged"].to_numpy(dtype=np.float64)
    return float(flagged[flow <= bounds.healthy_up_to].mean()), float(flagged[flow > bounds.leaking_above].mean())


def _roc(content: Content) -> Plot:
    looks = content.looks

    def paint(axes: Axes) -> None:
        axes.axvline(1e-2, color=GREY, linewidth=0.9, linestyle="--")
        axes.text(1.08e-2, 5.0, "1 %", color=GREY, fontsize=8.5)
        chance = np.geomspace(FEWEST_FALSE_ALARMS, 1.0, 60)
        axes.plot(chance, 100.0 * chance, color=GREY, linewidth=0.8, linestyle=":", label="chance")
        for name, look in looks.items():
            x, y = _corners(*_curve(content, name, "roc"))
            line: dict[str, Any] = {"color": look.colour, "linestyle": look.line, "label": name}
            axes.step(np.maximum(x, FEWEST_FALSE_ALARMS), 100.0 * y, where="post", **line)
            alarms, detected = _operating_point(content.table("detection"), name, content.bounds)
            point: dict[str, Any] = {"color": look.colour, "markeredgecolor": PAPER, "markersize": 7.5}
            axes.plot(max(alarms, FEWEST_FALSE_ALARMS), 100.0 * detected, look.marker, **point, clip_on=False)
        axes.set_xscale("log")
        axes.set_xlim(FEWEST_FALSE_ALARMS, 1.0)
        axes.set_xticks([1e-3, 1e-2, 1e-1, 1.0], ["0.1", "1", "10", "100"])
        axes.set_ylim(0.0, 102.0)
        axes.set_xlabel("false alarms, % of healthy episodes")
        axes.set_ylabel("leaks flagged, %")

    title = "Leaks flagged against false alarms"
    areas = _from_summary(content, "auroc", 3)
    note = (
        f"All leaks above {setting(content.bounds.leaking_above)} l/min, every threshold (receiver operating "
        f"characteristic, ROC). Marked: the threshold in use. Area under the curve on linear axes: {areas}."
    )
    return one_panel("roc", title, note, f"{title}. Area under the curve: {areas}.", paint)


def _from_summary(content: Content, column: str, decimals: int) -> str:
    """One number of every controller, as text."""
    rows = content.table("detection_summary")
    return ", ".join(
        f"{name} {number(value, decimals)}" for name, value in zip(rows["controller"], rows[column], strict=True)
    )


def _precision_recall(content: Content) -> Plot:
    looks = content.looks
    row = content.table("detection_summary").iloc[0]
    share = float(row["leaking_episodes"] / (row["leaking_episodes"] + row["healthy_episodes"]))

    def paint(axes: Axes) -> None:
        axes.axhline(100.0 * share, color=GREY, linewidth=0.8, linestyle=":", label="chance")
        for name, look in looks.items():
            x, y = _curve(content, name, "precision_recall")
            kept = np.unique(np.linspace(0, len(x) - 1, 400).astype(np.int64))
            axes.plot(100.0 * x[kept], 100.0 * y[kept], color=look.colour, linestyle=look.line, label=name)
        axes.set_xlim(0.0, 101.0)
        axes.set_ylim(0.0, 102.0)
        axes.set_xlabel("recall: leaks flagged, %")
        axes.set_ylabel("precision: correct flags, %")

    title = "How many flags are correct"
    areas = _from_summary(content, "average_precision", 3)
    note = (
        f"Precision against recall. Here {100.0 * share:.0f} % of the episodes leak; with rarer leaks fewer "
        f"flags are correct. Average precision: {areas}."
    )
    alt = f"{title}: precision against recall. Average precision: {areas}."
    return one_panel("precision", title, note, alt, paint)


def _size(content: Content) -> Plot:
    looks = content.looks
    leaking = content.table("detection")[content.table("detection")["leakage_flow_lpm"] > content.bounds.leaking_above]
    low, high = float(leaking["leakage_flow_lpm"].min()), float(leaking["leakage_flow_lpm"].max())
    bottom = min(max(float(leaking["estimated_flow_lpm"].min()), SIZE_TICKS[0]), 0.5 * low)
    top = min(max(float(leaking["estimated_flow_lpm"].max()), 2.0 * high), 50.0)

    def paint(axes: Axes) -> None:
        true = np.array([low, high])
        axes.fill_between(true, 0.5 * true, 2.0 * true, color=PALE, linewidth=0.0, label="factor of 2")
        axes.plot(true, true, color=INK, linewidth=0.9)
        for name, look in looks.items():
            part = leaking[leaking["controller"] == name]
            part = part.iloc[np.unique(np.linspace(0, len(part) - 1, POINTS).astype(np.int64))]
            dots: dict[str, Any] = {"color": look.colour, "markersize": 2.8, "markeredgewidth": 0.0, "alpha": 0.6}
            estimated = part["estimated_flow_lpm"].clip(bottom, top)
            axes.plot(part["leakage_flow_lpm"], estimated, look.marker, label=name, **dots)
        axes.set(xscale="log", yscale="log", xlim=(low / 1.05, 1.05 * high), ylim=(bottom / 1.1, 1.1 * top))
        for axis, name in ((axes.xaxis, "true"), (axes.yaxis, "estimated")):
            ticks(axis, SIZE_TICKS)
            axis.set_label_text(f"{name} leak, l/min")

    title = "Estimated against true leak size"
    factors = _from_summary(content, "median_size_error_factor", 2)
    note = f"One dot per leaking episode (thinned). Median factor between the two: {factors}."
    return one_panel("size", title, note, f"{title}, both logarithmic. {note}", paint)
