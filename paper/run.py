"""``python -m paper``: all figures as pictures and tables, and the page that compares them with the paper."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import NamedTuple

import pandas as pd
from matplotlib.axes import Axes

from hydro_agents.controllers.sampled_loop import COMMAND_LATENCY, CONTROL_PERIOD
from hydro_agents.report.kit import Page, drawn, picture
from hydro_agents.running.console import ProgressDisplay
from hydro_agents.running.folders import output_folder
from hydro_agents.running.machine import Origin
from hydro_env.files import write_text, write_whole
from paper import pictures, verdicts
from paper.force_rate import force_rate_table, share_table
from paper.loop import GAIN_MARGIN, closed_bode_table, sensible_gain
from paper.moves import displacement_table
from paper.settling import settling_table

PAGE_FILE = "page.html"
EQUATIONS_FILE = "equations.csv"
VERDICTS_FILE = "verdicts.csv"
SUFFIXES = ("png", "csv")


class Entry(NamedTuple):
    """One figure of the page."""

    key: str  # name of its files
    title: str
    compute: Callable[[], pd.DataFrame]
    paint: Callable[[pd.DataFrame], Sequence[Axes]]
    show: Callable[[pd.DataFrame], verdicts.Shown]
    how: str


FIGURES = (
    Entry(
        "fig12_displacement",
        "Fig. 12: displacement in start–stop moves",
        displacement_table,
        pictures.paint_displacement,
        verdicts.displacement,
        "Valve commands of ±4 V without feedback, a throttle between the chambers as on the paper’s rig; the position "
        "goes through the sensor of the environment. Creep: in the 0.4 s after the first stop. Oscillation: from peak "
        "to peak, 40 to 90 ms after it. Equations (1)–(3), (8)–(14), (17).",
    ),
    Entry(
        "fig13_settling_time",
        "Fig. 13: settling time against leakage resistance",
        settling_table,
        pictures.paint_settling,
        verdicts.settling,
        "The axis extends at 4 V from +5 mm; the valve closes after 0.15 s. The settling time is the last crossing of "
        "0.1 m/s², without the drift and without the noise of an accelerometer. Linear theory: T = t₁ + "
        "ln(a₁/0.1)/(ζω). With the friction assumed here, friction ends the oscillation after a few periods and hides "
        "the trend of the paper, which gives no friction. Equations (10), (12)–(14), (17).",
    ),
    Entry(
        "section4_force_rate",
        "Section 4: what changes the force, laminar leak",
        partial(force_rate_table, "laminar"),
        pictures.paint_force_rate,
        verdicts.terms,
        "Picture: 1 l/min at 100 bar, 0.1 l/min past the rod seal, no friction; 4 V from +5 mm for 0.15 s, then 0 V. "
        "Table: the move, and the 0.15 s after the stop. Leakage does not always slow the force: its sign is that of "
        "P_b − P_a. Equations (19), (20), (23), (24).",
    ),
    Entry(
        "section4_share",
        "Section 4: leakage’s share against the pressure difference",
        share_table,
        pictures.paint_share,
        verdicts.share,
        "The move and the stop of the two figures above. Share: sum of |internal leakage term| over the sum of all "
        "four sizes, by |P_a − P_b|. The paper writes a laminar leak, but its rig leaks through a throttle, Q_i = "
        "K_i √ΔP, most steeply where the difference is small. Equations (10), (24).",
    ),
    Entry(
        "bode_closed_loop",
        "Frequency response of the closed position loop",
        closed_bode_table,
        pictures.paint_closed_bode,
        verdicts.closed_loop,
        f"Proportional controller with half of the largest gain (1/{GAIN_MARGIN:g}) that is stable over the reach with "
        f"a tight seal; position sampled every {1e3 * CONTROL_PERIOD:g} ms, command {1e3 * COMMAND_LATENCY:g} ms late; "
        "linearised at +20 mm, laminar leak, no dry friction. The oil column causes the second peak.",
    ),
)


def reproduce_to_folder(folder: Path, overwrite: bool, command: str = "python -m paper") -> Path:
    """Compute, draw and write everything; returns the page.

    Args:
        folder: for the results.
        overwrite: whether to replace earlier results.
        command: the command line, quoted on the page.

    Raises:
        ConfigurationError: the folder cannot be used (:func:`~hydro_agents.running.folders.output_folder`).
    """
    files = [PAGE_FILE, EQUATIONS_FILE, VERDICTS_FILE]
    for entry in FIGURES:
        files += [f"{entry.key}.{suffix}" for suffix in SUFFIXES]
    with output_folder(folder, "paper", files, overwrite=overwrite), ProgressDisplay() as display:
        tables = {}
        for number, entry in enumerate(FIGURES):
            display.update("figures", number, len(FIGURES), entry.title)
            tables[entry.key] = entry.compute()
        display.update("figures", len(FIGURES), len(FIGURES))
        shown = {entry.title: entry.show(tables[entry.key]) for entry in FIGURES}
        found = verdict_table(shown)
        equations = pd.read_csv(Path(__file__).with_name(EQUATIONS_FILE))
        write_text(folder / VERDICTS_FILE, found.to_csv(index=False))
        write_text(folder / EQUATIONS_FILE, equations.to_csv(index=False))
        page = Page("The leaking servo axis: the paper’s figures, computed again", "the tables beside this page")
        page.text(
            "A. Kovari, Effect of Leakage in Electrohydraulic Servo Systems Based on Complex Nonlinear Mathematical "
            "Model and Experimental Results, Acta Polytechnica Hungarica 12(3), 2015, beside this model of the rig "
            "of its Table 1. The paper prints no supply pressure, range of leaks, friction or settling time; they are "
            f"assumed here: compare trends, not values. The gain of the closed loop is {sensible_gain():.4g} per metre "
            "(1 = 10 V)."
        )
        page.table(found.drop(columns="figure").set_index("conclusion"), "Conclusions of the paper", words=True)
        for entry in FIGURES:
            page.heading(entry.title)
            _draw(page, entry, tables[entry.key], folder)
            page.table(shown[entry.title].table)
            page.text(entry.how, "soft")
        page.heading("Every equation, and the function that computes it")
        page.table(equations.set_index("equation"), words=True)
        page.write(folder / PAGE_FILE, Origin.now(command))
    return folder / PAGE_FILE


@drawn
def _draw(page: Page, entry: Entry, table: pd.DataFrame, folder: Path) -> None:
    """Draw a figure into its files and into the page, and write its table."""
    panels = entry.paint(table)
    write_whole(folder / f"{entry.key}.png", picture(panels, "png"))
    write_text(folder / f"{entry.key}.csv", table.to_csv(index=False, float_format="%.9g"))
    page.figure(panels, entry.title)


def verdict_table(figures: dict[str, verdicts.Shown]) -> pd.DataFrame:
    """The verdicts on all conclusions of the paper, in the order of the page."""
    rows = []
    for title, shown in figures.items():
        for verdict in shown.verdicts:
            rows.append((title.partition(":")[0], *verdict))
    return pd.DataFrame(rows, columns=["figure", *verdicts.Verdict._fields])
