"""How much proportional gain the sampled position loop bears as the seal wears, and what speed that allows."""

from __future__ import annotations

import math

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from agents.controllers.sampled_loop import speed_per_command
from agents.reproduction.closed_loop import (
    GAIN_MARGIN,
    LONGEST_SETTLING,
    TIMING,
    bandwidth,
    loop_at,
    places,
    settling_time,
)
from agents.reproduction.drawing import COLOURS, ReproducedFigure, millimetres, panel_title, plain
from agents.reproduction.rig import LAWS, Rig, with_leak
from hydro_env import HydroError, PlantParameters
from hydro_env.plant.linearisation import linearise

LEAKS = (0.01, 0.03, 0.1, 0.3, 0.5, 1.0, 2.0, 3.0, 4.0)
"""l/min at 100 bar."""


SAME = 0.03
"""Relative change of a measure of speed that counts as none."""


def limit_table(rig: Rig) -> pd.DataFrame:
    """Largest stable gain by law, leak and position, and what the loop does at gains below it.

    ``limit_per_m`` in command (1 = 10 V) per metre; ``continuous_limit_per_m`` = 2 ζ ω over the speed per command: no
    sampling, no latency, an ideal valve (Merritt 1967). NaN where the position cannot be held. ``gain_per_m`` is the
    smallest limit over the positions at this leak, divided by the gain margin; ``bandwidth_hz``, ``settling_s`` (2 % of
    a small step) and ``velocity_gain_per_s`` are those of the loop at this place with that gain.
    """
    rows = []
    for law in LAWS:
        for leak in LEAKS:
            plant = with_leak(rig.parameters, leak, law)
            loops = {place: loop_at(plant, place) for place in places(rig)}
            limits = {place: loop.largest_stable_gain() if loop else math.nan for place, loop in loops.items()}
            known = [limit for limit in limits.values() if math.isfinite(limit) and limit > 0.0]
            gain = min(known) / GAIN_MARGIN if known else math.nan
            for place, loop in loops.items():
                usable = loop is not None and math.isfinite(gain)
                rows.append(
                    {
                        "law": law,
                        "leak_lpm": leak,
                        "position_mm": 1e3 * place,
                        "limit_per_m": limits[place],
                        "continuous_limit_per_m": _continuous(plant, place),
                        "gain_per_m": gain,
                        "bandwidth_hz": bandwidth(loop, gain) if loop is not None and usable else math.nan,
                        "settling_s": settling_time(loop, gain) if loop is not None and usable else math.nan,
                        "velocity_gain_per_s": gain * speed_per_command(plant, place) if usable else math.nan,
                    }
                )
    table = pd.DataFrame(rows)
    if not np.isfinite(table["limit_per_m"]).any():
        raise HydroError("no gain up to 1e6 per metre makes the position loop unstable anywhere: there is no limit")
    return table


def _continuous(plant: PlantParameters, place: float) -> float:
    try:
        mode = linearise(plant.replace(friction={"model": "none"}), position=place).hydraulic_mode
        return 2.0 * mode.damping_ratio * mode.natural_frequency / speed_per_command(plant, place)
    except (ArithmeticError, HydroError):  # overdamped, or not to be held
        return math.nan


def achievable(table: pd.DataFrame) -> pd.DataFrame:
    """Per law and leak, with one gain for the whole reach: the worst bandwidth, settling time and velocity gain.

    Over the positions that can be held with every leak, so that all leaks are judged at the same places.
    """
    held = table.groupby("position_mm")["limit_per_m"].transform(lambda limits: limits.notna().all())
    judged = table[held] if held.any() else table
    grouped = judged.groupby(["law", "leak_lpm"], sort=False)
    return grouped.agg(
        limit_per_m=("limit_per_m", "min"),
        gain_per_m=("gain_per_m", "first"),
        bandwidth_hz=("bandwidth_hz", "min"),
        settling_s=("settling_s", "max"),
        velocity_gain_per_s=("velocity_gain_per_s", "min"),
    ).reset_index()


def paint_stability(figure: Figure, table: pd.DataFrame) -> None:
    """The limits at several positions for both laws; bandwidth and settling time with the gain margin."""
    grid = figure.subplots(2, 2, sharex=True)
    positions = sorted(table["position_mm"].unique())
    for axes, (law, words) in zip(grid[0], LAWS.items(), strict=True):
        for colour, position in zip(COLOURS, positions, strict=False):
            part = table[(table["law"] == law) & (table["position_mm"] == position)]
            axes.plot(part["leak_lpm"], part["limit_per_m"], color=colour, label=millimetres(position))
            rule = part["continuous_limit_per_m"]
            axes.plot(part["leak_lpm"], rule, color=colour, linestyle=(0, (2, 2)), linewidth=0.9)
        axes.set(yscale="log")
        axes.yaxis.set_major_formatter(lambda value, _: f"{value:g}")
        axes.yaxis.set_minor_formatter(lambda value, _: f"{value:g}" if str(value)[0] in "25" else "")
        axes.tick_params(axis="y", which="minor", labelsize=7.5)
        panel_title(axes, f"Largest stable gain, {words.split(',')[0].removesuffix(' (10)')}")
    top = max(axes.get_ylim()[1] for axes in grid[0])
    low = min(axes.get_ylim()[0] for axes in grid[0])
    for axes in grid[0]:
        axes.set_ylim(low, top)
    grid[0, 0].set_ylabel("command per metre (1 = 10 V)")
    laminar = table[table["law"] == next(iter(LAWS))]
    for axes, column, label, heading in zip(
        grid[1],
        ("bandwidth_hz", "settling_s"),
        ("bandwidth, Hz", "settling to 2 %, s"),
        ("Bandwidth", "Settling time"),
        strict=True,
    ):
        for colour, position in zip(COLOURS, positions, strict=False):
            part = laminar[laminar["position_mm"] == position]
            axes.plot(part["leak_lpm"], part[column], color=colour, marker="o", markersize=3)
        axes.set(ylim=(0.0, 1.1 * np.nanmax(laminar[column])), ylabel=label, xlabel="leak, l/min at 100 bar")
        panel_title(axes, f"{heading} at 1/{GAIN_MARGIN:g} of the limit, laminar leak")
    for axes in grid[1]:
        axes.set(xscale="log")
        axes.set_xticks(LEAKS, [f"{leak:g}" if leak not in (0.5, 3.0) else "" for leak in LEAKS])
        axes.minorticks_off()
    handles, labels = grid[0, 0].get_legend_handles_labels()
    figure.legend(
        handles,
        labels,
        title="position (dotted: rule 2 ζ ω, no sampling, ideal valve)",
        title_fontsize=8.5,
        loc="outside upper center",
        ncols=len(positions),
        fontsize=8.0,
    )


def stability_figure(rig: Rig) -> ReproducedFigure:
    """The limits and the speed they allow, with their words."""
    table = limit_table(rig)
    told = achievable(table)
    ends = {law: (part.iloc[0], part.iloc[-1]) for law, part in told.groupby("law", sort=False)}
    new, worn = ends["laminar"]
    growth = worn["limit_per_m"] / new["limit_per_m"]
    single = _growth_by_place(table)
    rule = table[table["law"] == "laminar"].groupby("leak_lpm")["continuous_limit_per_m"].min()
    found = [
        f"One gain for the whole reach: the limit is {new['limit_per_m']:.4g} per metre with the new seal and "
        f"{worn['limit_per_m']:.4g} at {LEAKS[-1]:g} l/min laminar, {growth:.2f} times as much "
        f"({ends['throttle'][1]['limit_per_m'] / ends['throttle'][0]['limit_per_m']:.2f} times with a throttle).",
        f"In speed, at 1/{GAIN_MARGIN:g} of the limit: bandwidth {_hertz(new)} new and "
        f"{_hertz(worn)} worn, settling {_settling(new)} and {_settling(worn)}, "
        f"velocity gain {new['velocity_gain_per_s']:.1f} and "
        f"{worn['velocity_gain_per_s']:.1f} 1/s: " + _verdict(new, worn),
        f"Place by place the limit changes between new and worn by factors of {single.min():.2f} to "
        f"{single.max():.2f}.",
    ]
    differs = []
    if rule.notna().all() and rule.iloc[-1] / rule.iloc[0] > 1.3 * growth:
        differs.append(
            f"That leakage adds margin is the rule for a continuous loop with an ideal valve: 2 ζ ω over the speed "
            f"grows "
            f"from {plain(rule.iloc[0])} to {plain(rule.iloc[-1])} per metre, {rule.iloc[-1] / rule.iloc[0]:.1f} "
            f"times. In the "
            f"sampled loop the lag of valve, latency and holding shifts the phase at the resonance, so that the "
            f"limit follows the damping less: it becomes {growth:.2f} times as large."
        )
    if new["limit_per_m"] > 1.5 * rule.iloc[0]:
        differs.append(
            f"With the new seal the sampled loop bears {new['limit_per_m'] / rule.iloc[0]:.1f} times the gain of that "
            f"rule, because the lag turns the resonance out of the critical direction. This hangs on valve and latency "
            f"as assumed and on small motions: a rig should not be tuned so close to it without a test."
        )
    absent = int(table["limit_per_m"].isna().sum())
    return ReproducedFigure(
        table=table,
        paint=paint_stability,
        height=6.0,
        paper="Leakage damps, says the paper. A better damped axis should bear more gain: how much speed does a new "
        "seal cost?",
        how=f"Proportional controller, {TIMING}. Plant linearised at rest at {len(places(rig))} positions over 0.9 of "
        f"what the supply can hold, valve as assumed, no dry friction. The limit is the gain at which an eigenvalue "
        f"of the sampled loop leaves the unit circle. Bandwidth: −3 dB from the value at rest, worst of the "
        f"positions that every leak lets hold; settling: 2 % of a small step, likewise."
        + (f" {absent} of {len(table)} points cannot be held with their leak and are left out." if absent else ""),
        found=found,
        differs=differs,
        summary=_summary(told),
    )


def _verdict(new: pd.Series, worn: pd.Series) -> str:
    """Which measures of speed are better with the worn seal, and which are worse."""
    ratios = {
        "bandwidth": worn["bandwidth_hz"] / new["bandwidth_hz"],
        "settling": new["settling_s"] / worn["settling_s"],
        "velocity gain": worn["velocity_gain_per_s"] / new["velocity_gain_per_s"],
    }
    better = [f"{100 * (1 - 1 / ratio):.0f} % in {name}" for name, ratio in ratios.items() if ratio > 1.0 + SAME]
    worse = [f"{100 * (1 - ratio):.0f} % in {name}" for name, ratio in ratios.items() if ratio < 1.0 - SAME]
    costs = f"the new seal costs {', '.join(better)}" if better else "the new seal costs no speed"
    return costs + (f"; the worn one costs {', '.join(worse)}." if worse else ".")


def _growth_by_place(table: pd.DataFrame) -> pd.Series:
    part = table[table["law"] == "laminar"].dropna(subset="limit_per_m")
    ends = part.groupby("position_mm")["limit_per_m"].agg(["first", "last"])
    return ends["last"] / ends["first"]


def _hertz(row: pd.Series, digits: int = 1) -> str:
    hertz = float(row["bandwidth_hz"])
    return f"{hertz:.{digits}f} Hz" if math.isfinite(hertz) else "none"


def _settling(row: pd.Series) -> str:
    seconds = float(row["settling_s"])
    return f"{1e3 * seconds:.0f} ms" if math.isfinite(seconds) else f"more than {LONGEST_SETTLING:g} s"


def _summary(told: pd.DataFrame) -> pd.DataFrame:
    return pd.DataFrame(
        {
            "leak": told["law"],
            "l/min at 100 bar": [f"{value:g}" for value in told["leak_lpm"]],
            "largest stable gain, 1/m": [f"{value:.4g}" for value in told["limit_per_m"]],
            "gain used, 1/m": [f"{value:.4g}" for value in told["gain_per_m"]],
            "bandwidth": [_hertz(row, 2) for _, row in told.iterrows()],
            "settling to 2 %": [_settling(row) for _, row in told.iterrows()],
            "velocity gain, 1/s": [f"{value:.1f}" for value in told["velocity_gain_per_s"]],
        }
    )
