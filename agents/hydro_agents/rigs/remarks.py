"""What ``hydro check-rig`` says beside its figures: implausible values, assumptions, and why two gains differ."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import NamedTuple

from hydro_agents.rigs.check import BAR, MILLIMETRE, Row
from hydro_env import PlantParameters, TaskConfig
from hydro_env.plant.analysis import closed_port_natural_frequency, speed_limits
from hydro_env.plant.arrays import plant_coefficients
from hydro_env.plant.parameters import PARAMETER_UNITS
from hydro_env.task.rig import Rig

PHASE_STABLE = (
    "above 2 ζ ω / speed the loop gain at the resonance exceeds 1, and the loop is stable only because valve, sampling "
    "and latency shift the phase there; this holds around one natural frequency, depends on period and latency, and "
    "fails when the frequency varies."
)
FAR_APART = 2.0  # ratio of the two gains above which the table explains it


class Plausible(NamedTuple):
    """A figure of every rig, the range in which it lies, and the field that is wrong elsewhere."""

    path: str  # of the field
    name: str
    compute: Callable[[PlantParameters], float]
    low: float
    high: float
    unit: str  # of the figure
    meant: str  # the unit that was probably meant


PLAUSIBLE = (
    Plausible("valve.rated_flow", "a full speed of", lambda p: max(speed_limits(p)), 5e-3, 10.0, "m/s", "l/min"),
    Plausible(
        "supply.pressure", "a supply of", lambda p: p.supply.pressure / BAR, 15.0, 700.0, "bar", "psi, bar or MPa"
    ),
    Plausible(
        "valve.natural_frequency",
        "a valve of",
        lambda p: p.valve.natural_frequency / (2.0 * math.pi),
        15.0,
        1000.0,
        "Hz",
        "Hz",
    ),
    Plausible("fluid.bulk_modulus", "a modulus of", lambda p: p.fluid.bulk_modulus / 1e9, 0.2, 5.0, "GPa", "GPa"),
    Plausible("fluid.air_fraction", "an air content of", lambda p: 100.0 * p.fluid.air_fraction, 0.0, 15.0, "%", "%"),
    Plausible(
        "cylinder.dead_volume",
        "a dead volume over swept volume of",
        lambda p: p.cylinder.dead_volume / (plant_coefficients(p).area_a * p.cylinder.stroke),
        1e-3,
        20.0,
        "1",
        "cm³",
    ),
    Plausible(
        "load.mass",
        "a natural frequency of",
        lambda p: closed_port_natural_frequency(p) / (2.0 * math.pi),
        1.0,
        3000.0,
        "Hz",
        "kg or t",
    ),
)


def stability_note(rows: Sequence[Row]) -> str:
    """Why the textbook's gain and the largest stable one differ; empty if they hardly do."""
    figures = {row.key: row for row in rows}
    textbook, largest = figures["rule of thumb"], figures["gain here"]
    if isinstance(textbook.value, str) or isinstance(largest.value, str):
        return ""
    ratio = largest.value / textbook.value if textbook.value > 0.0 else 0.0
    return (
        f"The largest stable gain is {ratio:.2g} times 2 ζ ω / speed = {textbook.text(3)} 1/m: {PHASE_STABLE}"
        if ratio >= FAR_APART
        else ""
    )


def position_accuracy(rig: Rig, task: TaskConfig) -> Row:
    """The constant error of the position sensor, which no controller sees, and whether it is an assumption."""
    bias = task.sensors.position.bias
    origin = "from the file" if "sensors.position.bias" in rig.sensors else "assumed"
    share = f"{100.0 * bias / rig.plant.cylinder.stroke:.2g} % of stroke"
    return Row("sensors", "largest constant error, position", f"{origin}: {share}", bias / MILLIMETRE, "mm")


def implausible(parameters: PlantParameters) -> list[str]:
    """A warning for each value that hardly any rig has: the field, its value, what follows, and the likely unit."""
    warnings = []
    for figure in PLAUSIBLE:
        value = figure.compute(parameters)
        if not figure.low <= value <= figure.high:
            group, field = figure.path.split(".")
            own, unit = getattr(getattr(parameters, group), field), PARAMETER_UNITS[figure.path]
            warnings.append(
                f"warning: {figure.path} = {own:.4g} {unit} gives {figure.name} {value:.3g} {figure.unit}: "
                f"{figure.meant} meant?"
            )
    return warnings
