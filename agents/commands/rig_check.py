"""``hydro check-rig``: what an engineer works out by hand for a rig, as a table."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import NamedTuple

from rich.console import Console
from rich.table import Table

from agents.controllers.sampled_loop import COMMAND_LATENCY, CONTROL_PERIOD, sampled_loop
from agents.running.folders import prepare_folder
from hydro_env import HydroError, PlantParameters, resistance_from_flow
from hydro_env.files import write_whole
from hydro_env.plant.analysis import (
    chamber_volumes,
    closed_port_natural_frequency,
    closed_port_stiffness,
    force_limits,
    leak_at_test_pressure,
    reachable_range,
    softest_position,
    speed_limits,
)
from hydro_env.plant.arrays import equilibrium, plant_coefficients
from hydro_env.plant.kernel import TOLERANCE
from hydro_env.plant.linearisation import fastest_eigenvalue, linearise
from hydro_env.plant.probe import ENOUGH, PERIOD, probe
from hydro_env.plant.states import State
from hydro_env.plant.workable import InnerStep, inner_step, refuse_unworkable, shortest_inner_step
from hydro_env.units import LITRE_PER_MINUTE

CSV_FILE = "check.csv"
TABLE_FILE = "check.md"
LEAKS = (0.01, 0.3, 1.0, 4.0)
"""l/min at 100 bar: a healthy seal, and three leaking ones."""

BAR, MILLIMETRE, CUBIC_CENTIMETRE, SQUARE_CENTIMETRE = 1e5, 1e-3, 1e-6, 1e-4
REACH_SHARE = 0.9
"""Part of the reachable range over which the position loop is judged."""


UNLIMITED = "unlimited"
"""Instead of an infinite figure."""


class Row(NamedTuple):
    """One figure of the table."""

    group: str
    quantity: str
    at: str  # the condition under which it holds
    value: float | str
    unit: str

    @property
    def shown(self) -> str:
        """The value with four digits."""
        return self.value if isinstance(self.value, str) else f"{self.value:.4g}"


def check_rig(parameters: PlantParameters, source: str = "rig") -> list[Row]:
    """All figures of a rig, in the units of practice.

    Raises:
        ConfigurationError: the rig cannot work; one line says which figure is impossible.
    """
    refuse_unworkable(parameters, source)
    return [
        *_geometry(parameters),
        *_flows_and_speeds(parameters),
        *_forces(parameters),
        *_oscillation(parameters),
        *_loop(parameters),
        *_integration(parameters),
    ]


def _geometry(parameters: PlantParameters) -> list[Row]:
    c = plant_coefficients(parameters)
    rows = [
        Row("cylinder", "area a (bore side)", "", c.area_a / SQUARE_CENTIMETRE, "cm²"),
        Row("cylinder", "area b (rod side)", "", c.area_b / SQUARE_CENTIMETRE, "cm²"),
        Row("cylinder", "area ratio a/b", "", c.area_a / c.area_b, "1"),
    ]
    half = 0.5 * parameters.cylinder.stroke
    for position in (-half, 0.0, half):
        volumes = chamber_volumes(parameters, position)
        for name, volume in zip("ab", volumes, strict=True):
            rows.append(
                Row("cylinder", f"oil in chamber {name}", _position(position), volume / CUBIC_CENTIMETRE, "cm³")
            )
    return rows


def _flows_and_speeds(parameters: PlantParameters) -> list[Row]:
    c = plant_coefficients(parameters)
    supply, valve = parameters.supply, parameters.valve
    edge = c.edge_gain / LITRE_PER_MINUTE * math.sqrt(BAR)
    free = speed_limits(parameters)
    limits = force_limits(parameters)
    flow = c.edge_gain * math.sqrt(0.5 * (supply.pressure - supply.tank_pressure))
    loaded = (
        speed_limits(parameters, parameters.load.external_force + limits.extending * 2 / 3).extending,
        speed_limits(parameters, parameters.load.external_force - limits.retracting * 2 / 3).retracting,
    )
    rows = [
        Row("valve", "gain K of one edge", "fully open", edge, "l/(min √bar)"),
        Row(
            "valve",
            "rated flow",
            f"{valve.rated_pressure_drop / BAR:g} bar over both edges",
            valve.rated_flow / LITRE_PER_MINUTE,
            "l/min",
        ),
        Row("valve", "spool at 10 V", "full = 1", min(10.0 * c.drive_rate / c.coil_rate * c.spool_gain, 1.0), "1"),
        Row(
            "valve",
            "no-load flow",
            f"{(supply.pressure - supply.tank_pressure) / BAR:g} bar over both edges",
            flow / LITRE_PER_MINUTE,
            "l/min",
        ),
    ]
    for direction, speed, slow, area in (
        ("out", free.extending, loaded[0], c.area_a),
        ("in", free.retracting, loaded[1], c.area_b),
    ):
        rows += [
            Row("speed", f"no-load speed {direction}", "fully open", speed / MILLIMETRE, "mm/s"),
            Row("speed", f"speed {direction}", "2/3 of force limit", slow / MILLIMETRE, "mm/s"),
            Row(
                "speed", f"flow from the supply {direction}", "no-load speed", speed * area / LITRE_PER_MINUTE, "l/min"
            ),
        ]
    if supply.model != "constant":
        rows.append(Row("speed", "flow of the pump", "", supply.pump_flow / LITRE_PER_MINUTE, "l/min"))
        for direction, speed, area in (("out", free.extending, c.area_a), ("in", free.retracting, c.area_b)):
            fed = min(speed, supply.pump_flow / area) / MILLIMETRE
            rows.append(Row("speed", f"lasting speed {direction}", "fed by the pump alone", fed, "mm/s"))
    return rows


def _forces(parameters: PlantParameters) -> list[Row]:
    limits = force_limits(parameters)
    low, high = reachable_range(parameters)
    against = (
        f"spring {parameters.load.spring_stiffness / 1e3:g} N/mm" if parameters.load.spring_stiffness else "stroke"
    )
    pressure = f"{parameters.supply.pressure / BAR:g} bar"
    return [
        Row("force", "force limit out", pressure, limits.extending / 1e3, "kN"),
        Row("force", "force limit in", pressure, limits.retracting / 1e3, "kN"),
        Row("force", "reach in", against, low / MILLIMETRE, "mm"),
        Row("force", "reach out", against, high / MILLIMETRE, "mm"),
    ]


def _oscillation(parameters: PlantParameters) -> list[Row]:
    half = 0.5 * parameters.cylinder.stroke
    rows = []
    for position in (-half, -0.5 * half, 0.0, 0.5 * half, half):
        frequency = closed_port_natural_frequency(parameters, position) / (2 * math.pi)
        rows.append(Row("oil column", "natural frequency, ports shut", _position(position), frequency, "Hz"))
    softest = softest_position(parameters)
    lowest = closed_port_natural_frequency(parameters, softest)
    rows += [
        Row("oil column", "lowest natural frequency", _position(softest), lowest / (2 * math.pi), "Hz"),
        Row("oil column", "the same", _position(softest), lowest, "rad/s"),
    ]
    for position in dict.fromkeys((0.0, softest)):
        stiffness = closed_port_stiffness(parameters, position) * MILLIMETRE / 1e3
        rows.append(Row("oil column", "stiffness, ports shut", _position(position), stiffness, "kN/mm"))
    place = _place(parameters)
    for leak in LEAKS:
        rows.append(
            Row(
                "oil column",
                "damping ratio, linearised",
                f"{_position(place)}, {_leak(leak)}",
                _tried(_damping, _leaking(parameters, leak), place),
                "1",
            )
        )
    return rows


def _loop(parameters: PlantParameters) -> list[Row]:
    low, high = (REACH_SHARE * end for end in reachable_range(parameters))
    place = _place(parameters)
    timing = f"({1e3 * CONTROL_PERIOD:g} ms, {1e3 * COMMAND_LATENCY:g} ms late)"
    rows = []
    for leak in LEAKS:
        rule = _tried(_rule_of_thumb, _leaking(parameters, leak), place)
        rows.append(
            Row("position loop", "gain 2 ζ ω / speed (no sampling)", f"{_position(place)}, {_leak(leak)}", rule, "1/m")
        )
    for leak in LEAKS:
        plant = _leaking(parameters, leak)
        gain = _tried(_largest_gain, plant, place)
        rows.append(
            Row("position loop", f"largest stable gain {timing}", f"{_position(place)}, {_leak(leak)}", gain, "1/m")
        )
        worst = _worst_gain(plant, low, high)
        rows.append(Row("position loop", "largest stable gain", f"{_span(low, high)}, {_leak(leak)}", worst, "1/m"))
        if isinstance(worst, float) and 0.0 < worst < math.inf:
            stiffness = _tried(partial(_static_stiffness, 0.5 * worst), plant, place)
            at = f"half of it, {_position(place)}, {_leak(leak)}"
            rows.append(Row("position loop", "static stiffness", at, stiffness, "kN/mm"))
    return rows


def _integration(parameters: PlantParameters) -> list[Row]:
    place = _place(parameters)
    shortest, here = shortest_inner_step(parameters), inner_step(parameters, place)
    rows = [
        Row("integration", "fastest rate |λ|, at rest", _position(place), _tried(_fastest, parameters, place), "1/s"),
        Row("integration", "fastest rate |λ|, bound", f"{_position(place)} ({_cause(here)})", here.rate, "1/s"),
        Row("integration", "fastest rate |λ|, bound", f"whole stroke ({_cause(shortest)})", shortest.rate, "1/s"),
        Row("integration", "longest stable step", _position(place), 1e3 * here.stable, "ms"),
        Row("integration", "longest stable step", "whole stroke", 1e3 * shortest.stable, "ms"),
    ]
    run = f"±10 V in turn from {_position(place)}"
    try:
        done = probe(parameters, place)
    except HydroError as error:
        return [*rows, Row("integration", "inner steps", run, str(error), "")]
    enough = "yes" if done.error <= ENOUGH else "no"
    period = f"{1e3 * PERIOD:g} ms"
    worst = done.state.replace("_", " ")
    return [
        *rows,
        Row("integration", f"inner steps in {period}, mean", run, done.mean_steps, "1"),
        Row("integration", f"inner steps in {period}, most", run, float(done.most_steps), "1"),
        Row("integration", "mean inner step", run, 1e3 * PERIOD / done.mean_steps, "ms"),
        Row("integration", f"estimated error ({worst})", f"tolerance {TOLERANCE:g}", done.error, "of its range"),
        Row("integration", "is the inner step small enough", f"error ≤ {ENOUGH:g}", enough, ""),
    ]


def _cause(found: InnerStep) -> str:
    return found.cause.replace("_", " ")


def _place(parameters: PlantParameters) -> float:
    """Mid-stroke, or the middle of what can be held where that is out of reach."""
    low, high = reachable_range(parameters)
    return 0.0 if low < 0.0 < high else 0.5 * (low + high)


def _leaking(parameters: PlantParameters, leak: float) -> PlantParameters:
    return parameters.replace(leakage={"internal_resistance": resistance_from_flow(leak), "orifice_gain": 0.0})


def _tried(figure: Callable[[PlantParameters, float], float], parameters: PlantParameters, place: float) -> float | str:
    """A figure, or why there is none."""
    try:
        value = figure(parameters, place)
        return value if math.isfinite(value) else UNLIMITED
    except ArithmeticError:
        return "overdamped"
    except HydroError:
        return "cannot be held"


def _damping(parameters: PlantParameters, place: float) -> float:
    return linearise(parameters.replace(friction={"model": "none"}), position=place).hydraulic_mode.damping_ratio


def _rule_of_thumb(parameters: PlantParameters, place: float) -> float:
    """2 ζ ω over the mean no-load speed: continuous loop, ideal valve, symmetric cylinder (Merritt 1967)."""
    mode = linearise(parameters.replace(friction={"model": "none"}), position=place).hydraulic_mode
    return 4.0 * mode.damping_ratio * mode.natural_frequency / sum(speed_limits(parameters))


def _largest_gain(parameters: PlantParameters, place: float) -> float:
    return sampled_loop(parameters, place).largest_stable_gain()


def _static_stiffness(gain: float, parameters: PlantParameters, place: float) -> float:
    return sampled_loop(parameters, place).static_stiffness(gain) * MILLIMETRE / 1e3


def _worst_gain(parameters: PlantParameters, low: float, high: float) -> float | str:
    places = [low + part * (high - low) / 8 for part in range(9)]
    found = [_tried(_largest_gain, parameters, place) for place in places]
    gains = [gain for gain in found if isinstance(gain, float)]
    if gains:
        return min(gains)
    return UNLIMITED if UNLIMITED in found else "cannot be held"


def _fastest(parameters: PlantParameters, place: float) -> float:
    state, voltage = equilibrium(parameters, place)
    return fastest_eigenvalue(parameters, State(**state), voltage)


def _position(position: float) -> str:
    return "mid-stroke" if abs(position) < 5e-7 else f"x = {position / MILLIMETRE:+.1f} mm"


def _span(low: float, high: float) -> str:
    return f"worst, {low / MILLIMETRE:+.0f} to {high / MILLIMETRE:+.0f} mm"


def _leak(leak: float) -> str:
    return f"{leak:g} l/min"


def check_to_console(
    rig: Path | None, folder: Path | None, overwrite: bool, console: Console | None = None
) -> list[Path]:
    """Print the table of a rig; with a folder write ``check.csv`` and ``check.md`` too. See ``hydro check-rig --help``.

    Raises:
        ConfigurationError: the rig is wrong or cannot work, or the folder cannot be used.
    """
    parameters = PlantParameters.from_yaml(rig) if rig is not None else PlantParameters()
    rows = check_rig(parameters, str(rig) if rig is not None else "rig")
    title = f"{rig.name if rig is not None else 'the rig of Kovari (2015)'}: {_summary(parameters)}"
    (console or Console()).print(_table(rows, title))
    if folder is None:
        return []
    prepare_folder(folder, False, overwrite, CSV_FILE)
    files = [folder / CSV_FILE, folder / TABLE_FILE]
    write_whole(files[0], check_csv(rows).encode())
    write_whole(files[1], check_markdown(rows, title).encode())
    return files


def _summary(parameters: PlantParameters) -> str:
    cylinder = parameters.cylinder
    rods = f"{1e3 * cylinder.rod_diameter:.4g}"
    rods += f" and {1e3 * cylinder.rod_diameter_a:.4g}" if cylinder.rod_diameter_a else ""
    leak = leak_at_test_pressure(parameters)
    return (
        f"{1e3 * cylinder.bore_diameter:.4g}/{rods} x {1e3 * cylinder.stroke:.4g} mm, "
        f"{parameters.load.mass + cylinder.piston_mass:.4g} kg, {parameters.supply.pressure / BAR:.4g} bar, "
        f"own leak {leak:.3g} l/min at 100 bar"
    )


def _table(rows: list[Row], title: str) -> Table:
    table = Table(title=title, title_justify="left", header_style="bold")
    for heading in ("", "quantity", "at"):
        table.add_column(heading)
    table.add_column("value", justify="right")
    table.add_column("unit")
    last = ""
    for row in rows:
        if last and row.group != last:
            table.add_section()
        table.add_row(row.group if row.group != last else "", row.quantity, row.at, row.shown, row.unit)
        last = row.group
    return table


def check_csv(rows: list[Row]) -> str:
    """All figures with nine digits, one per line."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(Row._fields)
    for row in rows:
        value = row.value if isinstance(row.value, str) else f"{row.value:.9g}"
        writer.writerow([row.group, row.quantity, row.at, value, row.unit])
    return text.getvalue()


def check_markdown(rows: list[Row], title: str) -> str:
    """The table as Markdown."""
    lines = [f"# {title}", "", "| | quantity | at | value | unit |", "|---|---|---|---:|---|"]
    lines += [
        f"| {row.group} | {row.quantity.replace('|', chr(92) + '|')} | {row.at} | {row.shown} | {row.unit} |"
        for row in rows
    ]
    lines += [
        "",
        "Leaks are in l/min at 100 bar across the piston. Gains are valve command (1 = 10 V) per metre of error, in a "
        "loop with a proportional controller, linearised at rest without dry friction, exactly sampled.",
    ]
    return "\n".join(lines) + "\n"
