"""Fig. 13 as a picture and in words."""

from __future__ import annotations

import math

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import FixedLocator, FuncFormatter, NullLocator

from agents.reproduction.drawing import COLOURS, ReproducedFigure, legend, panel_title
from agents.reproduction.oscillation import SETTLED
from agents.reproduction.rig import (
    ACCELEROMETER_BANDWIDTH,
    ACCELEROMETER_NOISE,
    GRAVITY,
    LAWS,
    accelerometer_noise,
)
from agents.reproduction.settling import LEAKS, settling_table
from hydro_env import PlantParameters, resistance_from_flow

SHORT_LAWS = {"laminar": "laminar leak", "throttle": "throttle in parallel"}
SMALL = 0.3
"""l/min at 100 bar; a leak that is not severe yet."""

TIME_TICKS = (0.02, 0.05, 0.1, 0.2, 0.5, 1.0, 2.0)


def paint_settling(figure: Figure, table: pd.DataFrame) -> None:
    """Two laws by friction; zero-lapped valve and null leakage in colours; signal as points, theory dashed."""
    grid = figure.subplots(2, 2, sharex=True, sharey=True)
    for row, law in enumerate(LAWS):
        for column, friction in enumerate((False, True)):
            axes: Axes = grid[row, column]
            for colour, underlap in zip(COLOURS, (False, True), strict=False):
                part = table[
                    (table["law"] == law) & (table["friction"] == friction) & (table["valve_null_leakage"] == underlap)
                ]
                ohm = part["resistance_pa_s_m3"]
                axes.plot(ohm, part["clean_s"], color=colour)
                spread = np.array([part["signal_s"] - part["signal_low_s"], part["signal_high_s"] - part["signal_s"]])
                axes.errorbar(ohm, part["signal_s"], yerr=spread, fmt="o", mfc="white", color=colour, markersize=4.0)
                if not friction:
                    axes.plot(ohm, part["theory_s"], color=colour, linestyle=(0, (4, 2)), linewidth=1.0)
            axes.set(xscale="log", yscale="log")
            axes.yaxis.set_major_locator(FixedLocator(TIME_TICKS))
            axes.yaxis.set_minor_locator(NullLocator())
            axes.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
            panel_title(axes, f"{SHORT_LAWS[law].capitalize()}, {'with' if friction else 'no'} friction")
            axes.set_xlabel("leakage resistance at 100 bar, Pa s/m³" if row else "")
            axes.set_ylabel("settling time, s" if column == 0 else "")
            _flow_labels(axes)
    handles = [
        Line2D([], [], color=COLOURS[0], label="zero-lapped valve"),
        Line2D([], [], color=COLOURS[1], label="valve with null leakage"),
        Line2D([], [], color="#222222", label="noise-free"),
        Line2D([], [], color="#222222", marker="o", mfc="white", linestyle="none", label="from the accelerometer"),
        Line2D([], [], color="#222222", linestyle=(0, (4, 2)), linewidth=1.0, label="linear theory"),
    ]
    legend(grid[0, 1], handles=handles, loc="upper left", bbox_to_anchor=(0.0, 0.98))


def _flow_labels(axes: Axes) -> None:
    """The same leaks in l/min, inside the panel along its lower edge."""
    for leak in (0.01, 0.1, 1.0, 4.0):
        place = resistance_from_flow(leak)
        axes.axvline(place, color="#dddddd", linewidth=0.6, zorder=0)
        side = "right" if leak == 0.01 else "left"
        axes.annotate(
            f"{leak:g} l/min", (place, 0.02), xycoords=("data", "axes fraction"), fontsize=7.0, color="#6b6b6b", ha=side
        )


def settling_figure(base: PlantParameters) -> ReproducedFigure:
    """Fig. 13 with its words."""
    table = settling_table(base)
    found = [_trend(table, law) for law in LAWS]
    plain = table[(~table["friction"]) & (~table["valve_null_leakage"])]
    for law, words in LAWS.items():
        part = plain[(plain["law"] == law) & plain["theory_s"].notna()]
        error = (part["theory_s"] / part["clean_s"] - 1.0).abs()
        found.append(
            f"Linear theory, T = t₁ + ln(a₁/0.1)/(ζω), differs from the noise-free result by "
            f"{100 * error.median():.1f} % (median) and at most {100 * error.max():.1f} % for the {words}, zero-lapped "
            f"valve, no friction."
        )
    found[-1] += (
        " The flow of a throttle is no straight line: its slope changes with the pressure difference, so that one ζ "
        "cannot fit the whole decay."
    )
    found.append(_signal_sentence(table))
    return ReproducedFigure(
        key="fig13_settling_time",
        title="Fig. 13: settling time against leakage resistance",
        table=table,
        paint=paint_settling,
        height=6.4,
        equations="(10), (12)–(14), (17)",
        paper="After a quick stop the time until the acceleration stays within 0.1 m/s² was read from the "
        "accelerometer at several throttle settings: it falls as the leak grows, which the paper takes as higher "
        "damping.",
        how=f"Extend at 4 V from +5 mm, close the valve after 0.15 s. The drift (mean over one period of oscillation) "
        f"is taken off before the last crossing of 0.1 m/s² is sought. The accelerometer's own noise is "
        f"{1e6 * ACCELEROMETER_NOISE / GRAVITY:.0f} µg/√Hz over {ACCELEROMETER_BANDWIDTH:.0f} Hz, so "
        f"{accelerometer_noise():.3f} m/s²: it reaches the threshold by itself. Its record is therefore filtered to a "
        f"band of ±30 % about the oscillation and judged by the size of what is left; points are the median of five "
        f"noise records, bars the range. Linear theory starts from the first swing a₁ at t₁ and takes ζ and ω from the "
        f"plant linearised at the state after the stop.",
        found=found,
        differs=_differences(table),
        summary=settling_summary(table),
    )


def settling_summary(table: pd.DataFrame) -> pd.DataFrame:
    """Noise-free settling times in s, one row per leak, one column per law and plant."""
    columns = {"leak, l/min at 100 bar": [f"{leak:g}" for leak in LEAKS]}
    for law, words in SHORT_LAWS.items():
        for friction, underlap, plant in (
            (False, False, "no friction, zero-lapped"),
            (False, True, "no friction, null leakage"),
            (True, True, "friction, null leakage"),
        ):
            times = [_cell(table, law, leak, friction, underlap) for leak in LEAKS]
            columns[f"{words}, {plant}, s"] = [f"{time:.3f}" for time in times]
        theory = [_cell(table, law, leak, False, False, "theory_s") for leak in LEAKS]
        columns[f"{words}, linear theory (no friction, zero-lapped), s"] = [f"{time:.3f}" for time in theory]
    return pd.DataFrame(columns)


def _cell(table: pd.DataFrame, law: str, leak: float, friction: bool, underlap: bool, column: str = "clean_s") -> float:
    part = table[
        (table["law"] == law)
        & (table["leak_lpm"] == leak)
        & (table["friction"] == friction)
        & (table["valve_null_leakage"] == underlap)
    ]
    return float(part[column].iloc[0])


def _trend(table: pd.DataFrame, law: str) -> str:
    times = [_cell(table, law, leak, False, False) for leak in LEAKS]
    falls = bool(np.all(np.diff(times) < 0))
    words = "falls at every step" if falls else "does not fall at every step, it goes"
    return (
        f"{SHORT_LAWS[law].capitalize()}, no friction: settling time {words} from {times[0]:.2f} s at {LEAKS[0]:g} "
        f"l/min to {times[-1]:.3f} s at {LEAKS[-1]:g} l/min{', as the paper says' if falls else ''}."
    )


def _signal_sentence(table: pd.DataFrame) -> str:
    part = table[~table["friction"]]
    error = (part["signal_s"] / part["clean_s"] - 1.0).abs()
    return (
        f"Without friction the accelerometer's record gives the noise-free settling time within "
        f"{100 * error.median():.0f} % (median). What settles faster than about {table['signal_s'].min():.2f} s it "
        f"cannot tell: so long the filter itself rings."
    )


def _differences(table: pd.DataFrame) -> list[str]:
    sentences = []
    low, high = LEAKS[0], 1.0
    rubbing = [_cell(table, "throttle", leak, True, True) for leak in (low, high)]
    if rubbing[0] < 2.0 * rubbing[1]:
        sentences.append(
            f"With the friction assumed for the rig the axis settles in {rubbing[0]:.3f} s with the tight seal and in "
            f"{rubbing[1]:.3f} s at {high:g} l/min: friction ends the oscillation within a few periods, and the "
            f"paper's trend all but vanishes. That the paper saw a clear trend suggests that its rig rubbed less than "
            f"assumed here (it gives no friction)."
        )
        omega = _cell(table, "laminar", low, False, True, "natural_frequency_rad_s")
        sentences.append(
            f"That result hangs on how friction is modelled: a swing of {SETTLED:g} m/s² is only "
            f"{1e6 * SETTLED / omega**2:.1f} µm and {1e3 * SETTLED / omega:.2f} mm/s, where real seals give like a "
            f"spring rather than rub, while the model used here brakes fully above about "
            f"{1e3 * PlantParameters().friction.transition_velocity:g} mm/s and like a strong damper below."
        )
    lapped, null = (
        [_cell(table, "laminar", leak, False, underlap) for leak in (low, SMALL)] for underlap in (False, True)
    )
    sentences.append(
        f"The valve's own null leakage damps as well: without friction it shortens settling with the tight seal from "
        f"{lapped[0]:.2f} s to {null[0]:.2f} s, so that a leak of {SMALL:g} l/min divides the settling time by "
        f"{null[0] / null[1]:.1f} instead of {lapped[0] / lapped[1]:.1f}."
    )
    last, before = (_cell(table, "throttle", leak, True, True) for leak in (LEAKS[-1], LEAKS[-3]))
    if last > before and not math.isnan(last):
        sentences.append(
            f"With friction and a throttle of {LEAKS[-1]:g} l/min it takes longer again ({last:.3f} s against "
            f"{before:.3f} s at {LEAKS[-3]:g} l/min): the axis hardly swings any more, and what is timed is the stop."
        )
    return sentences
