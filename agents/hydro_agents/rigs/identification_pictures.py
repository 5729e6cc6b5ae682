"""Pictures of an identification: measured and simulated signals, and intervals beside the earlier ranges."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.figure import Figure

from hydro_agents.report.canvas import COLOURS, GREY, row_axis
from hydro_agents.rigs.diagnosis_picture import thinned
from hydro_agents.rigs.identification_shown import shown
from hydro_agents.rigs.parts import HeldBack
from hydro_agents.running.text import number

if TYPE_CHECKING:
    from hydro_agents.rigs.identify import Identification

PANELS = (
    ("position, mm", 1e3),
    ("pressure a, bar", 1e-5),
    ("pressure b, bar", 1e-5),
    ("spool, %", 100.0),
)
"""Label and factor from SI of each channel."""


def paint_held_back(figure: Figure, part: HeldBack) -> None:
    """Draw the held-back part: each recorded channel, measured and simulated, and the difference in position."""
    shown_rows = [row for row in range(len(PANELS)) if np.isfinite(part.measured[row]).any()]
    axes = figure.subplots(len(shown_rows) + 1, 1, sharex=True, squeeze=False)[:, 0]
    time = part.begin + part.time
    places = [0, *range(2, len(shown_rows) + 1)]
    for place, row in zip(places, shown_rows, strict=True):
        label, factor = PANELS[row]
        axis = axes[place]
        axis.plot(*thinned(time, factor * part.measured[row]), color=GREY, linewidth=2.4, label="measured", alpha=0.6)
        axis.plot(*thinned(time, factor * part.simulated[row]), color=COLOURS[0], linewidth=1.1, label="simulated")
        axis.set_ylabel(label)
    error = 1e3 * (part.simulated[0] - part.measured[0])
    axes[1].plot(*thinned(time, error), color=COLOURS[1], linewidth=0.9)
    axes[1].set_ylabel("simulated −\nmeasured, mm")
    axes[0].legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=2, frameon=False)
    axes[-1].set_xlabel("time, s")


def paint_intervals(figure: Figure, found: Identification) -> None:
    """Draw each unknown's 95 % interval, in standard deviations of its range; 0 is the middle of the range."""
    fit = found.fit
    axis = figure.subplots()
    names = [shown(name, found.config.plant).words for name in fit.names]
    low, middle, high = (_scaled(found, values) for values in (fit.low, fit.values, fit.high))
    places = np.arange(len(names))
    axis.axvspan(-1.7, 1.7, color=GREY, alpha=0.12, linewidth=0)
    for known, colour, label in ((True, COLOURS[0], "determined"), (False, COLOURS[1], "not determined")):
        rows = fit.determined == known
        if rows.any():
            reach = np.array([middle - low, high - middle])[:, rows]
            axis.errorbar(middle[rows], places[rows], xerr=np.maximum(reach, 0.0), fmt="o", color=colour, label=label)
    row_axis(axis, names)
    limit = max(2.6, float(np.nanmax(np.abs([low, high]))) * 1.05)
    end = min(limit, 6.0)
    axis.set_xlim(-end, end)
    for row in np.flatnonzero(np.abs(middle) > end):  # an arrow at the edge instead of a point beyond it
        side, colour = np.sign(middle[row]), COLOURS[0 if fit.determined[row] else 1]
        axis.plot(side * end, places[row], ">" if side > 0 else "<", color=colour, markersize=7.0, clip_on=False)
        words: dict[str, Any] = {"xytext": (-9.0 * side, 0), "textcoords": "offset points", "va": "center"}
        text = f"at {number(float(middle[row]))}"
        axis.annotate(text, (side * end, places[row]), ha="right" if side > 0 else "left", fontsize=8.0, **words)
    axis.set_xlabel("in standard deviations of the earlier range; shaded: about that range")
    axis.legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=2, frameon=False)


def _scaled(found: Identification, values: np.ndarray) -> np.ndarray:
    """Values in standard deviations of their priors."""
    scaled = []
    for name, value in zip(found.fit.names, values.tolist(), strict=True):
        prior = found.fit.priors[name]
        away = np.log(value / prior.mean) if prior.logarithmic else value - prior.mean
        scaled.append(float(away) / prior.deviation)
    return np.array(scaled)
