"""How little friction the trend of Fig. 13 needs to show."""

from __future__ import annotations

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from agents.reproduction.drawing import LEAK_COLOURS, ReproducedFigure, legend, panel_title
from agents.reproduction.results import rubbing
from agents.reproduction.rig import Rig, quick_stop, with_leak
from agents.reproduction.settling import friction_words, healthy_frequency, need_a_swing, settling_of
from agents.reproduction.settling_figure import TIME_TICKS
from hydro_env import HydroError

SHARES = (0.0, 0.005, 0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1.0)
"""Friction in parts of what is assumed."""

LEAKS = (0.01, 0.1, 0.3, 1.0, 4.0)
CLEAR = 2.0
"""Settling with a tight seal over settling at 1 l/min that makes a clear trend."""


def friction_scan_table(rig: Rig) -> pd.DataFrame:
    """Settling time (s) of the quick stop over friction and leak; laminar leak.

    Raises:
        HydroError: the rig has no dry friction, or its stop is too gentle.
    """
    if not rig.has_friction:
        raise HydroError("it has no dry friction that could hide the trend")
    frequency = healthy_frequency(rig)
    rows = []
    for leak in LEAKS:
        for share in SHARES:
            run = quick_stop(with_leak(rubbing(rig.parameters, share), leak, "laminar"), rig)
            time = settling_of(run, frequency, rig.stretch).clean
            rows.append({"friction_share": share, "leak_lpm": leak, "settling_s": time})
            need_a_swing(rows[0]["settling_s"])
    return pd.DataFrame(rows)


def paint_friction_scan(figure: Figure, table: pd.DataFrame) -> None:
    """Settling time over friction."""
    axes = figure.subplots()
    least = 0.5 * min(share for share in SHARES if share > 0.0)
    for colour, leak in zip(LEAK_COLOURS, LEAKS, strict=True):
        part = table[table["leak_lpm"] == leak]
        place = 100 * np.maximum(part["friction_share"], least)
        axes.plot(place, part["settling_s"], color=colour, marker="o", markersize=3, label=f"{leak:g} l/min")
    ticks = [100 * share for share in SHARES if share > 0.0]
    axes.set(xscale="log", yscale="log", xlabel="friction, % of what is assumed", ylabel="settling time, s")
    axes.set_xticks([100 * least, *ticks], ["0", *(f"{tick:g}" for tick in ticks)])
    low, high = axes.get_ylim()
    shown = [tick for tick in TIME_TICKS if low <= tick <= high]
    axes.set_yticks(shown, [f"{tick:g}" for tick in shown])
    axes.minorticks_off()
    panel_title(axes, "Settling time against friction")
    legend(axes, title="leak at 100 bar", loc="best")


def friction_scan_figure(rig: Rig) -> ReproducedFigure:
    """The scan with its words."""
    table = friction_scan_table(rig)
    scan = table.pivot(index="friction_share", columns="leak_lpm", values="settling_s")
    ratio = scan[LEAKS[0]] / scan[1.0]
    bears = ratio[ratio >= CLEAR].index.max()
    force = rig.parameters.friction.coulomb_force
    return ReproducedFigure(
        table=table,
        paint=paint_friction_scan,
        height=3.6,
        paper="The paper sees settling fall with the leak and gives no friction. How much may a rig rub and still show "
        "that?",
        how=f"Quick stop as for Fig. 13, laminar leak, valve as assumed, "
        f"{friction_words(rig.parameters.friction.model)} "
        f"with both forces scaled together ({force:g} N Coulomb at 100 %).",
        found=[
            f"From {LEAKS[0]:g} to 1 l/min the settling time goes from {scan[LEAKS[0]].iloc[0]:.3f} to "
            f"{scan[1.0].iloc[0]:.3f} s without friction, and from {scan[LEAKS[0]].iloc[-1]:.3f} to "
            f"{scan[1.0].iloc[-1]:.3f} s with the assumed one; "
            + (
                f"at least a factor of {CLEAR:g} is left up to {100 * bears:g} % of it, a Coulomb force of "
                f"{bears * force:.1f} N."
                if bears == bears
                else f"a factor of {CLEAR:g} is reached nowhere."
            )
        ],
    )
