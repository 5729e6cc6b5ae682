"""Fig. 13 as a picture and in words."""

from __future__ import annotations

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import FixedLocator, FuncFormatter, NullLocator

from agents.reproduction.drawing import COLOURS, ReproducedFigure, panel_title, plain
from agents.reproduction.oscillation import SETTLED
from agents.reproduction.rig import LAWS, Rig
from agents.reproduction.settling import LEAKS, friction_words, settling_table
from agents.reproduction.signals import (
    ACCELEROMETER_BANDWIDTH,
    ACCELEROMETER_NOISE,
    GRAVITY,
    accelerometer_noise,
)
from hydro_env import resistance_from_flow

SHORT_LAWS = {"laminar": "laminar leak", "throttle": "throttle in parallel"}
METHODS = {"clean_s": "noise-free", "signal_s": "accelerometer", "theory_s": "linear theory"}
MODERATE = 1.0
"""l/min at 100 bar; where a moderate leak becomes a severe one."""

TIME_TICKS = (0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0, 20.0)
FEW = 4.0
"""Periods of oscillation within which settling has ended at once."""

NOTICEABLE = 0.9
"""Settling with null leakage over settling without, below which the valve's own damping is worth a word."""

CLEAR = 1.5
"""Settling with a tight seal over settling with the leak, from which on a trend can be called clear."""


def paint_settling(figure: Figure, table: pd.DataFrame) -> None:
    """Two laws by friction models; zero-lapped valve and null leakage in colours; signal as points, theory dashed."""
    models = list(table["friction"].unique())
    grid = figure.subplots(len(LAWS), len(models), sharex=True, sharey=True, squeeze=False)
    for row, law in enumerate(LAWS):
        for column, model in enumerate(models):
            axes: Axes = grid[row, column]
            for colour, underlap in zip(COLOURS, (False, True), strict=False):
                part = _part(table, law, model, underlap)
                ohm = part["resistance_pa_s_m3"]
                axes.plot(ohm, part["clean_s"], color=colour)
                spread = np.array([part["signal_s"] - part["signal_low_s"], part["signal_high_s"] - part["signal_s"]])
                axes.errorbar(ohm, part["signal_s"], yerr=spread, fmt="o", mfc="white", color=colour, markersize=4.0)
                if model == "none":
                    axes.plot(ohm, part["theory_s"], color=colour, linestyle=(0, (4, 2)), linewidth=1.0)
            axes.set(xscale="log", yscale="log")
            axes.yaxis.set_major_locator(FixedLocator(TIME_TICKS))
            axes.yaxis.set_minor_locator(NullLocator())
            axes.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
            panel_title(axes, f"{SHORT_LAWS[law].capitalize()},\n{friction_words(model)}")
            axes.set_xlabel("leakage resistance at 100 bar, Pa s/m³" if row else "")
            axes.set_ylabel("settling time, s" if column == 0 else "")
            _flow_labels(axes)
    # Room for the labels of the leaks below the lowest line.
    bottom, top = grid[0, 0].get_ylim()
    grid[0, 0].set_ylim(bottom * (bottom / top) ** 0.06, top)
    handles = [
        Line2D([], [], color="#222222", label="noise-free"),
        Line2D([], [], color="#222222", marker="o", mfc="white", linestyle="none", label="from the accelerometer"),
        Line2D([], [], color="#222222", linestyle=(0, (4, 2)), linewidth=1.0, label="linear theory (no friction)"),
    ]
    lapped = [Line2D([], [], color=COLOURS[0], label="zero-lapped valve")]
    if table["valve_null_leakage"].any():
        lapped.append(Line2D([], [], color=COLOURS[1], label="valve with null leakage"))
    figure.legend(handles=[*lapped, *handles], loc="outside lower center", ncols=5, fontsize=8.0, columnspacing=1.2)


def _flow_labels(axes: Axes) -> None:
    """The same leaks in l/min, inside the panel along its lower edge."""
    for leak in (0.01, 0.1, 1.0, 4.0):
        place = resistance_from_flow(leak)
        axes.axvline(place, color="#dddddd", linewidth=0.6, zorder=0)
        side = "right" if leak == 0.01 else "left"
        axes.annotate(
            f"{leak:g} l/min" if leak == 0.01 else f"{leak:g}",
            (place, 0.02),
            xycoords=("data", "axes fraction"),
            fontsize=7.0,
            color="#6b6b6b",
            ha=side,
        )


def _part(table: pd.DataFrame, law: str, model: str, underlap: bool) -> pd.DataFrame:
    return table[(table["law"] == law) & (table["friction"] == model) & (table["valve_null_leakage"] == underlap)]


def _times(table: pd.DataFrame, law: str, model: str, underlap: bool, column: str = "clean_s") -> pd.Series:
    return _part(table, law, model, underlap).set_index("leak_lpm")[column]


def trends(table: pd.DataFrame) -> pd.DataFrame:
    """One row per friction model, valve, law and method: does settling fall at every step from leak to leak?

    ``ratio``: settling with the tight seal over settling at the largest leak; ``falls``: at every step.
    """
    rows = []
    for (model, underlap, law), part in table.groupby(["friction", "valve_null_leakage", "law"], sort=False):
        for column in METHODS:
            times = part.set_index("leak_lpm")[column]
            if times.isna().all():
                continue
            rows.append(
                {
                    "friction": model,
                    "valve_null_leakage": underlap,
                    "law": law,
                    "method": column,
                    "first_s": times.iloc[0],
                    "moderate_s": times[MODERATE],
                    "last_s": times.iloc[-1],
                    "ratio": times.iloc[0] / times.iloc[-1] if times.iloc[-1] > 0.0 else float("inf"),
                    "falls": bool(times.diff().iloc[1:].lt(0.0).all()),
                }
            )
    return pd.DataFrame(rows)


def settling_summary(table: pd.DataFrame) -> pd.DataFrame:
    """Every combination: settling times in s over the leaks, and whether they fall as the paper says."""
    told, rows = trends(table), []
    for _, row in told.iterrows():
        times = _times(table, row["law"], row["friction"], row["valve_null_leakage"], row["method"])
        rows.append(
            {
                "friction": friction_words(row["friction"]),
                "valve": "null leakage" if row["valve_null_leakage"] else "zero-lapped",
                "leak": "laminar" if row["law"] == "laminar" else "throttle",
                "settling time, s, by": METHODS[row["method"]],
                **{f"{leak:g} l/min": f"{time:.3f}" for leak, time in times.items() if leak in SUMMARY_LEAKS},
                "falls at every step": "yes" if row["falls"] else "no",
                "first / last": f"{row['ratio']:.1f}",
            }
        )
    return pd.DataFrame(rows)


POOR = 0.1
"""Relative error from which on linear theory does not fit."""

SUMMARY_LEAKS = (0.01, 0.1, 0.3, 1.0, 2.0, 4.0)


def settling_figure(rig: Rig) -> ReproducedFigure:
    """Fig. 13 with its words."""
    table = settling_table(rig)
    found = [_trend(table, law) for law in LAWS]
    for law, words in LAWS.items():
        part = _part(table, law, "none", False)
        part = part[part["theory_s"].notna() & (part["clean_s"] > 0.0)]
        error = (part["theory_s"] / part["clean_s"] - 1.0).abs()
        found.append(
            f"Linear theory, T = t₁ + ln(a₁/{SETTLED:g})/(ζω), differs from the noise-free result by "
            f"{100 * error.median():.1f} % (median) and at most {100 * error.max():.1f} % for the {words}, zero-lapped "
            f"valve, no friction."
        )
    if error.max() > POOR:
        found[-1] += (
            " The flow of a throttle is no straight line: its slope changes with the pressure difference, so that one "
            "ζ cannot fit the whole decay."
        )
    found.append(_signal_sentence(table))
    told = trends(table)
    rubbing = told[(told["method"] == "clean_s") & (told["friction"] != "none") & (told["law"] == "throttle")]
    for _, row in rubbing.drop_duplicates("friction", keep="last").iterrows():
        if row["first_s"] > CLEAR * row["moderate_s"]:
            found.append(
                f"With {friction_words(row['friction'])} {_forces(rig)} the paper's trend comes out as well: "
                f"{row['first_s']:.3f} s with the tight seal, {row['moderate_s']:.3f} s at {MODERATE:g} l/min "
                f"(throttle)."
            )
    clean = told[told["method"] == "clean_s"]
    found.append(
        f"Noise-free, settling falls at every step of the leak in {int(clean['falls'].sum())} of {len(clean)} "
        f"combinations of friction, valve and law; the table shows all of them."
    )
    return ReproducedFigure(
        table=table,
        paint=paint_settling,
        height=6.6,
        equations="(10), (12)–(14), (17)",
        paper="After a quick stop the time until the acceleration stays within 0.1 m/s² was read from the "
        "accelerometer at several throttle settings: it falls as the leak grows, which the paper takes as higher "
        "damping.",
        how=f"Extend at {rig.voltage:g} V from {1e3 * rig.start:+.0f} mm, close the valve after "
        f"{0.15 * rig.stretch:.2f} s. The drift (mean over one period of oscillation) is taken off before the last "
        f"crossing of {SETTLED:g} m/s² is sought. The accelerometer's own noise is "
        f"{1e6 * ACCELEROMETER_NOISE / GRAVITY:.0f} µg/√Hz over {ACCELEROMETER_BANDWIDTH:.0f} Hz, so "
        f"{accelerometer_noise():.3f} m/s²: it reaches the threshold by itself. Its record is therefore filtered to a "
        f"band of ±30 % about the oscillation and judged by the size of what is left; points are the median of five "
        f"noise records, bars the range. Linear theory starts from the first swing a₁ at t₁ and takes ζ and ω from the "
        f"plant linearised at the state after the stop."
        f"{'' if rig.has_friction else ' This rig has no dry friction: there is nothing to show with it.'}",
        found=found,
        differs=_differences(rig, table, told),
        summary=settling_summary(table),
    )


def _trend(table: pd.DataFrame, law: str) -> str:
    times = _times(table, law, "none", False)
    falls = bool(times.diff().iloc[1:].lt(0.0).all())
    words = "falls at every step" if falls else "does not fall at every step, it goes"
    return (
        f"{SHORT_LAWS[law].capitalize()}, no friction, zero-lapped valve: settling time {words} from "
        f"{times.iloc[0]:.2f} s at {LEAKS[0]:g} l/min to {times.iloc[-1]:.3f} s at {LEAKS[-1]:g} l/min"
        f"{', as the paper says' if falls else ''}."
    )


def _signal_sentence(table: pd.DataFrame) -> str:
    part = table[(table["friction"] == "none") & (table["clean_s"] > 0.0)]
    error = (part["signal_s"] / part["clean_s"] - 1.0).abs()
    return (
        f"Without friction the accelerometer's record gives the noise-free settling time within "
        f"{100 * error.median():.0f} % (median). What settles faster than about {table['signal_s'].min():.2f} s it "
        f"cannot tell: so long the filter itself rings."
    )


def _differences(rig: Rig, table: pd.DataFrame, told: pd.DataFrame) -> list[str]:
    sentences = []
    low = LEAKS[0]
    for model in table["friction"].unique():
        part = told[(told["friction"] == model) & (told["method"] == "clean_s")]
        rubbing = part[part["law"] == "throttle"].iloc[-1]
        if model == "none" or rubbing["first_s"] > CLEAR * rubbing["moderate_s"]:
            continue
        sentences.append(
            f"With {friction_words(model)} {_forces(rig)} the axis settles in {rubbing['first_s']:.3f} s with the "
            f"tight seal and in {rubbing['moderate_s']:.3f} s at {MODERATE:g} l/min (throttle): {_fate(table, rubbing)}"
            f"{_suggestion(told) if rig.is_paper else ''}"
        )
        omega = _times(table, "laminar", "none", False, "natural_frequency_rad_s").loc[low]
        if model in ("coulomb", "stribeck"):
            sentences.append(
                f"That result hangs on how friction is modelled: a swing of {SETTLED:g} m/s² is only "
                f"{1e6 * SETTLED / omega**2:.1f} µm and {1e3 * SETTLED / omega:.2f} mm/s, where real seals give like a "
                f"spring rather than rub, while the {model.capitalize()} model brakes fully above about "
                f"{plain(1e3 * rig.parameters.friction.transition_velocity, 2)} mm/s and like a strong damper below."
            )
    if table["valve_null_leakage"].any():
        lapped, null = (_times(table, "laminar", "none", underlap) for underlap in (False, True))
        if null.loc[low] < NOTICEABLE * lapped.loc[low]:
            sentences.append(
                f"The valve's own null leakage damps as well: without friction it shortens settling with the tight "
                f"seal from {lapped.loc[low]:.2f} s to {null.loc[low]:.2f} s, so that a leak of {MODERATE:g} l/min "
                f"shortens it to {null.loc[MODERATE]:.2f} s from there, instead of from {lapped.loc[low]:.2f} s to "
                f"{lapped.loc[MODERATE]:.2f} s."
            )
    rising = [
        _rise(row, _times(table, row["law"], row["friction"], row["valve_null_leakage"]))
        for _, row in told[(told["method"] == "clean_s") & ~told["falls"]].iterrows()
    ]
    if rising:
        sentences.append(f"Noise-free settling does not fall at every step with: {'; '.join(rising)}.")
    return sentences


def _forces(rig: Rig) -> str:
    return "as assumed" if rig.is_paper else "and the forces of this rig"


def _fate(table: pd.DataFrame, rubbing: pd.Series) -> str:
    """What friction does to the trend of one model, from its settling times and those without friction."""
    part = _part(table, "throttle", "none", bool(rubbing["valve_null_leakage"])).set_index("leak_lpm")
    free = part["clean_s"]
    periods = rubbing["first_s"] * part["natural_frequency_rad_s"].loc[LEAKS[0]] / (2.0 * np.pi)
    if rubbing["moderate_s"] > CLEAR * rubbing["first_s"]:
        return "it takes longer with the leak, which keeps the axis creeping: the paper's trend is reversed."
    weak = free.loc[LEAKS[0]] < CLEAR * free.loc[MODERATE]
    without = f"without friction too they are {free.loc[LEAKS[0]]:.3f} and {free.loc[MODERATE]:.3f} s"
    if periods < FEW:
        ends = f"friction ends the oscillation within {periods:.1f} periods"
        return f"{ends}; {without}." if weak else f"{ends}, and the paper's trend all but vanishes."
    ratio = f"the leak divides the time by {rubbing['first_s'] / rubbing['moderate_s']:.2f}"
    return f"{ratio}; {without}." if weak else f"{ratio}, so that the paper's trend is weak."


def _suggestion(told: pd.DataFrame) -> str:
    """What the paper's clear trend says of the friction on its rig."""
    clean = told[(told["method"] == "clean_s") & (told["law"] == "throttle") & (told["friction"] != "none")]
    shows = clean[clean["first_s"] > CLEAR * clean["moderate_s"]].drop_duplicates("friction")
    other = "".join(f", or rubbed as the {friction_words(model)} here" for model in shows["friction"])
    return (
        f" That the paper saw a clear trend suggests that its rig rubbed less than assumed here{other} (it gives no "
        f"friction)."
    )


def _rise(row: pd.Series, times: pd.Series) -> str:
    steps = times.diff()
    leak = steps.idxmax()
    valve = "valve with null leakage" if row["valve_null_leakage"] else "zero-lapped valve"
    before = _before(times, leak)
    change = (
        f"from {1e3 * times.loc[before]:.1f} to {1e3 * times.loc[leak]:.1f} ms between {before:g} and {leak:g} l/min"
        if steps[leak] > 0.0
        else f"the same {1e3 * times.loc[leak]:.1f} ms at {before:g} and {leak:g} l/min"
    )
    return f"{SHORT_LAWS[row['law']]}, {friction_words(row['friction'])}, {valve} ({change})"


def _before(times: pd.Series, leak: float) -> float:
    return float(times.index[list(times.index).index(leak) - 1])
