"""``python -m paper``: all figures as pictures and tables, and the page that compares them with the paper."""

from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import pandas as pd
from matplotlib.axes import Axes

from hydro_agents.report.kit import Page, drawn, picture
from hydro_agents.running.console import ProgressDisplay
from hydro_agents.running.folders import output_folder
from hydro_agents.running.machine import Origin
from hydro_env.files import read_yaml, write_text, write_whole
from paper import pictures, verdicts
from paper.force_rate import force_rate_table, share_table
from paper.loop import closed_bode_table, sensible_gain
from paper.moves import displacement_table
from paper.settling import settling_table

PAGE_FILE = "page.html"
EQUATIONS_FILE = "equations.csv"
VERDICTS_FILE = "verdicts.csv"
SUFFIXES = ("png", "csv")


class Entry(NamedTuple):
    """One figure of the page."""

    compute: Callable[[], pd.DataFrame]
    paint: Callable[[pd.DataFrame], Sequence[Axes]]
    show: Callable[[pd.DataFrame], verdicts.Shown]
    title: str
    how: str


TEXTS = read_yaml(Path(__file__).with_name("figures.yaml"))
WAYS: dict[str, tuple[Any, Any, Any]] = {
    "fig12_displacement": (displacement_table, pictures.paint_displacement, verdicts.displacement),
    "fig13_settling_time": (settling_table, pictures.paint_settling, verdicts.settling),
    "section4_force_rate": (partial(force_rate_table, "laminar"), pictures.paint_force_rate, verdicts.terms),
    "section4_share": (share_table, pictures.paint_share, verdicts.share),
    "bode_closed_loop": (closed_bode_table, pictures.paint_closed_bode, verdicts.closed_loop),
}
FIGURES = {key: Entry(*ways, **TEXTS[key]) for key, ways in WAYS.items()}  # by the name of their files


def reproduce_to_folder(folder: Path, overwrite: bool, command: str = "python -m paper") -> Path:
    """Compute, draw and write everything; returns the page, which quotes the command line.

    Raises:
        ConfigurationError: the folder cannot be used (:func:`~hydro_agents.running.folders.output_folder`).
    """
    files = [PAGE_FILE, EQUATIONS_FILE, VERDICTS_FILE]
    files += [f"{key}.{suffix}" for key in FIGURES for suffix in SUFFIXES]
    with output_folder(folder, "paper", files, overwrite=overwrite), ProgressDisplay() as display:
        tables = {}
        for number, (key, entry) in enumerate(FIGURES.items(), 1):
            tables[key] = entry.compute()
            display.update("figures", number, len(FIGURES), entry.title)
        shown = {key: entry.show(tables[key]) for key, entry in FIGURES.items()}
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
        for key, entry in FIGURES.items():
            page.heading(entry.title)
            _draw(page, key, tables[key], folder)
            page.table(shown[key].table)
            page.text(entry.how, "soft")
        page.heading("Every equation, and the function that computes it")
        page.table(equations.set_index("equation"), words=True)
        page.write(folder / PAGE_FILE, Origin.now(command))
    return folder / PAGE_FILE


@drawn
def _draw(page: Page, key: str, table: pd.DataFrame, folder: Path) -> None:
    """Draw a figure into its files and into the page, and write its table."""
    panels = FIGURES[key].paint(table)
    write_whole(folder / f"{key}.png", picture(panels, "png"))
    write_text(folder / f"{key}.csv", table.to_csv(index=False, float_format="%.9g"))
    page.figure(panels, FIGURES[key].title)


def verdict_table(figures: dict[str, verdicts.Shown]) -> pd.DataFrame:
    """The verdicts on all conclusions of the paper, in the order of the page."""
    rows = []
    for key, shown in figures.items():
        figure = FIGURES[key].title.partition(":")[0]
        rows += [(figure, *verdict) for verdict in shown.verdicts]
    return pd.DataFrame(rows, columns=["figure", *verdicts.Verdict._fields])
