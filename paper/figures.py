"""The figures of the page: computation, drawing and sentences of each."""

from __future__ import annotations

import re
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import NamedTuple

import pandas as pd
from matplotlib.figure import Figure

from hydro_agents.controllers.sampled_loop import COMMAND_LATENCY, CONTROL_PERIOD
from hydro_agents.report.canvas import WIDE, render
from hydro_agents.report.leaks import MODERATE, SEVERE, TIGHT, flow
from hydro_agents.report.text import Table, templates
from paper.closed_loop import GAIN_MARGIN, limit_table
from paper.facts import (
    Facts,
    bode_facts,
    closed_bode_facts,
    closed_moves_facts,
    displacement_facts,
    energy_facts,
    force_rate_facts,
    holding_facts,
    map_facts,
    sensitivity_facts,
    share_facts,
    stability_facts,
)
from paper.force_rate import force_rate_table, share_table
from paper.frequency import bode_table, closed_bode_table, map_table
from paper.holding import energy_table, holding_table
from paper.moves import closed_moves_table, displacement_table
from paper.pictures import (
    paint_closed_moves,
    paint_displacement,
    paint_force_rate,
    paint_settling,
    paint_share,
)
from paper.pictures_further import (
    paint_bode,
    paint_closed_bode,
    paint_energy,
    paint_friction_scan,
    paint_holding,
    paint_maps,
    paint_sensitivity,
    paint_stability,
)
from paper.rig import Rig
from paper.sensitivity import sensitivity_table
from paper.settling import friction_scan_table, settling_table
from paper.settling_facts import friction_scan_facts, settling_facts
from paper.verdicts import Verdict, verdicts_of

WORDS = Path(__file__).parent / "words"


class Entry(NamedTuple):
    """One figure of the page."""

    key: str  # name of its files
    title: str
    compute: Callable[[Rig], pd.DataFrame]
    paint: Callable[[Figure, pd.DataFrame, Rig], None]
    facts: Callable[[Rig, pd.DataFrame], Facts]
    height: float  # inches
    equations: str = ""
    in_paper: bool = False
    words: str = ""  # template; the key by default


MOTION = "(1)–(3), (8)–(14), (17)"
FORCE_RATE = {law: (partial(force_rate_table, law=law), partial(force_rate_facts, law=law))
              for law in ("laminar", "throttle")}  # fmt: skip

FIGURES = (
    Entry(
        "fig12_displacement", "Fig. 12: displacement in start–stop moves",
        displacement_table, paint_displacement, displacement_facts, 6.4, MOTION, True,
    ),
    Entry(
        "fig12_closed_loop", "Fig. 12 in a closed position loop",
        closed_moves_table, paint_closed_moves, closed_moves_facts, 6.2, MOTION, True,
    ),
    Entry(
        "fig13_settling_time", "Fig. 13: settling time against leakage resistance",
        settling_table, paint_settling, settling_facts, 6.6, "(10), (12)–(14), (17)", True,
    ),
    Entry(
        "section4_force_rate", "Section 4: what changes the force, laminar leak",
        FORCE_RATE["laminar"][0], paint_force_rate, FORCE_RATE["laminar"][1], 6.8,
        "(19), (20), (23), (24)", True, words="section4_terms",
    ),
    Entry(
        "section4_throttle", "Section 4: the same with a throttle",
        FORCE_RATE["throttle"][0], paint_force_rate, FORCE_RATE["throttle"][1], 6.8,
        "(14), (19), (20), (23), (24) with Q_i = K_i √ΔP", True, words="section4_terms",
    ),
    Entry(
        "section4_share", "Section 4: leakage’s share against the pressure difference",
        share_table, paint_share, share_facts, 3.6, "(10), (24)", True,
    ),
    Entry(
        "maps_frequency_damping", "Further: natural frequency and damping over the stroke",
        map_table, paint_maps, map_facts, 3.6,
    ),
    Entry(
        "bode_position", "Further: frequency response at several leaks",
        bode_table, paint_bode, bode_facts, 4.8,
    ),
    Entry(
        "bode_closed_loop", "Further: frequency response of the closed position loop",
        closed_bode_table, paint_closed_bode, closed_bode_facts, 4.8,
    ),
    Entry(
        "stability_limit", "Further: the largest stable gain, and the speed it allows",
        limit_table, paint_stability, stability_facts, 6.0,
    ),
    Entry(
        "holding_error", "Further: error while holding",
        holding_table, paint_holding, holding_facts, 3.6,
    ),
    Entry(
        "supply_energy", "Further: what the leak costs",
        energy_table, paint_energy, energy_facts, 3.6,
    ),
    Entry(
        "sensitivity", "Further: which assumed parameter changes which result",
        sensitivity_table, paint_sensitivity, sensitivity_facts, 6.6,
    ),
    Entry(
        "friction_scan", "Further: how much friction hides the trend of Fig. 13",
        friction_scan_table, paint_friction_scan, friction_scan_facts, 3.6,
    ),
)  # fmt: skip


class Words(NamedTuple):
    """Sentences of the page about a figure."""

    paper: str  # summary of the paper
    how: str  # how it was computed here
    found: list[str]  # results with numbers from the table
    differs: list[str]  # results that differ from the paper's conclusion
    summary: Table | None
    verdicts: list[Verdict]  # on the paper's conclusions


def write_words(entry: Entry, table: pd.DataFrame, rig: Rig) -> Words:
    """Fill the template of a figure with the facts of its table.

    A template has parts that begin with ``= paper``, ``= how``, ``= found``, ``= differs``; the last two are lists,
    whose sentences begin with ``-``.
    """
    known = entry.facts(rig, table)
    common = {"rig": rig, "tight": flow(TIGHT), "moderate": flow(MODERATE), "severe": flow(SEVERE)}
    common |= {"margin": GAIN_MARGIN, "timing": TIMING}
    text = templates(WORDS, prose=True).get_template(f"{entry.words or entry.key}.j2").render(**common, **known)
    pieces = re.split(r"^= (\w+)$", text, flags=re.MULTILINE)
    parts = dict(zip(pieces[1::2], pieces[2::2], strict=True))
    lists = {name: re.split(r"^- ", parts.get(name, ""), flags=re.MULTILINE)[1:] for name in ("found", "differs")}
    found, differs = ([_joined(item) for item in items] for items in lists.values())
    verdicts = verdicts_of(entry.key, entry.title, known)
    return Words(_joined(parts["paper"]), _joined(parts["how"]), found, differs, known.get("summary"), verdicts)


TIMING = f"position sampled every {1e3 * CONTROL_PERIOD:g} ms, command {1e3 * COMMAND_LATENCY:g} ms late"


def _joined(lines: str) -> str:
    """Lines of a template as one paragraph."""
    return re.sub(r" (?=[.,;:](\s|$))", "", " ".join(lines.split()))


def draw(entry: Entry, table: pd.DataFrame, rig: Rig) -> list[bytes]:
    """The picture as SVG and as PNG."""
    return render(lambda figure: entry.paint(figure, table, rig), (WIDE, entry.height), "svg", "png")
