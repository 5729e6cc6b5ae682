"""``python -m paper``: all figures as pictures and tables, and the page that compares them with the paper."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import NamedTuple

import pandas as pd
from matplotlib.figure import Figure

from hydro_agents.controllers.sampled_loop import COMMAND_LATENCY, CONTROL_PERIOD
from hydro_agents.report.canvas import WIDE, Plot, as_plot, render
from hydro_agents.report.page import make_page
from hydro_agents.running.console import ProgressDisplay
from hydro_agents.running.folders import output_folder
from hydro_agents.running.machine import Origin
from hydro_agents.running.text import Table
from hydro_env import TaskConfig
from hydro_env.files import write_text, write_whole
from hydro_env.task.sensors import Sensors
from paper import pictures, verdicts
from paper.force_rate import force_rate_table, share_table
from paper.loop import GAIN_MARGIN, closed_bode_table, sensible_gain
from paper.moves import displacement_table
from paper.rig import MODERATE, PLANT, SEVERE, TIGHT, flow
from paper.settling import friction_scan_table, settling_table

HERE = Path(__file__).parent
PAGE_FILE = "page.html"
EQUATIONS_FILE = "equations.csv"
VERDICTS_FILE = "verdicts.csv"
SUFFIXES = ("svg", "png", "csv")


class Entry(NamedTuple):
    """One figure of the page."""

    key: str  # name of its files, and of its text in page.html.j2
    title: str
    compute: Callable[[], pd.DataFrame]
    paint: Callable[[Figure, pd.DataFrame], None]
    show: Callable[[pd.DataFrame], verdicts.Shown]
    height: float  # inches
    equations: str = ""


FIGURES = (
    Entry(
        "fig12_displacement", "Fig. 12: displacement in start–stop moves",
        displacement_table, pictures.paint_displacement, verdicts.displacement, 6.4,
        "(1)–(3), (8)–(14), (17)",
    ),
    Entry(
        "fig13_settling_time", "Fig. 13: settling time against leakage resistance",
        settling_table, pictures.paint_settling, verdicts.settling, 6.6, "(10), (12)–(14), (17)",
    ),
    Entry(
        "section4_force_rate", "Section 4: what changes the force, laminar leak",
        partial(force_rate_table, "laminar"), pictures.paint_force_rate, verdicts.terms, 6.8,
        "(19), (20), (23), (24)",
    ),
    Entry(
        "section4_throttle", "Section 4: the same with a throttle",
        partial(force_rate_table, "throttle"), pictures.paint_force_rate, verdicts.throttle, 6.8,
        "(14), (19), (20), (23), (24) with Q_i = K_i √ΔP",
    ),
    Entry(
        "section4_share", "Section 4: leakage’s share against the pressure difference",
        share_table, pictures.paint_share, verdicts.share, 3.6, "(10), (24)",
    ),
    Entry(
        "bode_closed_loop", "Frequency response of the closed position loop",
        closed_bode_table, pictures.paint_closed_bode, verdicts.closed_loop, 4.8,
    ),
    Entry(
        "friction_scan", "How much friction hides the trend of Fig. 13",
        friction_scan_table, pictures.paint_friction_scan, verdicts.friction_scan, 3.6,
    ),
)  # fmt: skip


class Made(NamedTuple):
    """A figure of the page."""

    entry: Entry
    shown: verdicts.Shown
    plot: Plot


def reproduce_to_folder(folder: Path, overwrite: bool, command: str = "python -m paper") -> Path:
    """Compute, draw and write everything; returns the page.

    Args:
        folder: for the results.
        overwrite: whether to replace earlier results.
        command: the command line, quoted on the page.

    Raises:
        ConfigurationError: the folder cannot be used (:func:`~hydro_agents.running.folders.output_folder`).
    """
    files = [PAGE_FILE, EQUATIONS_FILE, VERDICTS_FILE, *(f"{one.key}.{end}" for one in FIGURES for end in SUFFIXES)]
    with output_folder(folder, "reproduce", files, overwrite=overwrite), ProgressDisplay() as display:
        made = []
        for number, entry in enumerate(FIGURES):
            display.update("figures", number, len(FIGURES), entry.title)
            made.append(_made(entry, folder))
        display.update("figures", len(FIGURES), len(FIGURES))
        equations, found = pd.read_csv(HERE / EQUATIONS_FILE), verdict_table(made)
        write_text(folder / EQUATIONS_FILE, equations.to_csv(index=False))
        write_text(folder / VERDICTS_FILE, found.to_csv(index=False))
        make_page(
            HERE / "page.html.j2",
            Origin.now(command),
            figures={one.entry.key: one for one in made},
            equations=_words("Equations", equations),
            verdicts=_words("Conclusions", found[["conclusion", "verdict", "measured", "here", "figure"]]),
            counts=Counter(found["verdict"]),
            bounds=TaskConfig().leakage.class_bounds,
            tight=flow(TIGHT),
            moderate=flow(MODERATE),
            severe=flow(SEVERE),
            sensor=Sensors().position,
            loop=f"Proportional controller with {sensible_gain():.4g} per metre (1 = 10 V): the largest gain that is "
            f"stable over the reach with a tight seal ({flow(TIGHT)}), divided by {GAIN_MARGIN:g}; position sampled "
            f"every {1e3 * CONTROL_PERIOD:g} ms, command {1e3 * COMMAND_LATENCY:g} ms late",
            force=PLANT.friction.coulomb_force,
        ).write(folder / PAGE_FILE)
    return folder / PAGE_FILE


def _made(entry: Entry, folder: Path) -> Made:
    """Compute, draw and write one figure."""
    table = entry.compute()
    shown = entry.show(table)
    svg, png = render(lambda figure: entry.paint(figure, table), (WIDE, entry.height), "svg", "png")
    contents = (svg, png, table.to_csv(index=False, float_format="%.9g").encode())
    for suffix, content in zip(SUFFIXES, contents, strict=True):
        write_whole(folder / f"{entry.key}.{suffix}", content)
    findings = " ".join(f"{verdict.measured}: {verdict.here}." for verdict in shown.verdicts)
    return Made(entry, shown, as_plot(entry.key, entry.title, "", f"{entry.title}. {findings}", svg, wide=True))


def verdict_table(figures: list[Made]) -> pd.DataFrame:
    """The verdicts on all conclusions of the paper, in the order of the page."""
    rows = [(figure.entry.title.partition(":")[0], *verdict) for figure in figures for verdict in figure.shown.verdicts]
    return pd.DataFrame(rows, columns=["figure", *verdicts.Verdict._fields])


def _words(caption: str, table: pd.DataFrame) -> Table:
    return Table(caption, tuple(table.columns), list(table.itertuples(index=False, name=None)), style="words")
