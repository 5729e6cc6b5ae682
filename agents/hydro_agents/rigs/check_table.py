"""``hydro check-rig``: the figures of a rig on the console, as CSV and as Markdown."""

from __future__ import annotations

from pathlib import Path

import pandas as pd
from rich.box import SIMPLE_HEAD
from rich.padding import Padding
from rich.table import Table
from rich.text import Text

from hydro_agents.rigs.brief import assumed, brief
from hydro_agents.rigs.check import BAR, Row, check_rig
from hydro_agents.running.console import PlainConsole
from hydro_agents.running.folders import output_folder
from hydro_env import PlantParameters
from hydro_env.files import read_yaml, write_text
from hydro_env.plant.analysis import leak_at_test_pressure
from hydro_env.task.rig import Rig, read_rig
from hydro_env.task.sensors import SENSORS

CSV_FILE = "check.csv"
TABLE_FILE = "check.md"
HEADINGS = ("", "quantity", "at", "value", "unit")
NOTE = (
    "Leaks are in l/min at 100 bar across the piston. Gains are valve command (1 = 10 V) per metre of error, in a "
    "loop with a proportional controller, linearised at rest without dry friction, exactly sampled."
)


def check_to_console(rig: Path | None, folder: Path | None, overwrite: bool) -> list[Path]:
    """Print the table of a rig; write ``check.csv`` and ``check.md`` into a folder if one is given.

    Raises:
        ConfigurationError: the rig is wrong or cannot work, or the folder cannot be used.
    """
    given = read_rig(rig) if rig is not None else Rig(PlantParameters(), {}, {}, "rig")
    rows = check_rig(given.plant, given.source)
    title = f"{rig.name if rig is not None else 'the rig of Kovari (2015)'}: {_summary(given)}"
    files = []
    if folder is not None:
        with output_folder(folder, "check-rig", (CSV_FILE, TABLE_FILE), overwrite=overwrite):
            write_text(folder / CSV_FILE, check_csv(rows))
            write_text(folder / TABLE_FILE, check_markdown(rows, title))
        files = [folder / CSV_FILE, folder / TABLE_FILE]
    console = PlainConsole()
    console.print(title, soft_wrap=True)
    console.print(_brief(rows, given.plant))
    for line in _assumed(rig, given.plant):
        console.print(line)
    console.print(_table(rows))
    return files


def _summary(rig: Rig) -> str:
    parameters = rig.plant
    cylinder = parameters.cylinder
    rods = f"{1e3 * cylinder.rod_diameter:.4g}"
    rods += f" and {1e3 * cylinder.rod_diameter_a:.4g}" if cylinder.rod_diameter_a else ""
    leak = leak_at_test_pressure(parameters)
    return (
        f"{1e3 * cylinder.bore_diameter:.4g}/{rods} x {1e3 * cylinder.stroke:.4g} mm, "
        f"{parameters.load.mass + cylinder.piston_mass:.4g} kg, {parameters.supply.pressure / BAR:.4g} bar, "
        f"own leak {leak:.3g} l/min at 100 bar"
        + "".join(f", no sensor for {name}" for name in SENSORS if rig.sensors.get(f"sensors.{name}.fitted") is False)
    )


def _brief(rows: list[Row], parameters: PlantParameters) -> Table:
    table = Table(box=None, show_header=False, padding=(0, 2, 0, 0))
    for name, text in brief(rows, parameters):
        table.add_row(name, text)
    return table


def _assumed(rig: Path | None, parameters: PlantParameters) -> list[Padding | str]:
    if rig is None:
        return []
    groups = assumed(read_yaml(rig), parameters)
    if not groups:
        return ["", "The file gives every value."]
    lines: list[Padding | str] = ["", "Not in the file, taken from the paper's rig (SI units):"]
    return [*lines, *(Padding(f"{group}: {', '.join(entries)}", (0, 0, 0, 2)) for group, entries in groups)]


def _table(rows: list[Row]) -> Table:
    """The table, narrow enough for a terminal of 80 columns."""
    table = Table(box=SIMPLE_HEAD, header_style="bold", padding=(0, 1, 0, 0), pad_edge=False)
    for heading in HEADINGS[1:]:
        table.add_column(heading, justify="right" if heading == "value" else "left")
    group = ""
    for row in rows:
        if row.group != group:
            table.add_section()
            table.add_row(Text(row.group, style="bold"))
        table.add_row(row.quantity, row.at, row.text(4), row.unit)
        group = row.group
    return table


def check_csv(rows: list[Row]) -> str:
    """All figures with nine digits, one per line."""
    text: str = pd.DataFrame([row._replace(value=row.text(9)) for row in rows]).to_csv(index=False, lineterminator="\n")
    return text


def check_markdown(rows: list[Row], title: str) -> str:
    """The table as Markdown."""
    cells = [HEADINGS, ("---", "---", "---", "---:", "---")]
    cells += [(row.group, row.quantity, row.at, row.text(4), row.unit) for row in rows]
    table = "\n".join("| " + " | ".join(cell.replace("|", r"\|") for cell in line) + " |" for line in cells)
    return f"# {title}\n\n{table}\n\n{NOTE}\n"
