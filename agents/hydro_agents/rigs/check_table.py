"""``hydro check-rig``: the figures of a rig on the console, as CSV and as Markdown."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import groupby
from pathlib import Path
from typing import Any

import pandas as pd
from rich.padding import Padding
from rich.table import Table as ConsoleTable

from hydro_agents.rigs.check import BAR, LEAKS, MILLIMETRE, Row, check_rig, leak_text
from hydro_agents.rigs.remarks import implausible, position_accuracy, stability_note
from hydro_agents.rigs.stable_gain import DRAWN, beyond_dead_band
from hydro_agents.running.console import PlainConsole, console_table
from hydro_agents.running.folders import output_folder
from hydro_agents.running.tasks import timed_task
from hydro_agents.running.text import Table, markdown
from hydro_env import PlantParameters
from hydro_env.files import read_yaml, write_text
from hydro_env.plant.analysis import leak_at_test_pressure, speed_limits
from hydro_env.plant.parameters import PARAMETER_PATHS
from hydro_env.task.rig import Rig, read_rig
from hydro_env.task.sensors import SENSORS
from hydro_env.units import FULL_VOLTAGE

CSV_FILE = "check.csv"
TABLE_FILE = "check.md"
HEADINGS = ("", "quantity", "at", "value", "unit")
NOTE = (
    "Leaks are in l/min at 100 bar across the piston. Gains are valve command (1 = 10 V) per metre of error, in a "
    "loop with a proportional controller, linearised at rest without dry friction, exactly sampled."
)

WEAK_DAMPING = 0.05  # damping ratio below which an axis rings: after five periods a step still oscillates by a fifth
_PUMP = ("supply.model", ("pump", "accumulator"))
_ACCUMULATOR = ("supply.model", ("accumulator",))
USED_WITH = {
    "valve.coil_inductance": ("valve.model", ("drive",)),
    "friction.bristle_stiffness": ("friction.model", ("lugre",)),
    "friction.bristle_damping": ("friction.model", ("lugre",)),
    "supply.line_volume": ("supply.model", ("pump",)),
    "supply.pump_flow": _PUMP,
    "supply.relief_slope": _PUMP,
    "supply.accumulator_volume": _ACCUMULATOR,
    "supply.precharge_pressure": _ACCUMULATOR,
    "supply.polytropic_index": _ACCUMULATOR,
}
"""Fields that act with some choices of another field alone."""


def brief(rows: Sequence[Row], parameters: PlantParameters) -> list[tuple[str, str]]:
    """Speeds, forces, frequency, damping, gain and a verdict, each as (name, text)."""
    by_name: dict[str, list[Row]] = {}
    for row in rows:
        by_name.setdefault(row.quantity, []).append(row)

    def first(quantity: str) -> Row:
        return by_name[quantity][0]

    def text(quantity: str, digits: int = 3) -> str:
        return first(quantity).text(digits)

    lowest = first("lowest natural frequency")
    healthy, leaking = leak_text(LEAKS[0]), leak_text(LEAKS[-1])
    damping = {
        leak: next(row for row in by_name["damping ratio, linearised"] if leak in row.at) for leak in (healthy, leaking)
    }
    return [
        (
            "speeds",
            f"{text('no-load speed out')} mm/s out, {text('no-load speed in')} mm/s in; at 2/3 of the largest force "
            f"{text('speed out')} and {text('speed in')} mm/s",
        ),
        (
            "forces",
            f"{text('force limit out')} kN out, {text('force limit in')} kN in; it reaches {text('reach in')} to "
            f"{text('reach out')} mm",
        ),
        ("natural frequency", f"{lowest.text(3)} Hz at the softest place ({lowest.at}), ports shut"),
        (
            "damping ratio",
            f"{damping[healthy].text(2)} with a healthy seal, {damping[leaking].text(2)} with a leak of {leaking}, "
            "without friction",
        ),
        *_gains(by_name, parameters),
        ("verdict", _verdict(by_name, damping[healthy])),
    ]


def _gains(rows: Mapping[str, Sequence[Row]], parameters: PlantParameters) -> list[tuple[str, str]]:
    """Gains in V/mm, and as velocity gain K_v in 1/s from the mean no-load speed; beyond a dead band."""
    full_speed = sum(speed_limits(beyond_dead_band(parameters))) / 2.0

    def both(value: float | str) -> str:
        if isinstance(value, str):
            return value
        return f"{value * FULL_VOLTAGE * MILLIMETRE:.3g} V/mm (K_v = {value * full_speed:.3g} 1/s)"

    healthy, within = rows["largest stable gain"][0], rows["largest stable gain"][-1]
    lines = [
        (
            "largest stable gain",
            f"{both(healthy.value)} with the file's own values, {both(within.value)} on the worst of {DRAWN} plants "
            "drawn from their ranges; healthy seal",
        )
    ]
    if recommended := rows.get("recommended gain"):
        margins = [row.text(2) for row in rows["gain margin"]], [row.text(2) for row in rows["phase margin"]]
        lines.append(
            (
                "recommended gain",
                f"{both(recommended[0].value)}: half of the worst; gain margin {' and '.join(margins[0])} dB, phase "
                f"margin {'° and '.join(margins[1])}° (own values and worst)",
            )
        )
    return lines


def _verdict(rows: Mapping[str, Sequence[Row]], damping: Row) -> str:
    watch = []
    if dead := rows.get("dead band"):
        watch.append(
            f"the valve is overlapped, dead within ±{dead[0].text(3)} V: its amplifier or the controller must add that "
            "(the PID's overlap_compensation; the others invert it), and the gains above suppose it"
        )
    for direction in ("out", "in"):
        lasting = rows.get(f"lasting speed {direction}")
        full = rows[f"no-load speed {direction}"][0].value
        if (
            lasting
            and isinstance(lasting[0].value, float)
            and isinstance(full, float)
            and lasting[0].value < 0.999 * full
        ):
            watch.append(f"the pump alone sustains only {lasting[0].text(3)} mm/s {direction}")
    if isinstance(damping.value, float) and damping.value < WEAK_DAMPING:
        watch.append("the axis rings: use damping (pressure feedback) or a low gain")
    small_enough = rows.get("is the inner step small enough")
    if small_enough and small_enough[0].value != "yes":
        watch.append("the integrator is less accurate than on the paper's rig")
    if isinstance(damping.value, str) and damping.value != "overdamped":
        watch.append(f"at the examined position: {damping.value}")
    return f"it works{'; ' if watch else ''}{'; '.join(watch)}"


def assumed(values: Mapping[str, Any], parameters: PlantParameters) -> list[tuple[str, list[str]]]:
    """Fields that the content of a rig's file lacks and that have an effect, with their default values, by group."""
    missing = [path.split(".") for path in PARAMETER_PATHS]
    missing = [[group, field] for group, field in missing if field not in (values.get(group) or {})]
    own = parameters.model_dump()
    for path, (choice, needed) in USED_WITH.items():
        group, field = choice.split(".")
        if own[group][field] not in needed:
            missing = [parts for parts in missing if ".".join(parts) != path]
    result = []
    for group, fields in groupby(missing, key=lambda path: path[0]):
        entries = [f"{field} = {_shown(getattr(getattr(parameters, group), field))}" for _, field in fields]
        result.append((group, entries))
    return result


def _shown(value: Any) -> str:
    return f"{value:.4g}" if isinstance(value, float) else str(value)


def check_to_console(
    rig: Path | None, folder: Path | None, overwrite: bool, period: str | None = None, latency: str | None = None
) -> list[Path]:
    """Print the table of a rig; write ``check.csv`` and ``check.md`` into a folder if one is given.

    Args:
        rig: its file; ``None`` is the paper's.
        folder: for the files.
        overwrite: replace earlier files.
        period: control period with its unit; default: that of the task.
        latency: of the command, the same.

    Raises:
        ConfigurationError: the rig is wrong or cannot work, the timing is impossible, or the folder cannot be used.
    """
    given = read_rig(rig) if rig is not None else Rig(PlantParameters(), {}, {}, "rig")
    task = timed_task(None, rig, period, latency, "check-rig")
    rows = [*check_rig(given.plant, given.source, task), position_accuracy(given, task)]
    warnings = implausible(given.plant)
    notes = [note for note in (stability_note(rows),) if note]
    title = f"{rig.name if rig is not None else 'the rig of Kovari (2015)'}: {_summary(given)}"
    files = []
    if folder is not None:
        with output_folder(folder, "check-rig", (CSV_FILE, TABLE_FILE), overwrite=overwrite):
            write_text(folder / CSV_FILE, check_csv(rows))
            write_text(folder / TABLE_FILE, check_markdown(rows, title, [*warnings, *notes]))
        files = [folder / CSV_FILE, folder / TABLE_FILE]
    console = PlainConsole()
    for told in (title, *warnings):
        console.print(told, soft_wrap=True)
    facts = ConsoleTable(box=None, show_header=False, padding=(0, 2, 0, 0))
    for name, text in brief(rows, given.plant):
        facts.add_row(name, text)
    console.print(facts)
    for note in notes:
        console.print("", note, sep="\n")
    for line in _assumed(rig, given.plant):
        console.print(line)
    console.print(console_table(_table(rows), left=(0, 1, 3)))
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


def _assumed(rig: Path | None, parameters: PlantParameters) -> list[Padding | str]:
    if rig is None:
        return []
    groups = assumed(read_yaml(rig), parameters)
    if not groups:
        return ["", "The file gives every value."]
    lines: list[Padding | str] = ["", "Not in the file, taken from the paper's rig (SI units):"]
    return [*lines, *(Padding(f"{group}: {', '.join(entries)}", (0, 0, 0, 2)) for group, entries in groups)]


def _table(rows: list[Row]) -> Table:
    """The figures by group, narrow enough for a terminal of 80 columns."""
    first = {row.group: place for place, row in reversed(list(enumerate(rows)))}
    breaks = {place: group for group, place in first.items()}
    return Table("", HEADINGS[1:], [(row.quantity, row.at, row.text(4), row.unit) for row in rows], breaks=breaks)


def check_csv(rows: list[Row]) -> str:
    """All figures with nine digits, one per line."""
    text: str = pd.DataFrame([row._replace(value=row.text(9)) for row in rows]).to_csv(index=False, lineterminator="\n")
    return text


def check_markdown(rows: list[Row], title: str, remarks: Sequence[str] = ()) -> str:
    """The table as Markdown, with remarks below it."""
    cells = [(row.group, row.quantity, row.at, row.text(4), row.unit) for row in rows]
    table = markdown(HEADINGS, cells, left=(0, 1, 2, 4))
    return "\n\n".join([f"# {title}", table, NOTE, *remarks]) + "\n"
