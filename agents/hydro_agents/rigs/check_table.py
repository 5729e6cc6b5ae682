"""``hydro check-rig``: the figures of a rig on the console."""

import math
from collections.abc import Mapping, Sequence
from itertools import groupby
from operator import attrgetter
from pathlib import Path
from typing import Any

from rich.padding import Padding
from rich.table import Table as ConsoleTable

from hydro_agents.learning.stable_gain import DRAWN, beyond_dead_band
from hydro_agents.rigs.check import BAR, EXAMINED_LEAKS, HELD_NOWHERE, MILLIMETRE, RigFigure, check_rig, leak_text
from hydro_agents.running.console import PlainConsole, console_table
from hydro_agents.running.tasks import timed_task
from hydro_agents.running.text import Table
from hydro_env import PlantParameters, TaskConfig
from hydro_env.files import read_yaml
from hydro_env.plant.analysis import closed_port_natural_frequency, leak_at_test_pressure, speed_limits
from hydro_env.plant.arrays import plant_coefficients
from hydro_env.plant.parameters import PARAMETER_PATHS, PARAMETER_UNITS
from hydro_env.task.rig import Rig, read_rig
from hydro_env.task.sensors import SENSORS
from hydro_env.units import FULL_VOLTAGE

HEADINGS = ("quantity", "at", "value", "unit")
PRESSURES = ("pressure_a", "pressure_b")
WEAK_DAMPING = 0.05  # damping ratio below which an axis rings: after five periods a step still oscillates by a fifth


def brief(rows: Sequence[RigFigure], parameters: PlantParameters) -> list[tuple[str, str]]:
    """Speeds, forces, frequency, damping, gain and a verdict, each as (name, text)."""
    figures = {row.key: row for row in rows if row.key}
    healthy, leaking = (figures[f"damping {leak_text(leak)}"] for leak in (EXAMINED_LEAKS[0], EXAMINED_LEAKS[-1]))
    full_speed = sum(speed_limits(beyond_dead_band(parameters))) / 2.0

    def gain(key: str) -> str:
        """A gain in V/mm, and as velocity gain K_v in 1/s from the mean no-load speed; beyond a dead band."""
        value = figures[key].value
        if isinstance(value, str):
            return value
        return f"{value * FULL_VOLTAGE * MILLIMETRE:.3g} V/mm (K_v = {value * full_speed:.3g} 1/s)"

    facts = {
        "speeds": f"{figures['speed out']:.3g} mm/s out, {figures['speed in']:.3g} mm/s in; at 2/3 of the largest "
        f"force {figures['loaded out']:.3g} and {figures['loaded in']:.3g} mm/s",
        "forces": f"{figures['force out']:.3g} kN out, {figures['force in']:.3g} kN in; it reaches "
        f"{figures['reach in']:.3g} to {figures['reach out']:.3g} mm",
        "natural frequency": f"{figures['lowest frequency']:.3g} Hz at the softest place "
        f"({figures['lowest frequency'].at}), ports shut",
        "damping ratio": f"{healthy:.2g} with a healthy seal, {leaking:.2g} with a leak of "
        f"{leak_text(EXAMINED_LEAKS[-1])}, without friction",
        "largest stable gain": f"{gain('gain over the reach')} with the file's own values, "
        f"{gain('gain in the ranges')} on the worst of {DRAWN} plants drawn from their ranges; healthy seal",
    }
    if "recommended gain" in figures:
        more = " and ".join(f"{row:.2g}" for key, row in figures.items() if key.startswith("gain margin"))
        phase = "° and ".join(f"{row:.2g}" for key, row in figures.items() if key.startswith("phase margin"))
        facts["recommended gain"] = (
            f"{gain('recommended gain')}: a simulation with friction comes to rest with {more} dB more; phase margin "
            f"without friction {phase}° (own values and worst)"
        )
    resonances = _resonances(figures)
    if resonances:
        facts["resonances"] = ", ".join(
            f"{frequency:.3g} Hz ({what}, damping {alone:.2g})" for frequency, what, alone, _ in resonances
        )
    verdict, watch = "it works", _watched(figures, healthy.value)
    if "no gain" in figures:
        verdict = f"no recommended gain: {figures['no gain'].at}"
    watch += [
        f"the recommended gain excites the resonance at {frequency:.3g} Hz ({what}): take less"
        for frequency, what, _, with_gain in resonances
        if with_gain < 0.0
    ]
    return [*facts.items(), ("verdict", "; ".join([verdict, *watch]))]


def _resonances(figures: Mapping[str, RigFigure]) -> list[tuple[float, str, float, float]]:
    """Frequency in Hz, what swings, damping alone and with the recommended gain, of each resonance of a structure."""
    found, number = [], 1
    while f"resonance {number}" in figures:
        row, alone = figures[f"resonance {number}"], figures[f"resonance {number} alone"]
        with_gain = figures.get(f"resonance {number} with gain", alone)
        found.append((row.value, row.quantity.split(", ")[1], alone.value, with_gain.value))
        number += 1
    return found


def _watched(figures: Mapping[str, RigFigure], damping: float | str) -> list[str]:
    watch = []
    if "dead band" in figures:
        watch.append(
            f"the valve is overlapped, dead within ±{figures['dead band']:.3g} V: its amplifier or the controller "
            "must add that (the PID's overlap_compensation; the others invert it), and the gains above suppose it"
        )
    for way in ("out", "in"):
        full = figures[f"speed {way}"]
        lasting = figures.get(f"lasting {way}", full)
        if lasting.value < 0.999 * full.value:
            watch.append(f"the pump alone sustains only {lasting:.3g} mm/s {way}")
    if isinstance(damping, float) and damping < WEAK_DAMPING:
        watch.append("the axis rings: use damping (pressure feedback) or a low gain")
    if "phase margin, own values" in figures and figures["phase margin, own values"].value == 0.0:
        watch.append("with the recommended gain its friction alone keeps it quiet: if it swings, take half")
    if damping == HELD_NOWHERE:
        watch.append(f"at the examined position: {damping}")
    return watch


def assumed(values: Mapping[str, Any], parameters: PlantParameters) -> list[str]:
    """Fields that the content of a rig's file lacks, with their default values, a line per group."""
    unset: dict[str, list[str]] = {}
    for path in PARAMETER_PATHS:
        group, field = path.split(".")
        if field not in (values.get(group) or {}):
            value = attrgetter(path)(parameters)
            text = f"{value:.4g}" if isinstance(value, float) else value
            unset.setdefault(group, []).append(f"{field} = {text}")
    return [f"{group}: {', '.join(entries)}" for group, entries in unset.items()]


def check_to_console(rig: Path | None, period: str | None, latency: str | None) -> tuple[Any, ...]:
    """Print the table of a rig; returns what its page shows: name, facts, warnings, figures and task.

    Args:
        rig: its file; ``None`` is the paper's.
        period: control period with its unit; default: that of the task.
        latency: of the command, the same.

    Raises:
        ConfigurationError: the rig is wrong or cannot work, or the timing is impossible.
    """
    given, name = Rig(PlantParameters(), {}, {}, "rig"), "the rig of Kovari (2015)"
    if rig:
        given, name = read_rig(rig), rig.name
    task = timed_task(None, rig, period, latency, "check-rig")
    rows = [*check_rig(given.plant, given.source, task), *sensor_rows(given, task)]
    facts = ConsoleTable(box=None, show_header=False, padding=(0, 2, 0, 0))
    said, summary = brief(rows, given.plant), _summary(given)
    warnings = [*implausible(given.plant), *_short_sensors(task)]
    for fact in said:
        facts.add_row(*fact)
    console = PlainConsole()
    for line in (f"{name}: {summary}", *warnings):
        console.print(line, soft_wrap=True)
    console.print(facts)
    unset = assumed(read_yaml(rig), given.plant) if rig else []
    if unset:
        said.insert(-1, ("not in the file", f"of the paper's rig, in SI: {'; '.join(unset)}"))  # of the page
        console.print("Not in the file, taken from the paper's rig (SI units):")
        for line in unset:
            console.print(Padding(line, (0, 0, 0, 2)))
    cells = []
    for group, own in groupby(rows, attrgetter("group")):
        cells.append((group.upper(), "", "", ""))
        cells += [(row.quantity, row.at, f"{row:.4g}", row.unit) for row in own]
    console.print(console_table(Table("", HEADINGS, cells), left=(0, 1, 3)))  # fits a terminal of 80 columns
    return name, [("rig", summary), *said], warnings, rows, task


def _short_sensors(task: TaskConfig) -> list[str]:
    warnings, supply = [], task.plant.supply.pressure / BAR
    for name in PRESSURES:
        sensor = getattr(task.sensors, name)
        if sensor.fitted and sensor.high < task.plant.supply.pressure:
            reads = f"warning: sensors.{name} reads to {sensor.high / BAR:.4g} bar"
            warnings.append(f"{reads}, the supply has {supply:.4g} bar")
    return warnings


def _summary(rig: Rig) -> str:
    parameters, cylinder = rig.plant, rig.plant.cylinder
    rods = f"{1e3 * cylinder.rod_diameter:.4g}"
    if cylinder.rod_diameter_a:
        rods += f" and {1e3 * cylinder.rod_diameter_a:.4g}"
    facts = [
        f"{1e3 * cylinder.bore_diameter:.4g}/{rods} x {1e3 * cylinder.stroke:.4g} mm",
        f"{parameters.load.mass + cylinder.piston_mass:.4g} kg",
        f"{parameters.supply.pressure / BAR:.4g} bar",
        f"own leak {leak_at_test_pressure(parameters):.3g} l/min at 100 bar",
    ]
    facts += [f"no sensor for {name}" for name in SENSORS if rig.sensors.get(f"sensors.{name}.fitted") is False]
    return ", ".join(facts)


def sensor_rows(rig: Rig, task: TaskConfig) -> list[RigFigure]:
    """Largest constant error of the position, which no controller sees; range, noise and error of the pressures.

    Each says whether it is an assumption.
    """

    def origin(path: str) -> str:
        return "from the file" if f"sensors.{path}" in rig.sensors else "assumed"

    bias = task.sensors.position.bias
    at = f"{origin('position.bias')}: {100.0 * bias / rig.plant.cylinder.stroke:.2g} % of stroke"
    rows = [RigFigure("sensors", "largest constant error, position", at, bias / MILLIMETRE, "mm")]
    for name in PRESSURES:
        sensor = getattr(task.sensors, name)
        if sensor.fitted:
            for field, what in (("high", "range"), ("noise", "noise"), ("bias", "constant error")):
                value = getattr(sensor, field) / BAR
                rows.append(RigFigure("sensors", f"{what}, {name}", origin(f"{name}.{field}"), value, "bar"))
    return rows


def implausible(p: PlantParameters) -> list[str]:
    """A warning for each value that hardly any rig has: the field, its value, what follows, and the likely unit."""
    dead, hertz = p.cylinder.dead_volume / (plant_coefficients(p).area_a * p.cylinder.stroke), 0.5 / math.pi
    bandwidth, frequency = hertz * p.valve.natural_frequency, hertz * closed_port_natural_frequency(p)
    figures = (  # of every rig, the range in which each lies, and its unit
        ("valve.rated_flow", "a full speed of", max(speed_limits(p)), 5e-3, 10.0, "m/s", "l/min"),
        ("supply.pressure", "a supply of", p.supply.pressure / BAR, 15.0, 700.0, "bar", "psi, bar or MPa"),
        ("valve.natural_frequency", "a valve of", bandwidth, 15.0, 1000.0, "Hz", "Hz"),
        ("fluid.bulk_modulus", "a modulus of", p.fluid.bulk_modulus / 1e9, 0.2, 5.0, "GPa", "GPa"),
        ("fluid.air_fraction", "an air content of", 100.0 * p.fluid.air_fraction, 0.0, 15.0, "%", "%"),
        ("cylinder.dead_volume", "a dead volume over swept volume of", dead, 1e-3, 20.0, "1", "cm³"),
        ("load.mass", "a natural frequency of", frequency, 1.0, 3000.0, "Hz", "kg or t"),
    )
    warnings = []
    for path, name, value, low, high, unit, meant in figures:
        if not low <= value <= high:
            own = f"{path} = {attrgetter(path)(p):.4g} {PARAMETER_UNITS[path]}"
            warnings.append(f"warning: {own} gives {name} {value:.3g} {unit}: {meant} meant?")
    return warnings
