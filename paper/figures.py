"""The figures of the page: computation, drawing, and what each shows."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import NamedTuple

import pandas as pd
from matplotlib.figure import Figure

from paper import verdicts
from paper.force_rate import force_rate_table, share_table
from paper.loop import closed_bode_table
from paper.moves import closed_moves_table, displacement_table
from paper.pictures import (
    paint_closed_bode,
    paint_closed_moves,
    paint_displacement,
    paint_force_rate,
    paint_friction_scan,
    paint_sensitivity,
    paint_settling,
    paint_share,
)
from paper.rig import Rig
from paper.sensitivity import sensitivity_table
from paper.settling import friction_scan_table, settling_table


class Entry(NamedTuple):
    """One figure of the page."""

    key: str  # name of its files, and of its text in page.html.j2
    title: str
    compute: Callable[[Rig], pd.DataFrame]
    paint: Callable[[Figure, pd.DataFrame, Rig], None]
    show: Callable[[Rig, pd.DataFrame], verdicts.Shown]
    height: float  # inches
    equations: str = ""


MOTION = "(1)–(3), (8)–(14), (17)"

FIGURES = (
    Entry(
        "fig12_displacement", "Fig. 12: displacement in start–stop moves",
        displacement_table, paint_displacement, verdicts.displacement, 6.4, MOTION,
    ),
    Entry(
        "fig12_closed_loop", "Fig. 12 in a closed position loop",
        closed_moves_table, paint_closed_moves, verdicts.closed_moves, 6.2, MOTION,
    ),
    Entry(
        "fig13_settling_time", "Fig. 13: settling time against leakage resistance",
        settling_table, paint_settling, verdicts.settling, 6.6, "(10), (12)–(14), (17)",
    ),
    Entry(
        "section4_force_rate", "Section 4: what changes the force, laminar leak",
        partial(force_rate_table, law="laminar"), paint_force_rate, partial(verdicts.terms, law="laminar"), 6.8,
        "(19), (20), (23), (24)",
    ),
    Entry(
        "section4_throttle", "Section 4: the same with a throttle",
        partial(force_rate_table, law="throttle"), paint_force_rate, partial(verdicts.terms, law="throttle"), 6.8,
        "(14), (19), (20), (23), (24) with Q_i = K_i √ΔP",
    ),
    Entry(
        "section4_share", "Section 4: leakage’s share against the pressure difference",
        share_table, paint_share, verdicts.share, 3.6, "(10), (24)",
    ),
    Entry(
        "bode_closed_loop", "Frequency response of the closed position loop",
        closed_bode_table, paint_closed_bode, verdicts.closed_loop, 4.8,
    ),
    Entry(
        "friction_scan", "How much friction hides the trend of Fig. 13",
        friction_scan_table, paint_friction_scan, verdicts.friction_scan, 3.6,
    ),
    Entry(
        "sensitivity", "Which assumed parameter changes which result",
        sensitivity_table, paint_sensitivity, verdicts.sensitivity, 6.6,
    ),
)  # fmt: skip
