"""Which of the assumed parameters the settling time hangs on, and how little friction the trend of Fig. 13 needs."""

from __future__ import annotations

import math

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from agents.reproduction.drawing import COLOURS, LEAK_COLOURS, ReproducedFigure, legend, panel_title
from agents.reproduction.rig import quick_stop, with_leak
from agents.reproduction.settling import healthy_frequency, settling_of
from hydro_env import ConfigurationError, PlantParameters

LEAK = 0.3
CHANGE = 0.2
FRICTION_SHARE = 0.02
"""Friction of the base case, in parts of what is assumed: little enough that the axis still swings."""

FRICTION_SHARES = (0.0, 0.005, 0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1.0)
SCAN_LEAKS = (0.01, 0.1, 0.3, 1.0, 4.0)
SHOWN = 12


def rubbing(base: PlantParameters, share: float) -> PlantParameters:
    """The plant with its friction forces times ``share``."""
    friction = base.friction
    return base.replace(
        friction={
            "coulomb_force": share * friction.coulomb_force,
            "breakaway_force": share * friction.breakaway_force,
        }
    )


def assumed_parameters(base: PlantParameters) -> dict[str, float]:
    """``group.field`` and value of every parameter that the paper does not give and that a factor can change.

    The internal leak is left out: it is what the figures vary.
    """
    found = {}
    for group in PlantParameters.model_fields:
        settings = getattr(base, group)
        for field, details in type(settings).model_fields.items():
            value, origin = getattr(settings, field), details.description or ""
            if origin.startswith("assumed") and isinstance(value, float) and 0.0 < value < math.inf:
                found[f"{group}.{field}"] = value
    found.pop("leakage.internal_resistance", None)
    return found


def sensitivity_table(base: PlantParameters) -> pd.DataFrame:
    """Settling time with every assumed parameter at 80 and 120 %, ranked; and over friction × leak (``kind``)."""
    frequency = healthy_frequency(base)
    start = with_leak(rubbing(base, FRICTION_SHARE), LEAK, "laminar")
    normal = settling_of(quick_stop(start), frequency).clean
    rows = []
    for name, value in assumed_parameters(start).items():
        group, field = name.split(".")
        times = []
        for factor in (1 - CHANGE, 1 + CHANGE):
            try:
                times.append(
                    settling_of(quick_stop(start.replace(**{group: {field: factor * value}})), frequency).clean
                )
            except ConfigurationError:  # outside what the parameter may be
                times.append(math.nan)
        rows.append({"kind": "parameter", "name": name, "value": value, "low_s": times[0], "high_s": times[1]})
    ranked = pd.DataFrame(rows)
    ranked["normal_s"] = normal
    ranked["effect_s"] = (ranked[["low_s", "high_s"]].sub(normal)).abs().max(axis=1)
    ranked = ranked.sort_values("effect_s", ascending=False, ignore_index=True)
    scan = [
        {
            "kind": "friction",
            "name": "friction_share",
            "value": share,
            "leak_lpm": leak,
            "normal_s": settling_of(quick_stop(with_leak(rubbing(base, share), leak, "laminar")), frequency).clean,
        }
        for leak in SCAN_LEAKS
        for share in FRICTION_SHARES
    ]
    return pd.concat([ranked, pd.DataFrame(scan)], ignore_index=True)


def paint_sensitivity(figure: Figure, table: pd.DataFrame) -> None:
    """The ranked parameters as bars; settling time over friction."""
    left, right = figure.subplots(1, 2, width_ratios=[1.25, 1.0])
    ranked = table[table["kind"] == "parameter"].head(SHOWN)
    normal = 1e3 * float(ranked["normal_s"].iloc[0])
    rows = np.arange(len(ranked))
    for colour, column, words in zip(COLOURS, ("low_s", "high_s"), ("−20 %", "+20 %"), strict=False):
        left.barh(rows, 1e3 * ranked[column] - normal, color=colour, height=0.7, alpha=0.8, label=words)
    left.axvline(0.0, color="#222222", linewidth=0.8)
    left.set_yticks(rows, [name.replace(".", ": ").replace("_", " ") for name in ranked["name"]])
    left.invert_yaxis()
    left.grid(visible=False, axis="y")
    left.set_xlabel(f"change of the settling time of {normal:.0f} ms, ms")
    panel_title(left, "Assumed parameters, ranked")
    legend(left, title="parameter", loc="lower right")
    scan = table[table["kind"] == "friction"]
    shown = 0.5 * min(share for share in FRICTION_SHARES if share > 0.0)
    for colour, leak in zip(LEAK_COLOURS, SCAN_LEAKS, strict=True):
        part = scan[scan["leak_lpm"] == leak]
        right.plot(
            100 * np.maximum(part["value"], shown),
            part["normal_s"],
            color=colour,
            marker="o",
            markersize=3,
            label=f"{leak:g} l/min",
        )
    ticks = [0.5, 1, 2, 5, 10, 20, 50, 100]
    right.set(xscale="log", yscale="log", xlabel="friction, % of what is assumed", ylabel="settling time, s")
    right.set_xticks([100 * shown, *ticks], ["0", *(f"{tick:g}" for tick in ticks)])
    right.set_yticks([0.05, 0.1, 0.2, 0.5, 1, 2], ["0.05", "0.1", "0.2", "0.5", "1", "2"])
    right.minorticks_off()
    panel_title(right, "How much friction the trend bears")
    legend(right, title="leak at 100 bar", loc="upper right")


def sensitivity_figure(base: PlantParameters) -> ReproducedFigure:
    """The ranking and the scan with their words."""
    table = sensitivity_table(base)
    ranked = table[table["kind"] == "parameter"]
    scan = table[table["kind"] == "friction"].pivot(index="value", columns="leak_lpm", values="normal_s")
    ratio = scan[SCAN_LEAKS[0]] / scan[1.0]
    bears = ratio[ratio >= 2.0].index.max()
    first = ", ".join(f"{row['name']} (±{1e3 * row['effect_s']:.0f} ms)" for _, row in ranked.head(5).iterrows())
    still = int((ranked["effect_s"] < 0.01 * ranked["normal_s"]).sum())
    coulomb = base.friction.coulomb_force
    return ReproducedFigure(
        key="sensitivity_settling",
        title="Further: what the settling time hangs on",
        table=table,
        paint=paint_sensitivity,
        height=4.6,
        paper="The paper gives no supply pressure, friction or air content, so that its settling times cannot be "
        "recomputed. This is how much each unknown matters.",
        how=f"Quick stop as for Fig. 13, laminar leak of {LEAK:g} l/min, valve with null leakage, friction at "
        f"{100 * FRICTION_SHARE:g} % of what is assumed (else friction alone would decide); one parameter at a time by "
        f"±{100 * CHANGE:.0f} %. All {len(ranked)} assumed parameters that are neither zero nor infinite are in the "
        f"CSV file.",
        found=[
            f"Most weighty: {first}. {still} of {len(ranked)} change the settling time by less than 1 %. Gains and "
            f"resistance of the valve's drive count because they set the speed from which the axis is stopped.",
            f"Between {SCAN_LEAKS[0]:g} and 1 l/min the settling time falls by a factor of {ratio.iloc[0]:.1f} without "
            f"friction and {ratio.iloc[-1]:.2f} with the assumed one; at least a factor of 2 is left up to "
            f"{100 * bears:g} % of it, a Coulomb force of {bears * coulomb:.1f} N.",
        ],
    )
