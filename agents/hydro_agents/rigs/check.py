"""The hand calculations of an engineer for a rig."""

import math
from collections.abc import Callable
from contextlib import suppress
from typing import Any, NamedTuple

import numpy as np

from hydro_agents.controllers.sampled_loop import places_in_reach, sampled_loop
from hydro_agents.learning.stable_gain import (
    DRAWN,
    HEALTHY_LEAK,
    SHARE_OF_STABLE,
    Weakest,
    beyond_dead_band,
    leaking,
    loops_over_reach,
    loops_within_ranges,
    quiet_gains,
    weakest,
)
from hydro_env import HydroError, PlantParameters, TaskConfig, equilibrium, linearise
from hydro_env.plant.analysis import (
    chamber_volumes,
    closed_port_natural_frequency,
    closed_port_stiffness,
    force_limits,
    reachable_range,
    softest_position,
    speed_limits,
)
from hydro_env.plant.arrays import plant_coefficients
from hydro_env.plant.workable import refuse_unworkable
from hydro_env.task.randomisation import default_randomisation
from hydro_env.units import FULL_VOLTAGE, LITRE_PER_MINUTE

EXAMINED_LEAKS = (HEALTHY_LEAK, 0.3, 1.0, 4.0)  # l/min at 100 bar: a healthy seal, and three leaking ones

OVERDAMPED, HELD_NOWHERE = "overdamped", "cannot be held"  # instead of a figure

RESONATES = {"tip": "second mass", "line": "lines"}  # by the first word of the state that takes the largest part

BAR, MILLIMETRE, CUBIC_CENTIMETRE, SQUARE_CENTIMETRE = 1e5, 1e-3, 1e-6, 1e-4


class RigFigure(NamedTuple):
    """One figure of the table."""

    group: str
    quantity: str
    at: str  # its condition
    value: Any  # a number, or text if there is none
    unit: str
    key: str = ""  # of a figure that a summary uses

    def __format__(self, digits: str) -> str:
        return self.value if isinstance(self.value, str) else format(self.value, digits)


Rows = list[tuple[Any, ...]]  # the fields of figures after their group


def check_rig(parameters: PlantParameters, source: str = "rig", task: TaskConfig | None = None) -> list[RigFigure]:
    """All figures of a rig, in the units of practice.

    Args:
        parameters: the rig.
        source: its name, for messages.
        task: gives control period, latency and ranges of the rig; default: those of the default task.

    Raises:
        ConfigurationError: the rig cannot work; one line names the impossible figure.

    Example:
        >>> from hydro_agents.rigs.check import check_rig
        >>> from hydro_env import PlantParameters
        >>> row = check_rig(PlantParameters())[0]
        >>> row.group, row.quantity, f"{row:.4g}", row.unit
        ('cylinder', 'area a (bore side)', '12.57', 'cm²')
    """
    refuse_unworkable(parameters, source)
    place = resting_place(parameters)
    task = task or TaskConfig(plant=parameters, randomisation=default_randomisation(parameters))
    loop = _loop(task, place)
    groups = {
        "cylinder": _geometry(parameters),
        "valve": _valve(parameters),
        "speed": _speeds(parameters),
        "force": _forces(parameters),
        "oil column": _oscillation(parameters, place),
        "position loop": loop,
        "resonances": _resonances(task, place, [value for _, _, value, _, *key in loop if key == ["recommended gain"]]),
    }
    return [RigFigure(group, *row) for group, rows in groups.items() for row in rows]


def resting_place(parameters: PlantParameters) -> float:
    """Position in m at which a rig is examined: mid-stroke, or else the middle one of the positions that can be held.

    Raises:
        HydroError: none of the candidate positions can be held.
    """
    low, high = reachable_range(parameters)
    middle = 0.0 if low < 0.0 < high else 0.5 * (low + high)
    held = []
    for place in (middle, *np.linspace(low, high, 41)):
        with suppress(HydroError):
            equilibrium(parameters, place)
            if place == middle:
                return middle
            held.append(place)
    if not held:
        equilibrium(parameters, middle)  # raises the error with the reason
    return held[len(held) // 2]


def _geometry(parameters: PlantParameters) -> Rows:
    c, half = plant_coefficients(parameters), 0.5 * parameters.cylinder.stroke
    rows = [
        ("area a (bore side)", "", c.area_a / SQUARE_CENTIMETRE, "cm²"),
        ("area b (rod side)", "", c.area_b / SQUARE_CENTIMETRE, "cm²"),
        ("area ratio a/b", "", c.area_a / c.area_b, "1"),
    ]
    for position in (-half, 0.0, half):
        for name, volume in zip("ab", chamber_volumes(parameters, position), strict=True):
            rows.append((f"oil in chamber {name}", place_text(position), volume / CUBIC_CENTIMETRE, "cm³"))
    return rows


def _valve(parameters: PlantParameters) -> Rows:
    c, supply, valve = plant_coefficients(parameters), parameters.supply, parameters.valve
    spool_per_volt = c.drive_rate / c.coil_rate * c.spool_gain
    drop = supply.pressure - supply.tank_pressure
    rated = f"{valve.rated_pressure_drop / BAR:g} bar over both edges"
    flow = c.edge_gain * math.sqrt(0.5 * drop)
    rows: Rows = [
        ("gain K of one edge", "fully open", c.edge_gain / LITRE_PER_MINUTE * BAR**0.5, "l/(min √bar)"),
        ("rated flow", rated, valve.rated_flow / LITRE_PER_MINUTE, "l/min"),
        ("spool at 10 V", "full = 1", min(FULL_VOLTAGE * spool_per_volt, 1.0), "1"),
    ]
    if valve.overlap:
        rows.append(("dead band", "to each side", valve.overlap / spool_per_volt, "V", "dead band"))
    rows.append(("no-load flow", f"{drop / BAR:g} bar over both edges", flow / LITRE_PER_MINUTE, "l/min"))
    return rows


def _speeds(parameters: PlantParameters) -> Rows:
    c, supply, external = plant_coefficients(parameters), parameters.supply, parameters.load.external_force
    free, limits = speed_limits(parameters), force_limits(parameters)
    slow_out = speed_limits(parameters, external + limits.extending * 2 / 3).extending
    slow_in = speed_limits(parameters, external - limits.retracting * 2 / 3).retracting
    rows: Rows = []
    lasting: Rows = [("flow of the pump", "", supply.pump_flow / LITRE_PER_MINUTE, "l/min")]
    for way, speed, slow, area in (
        ("out", free.extending, slow_out, c.area_a),
        ("in", free.retracting, slow_in, c.area_b),
    ):
        fed = min(speed, supply.pump_flow / area) / MILLIMETRE
        rows += [
            (f"no-load speed {way}", "fully open", speed / MILLIMETRE, "mm/s", f"speed {way}"),
            (f"speed {way}", "2/3 of force limit", slow / MILLIMETRE, "mm/s", f"loaded {way}"),
        ]
        lasting.append((f"lasting speed {way}", "fed by the pump alone", fed, "mm/s", f"lasting {way}"))
    if supply.model != "constant":
        rows += lasting
    return rows


def _forces(parameters: PlantParameters) -> Rows:
    limits, (low, high) = force_limits(parameters), reachable_range(parameters)
    stiffness = parameters.load.spring_stiffness
    against = f"spring {stiffness / 1e3:g} N/mm" if stiffness else "stroke"
    pressure = f"{parameters.supply.pressure / BAR:g} bar"
    return [
        ("force limit out", pressure, limits.extending / 1e3, "kN", "force out"),
        ("force limit in", pressure, limits.retracting / 1e3, "kN", "force in"),
        ("reach in", against, low / MILLIMETRE, "mm", "reach in"),
        ("reach out", against, high / MILLIMETRE, "mm", "reach out"),
    ]


def _oscillation(parameters: PlantParameters, place: float) -> Rows:
    half, softest = 0.5 * parameters.cylinder.stroke, softest_position(parameters)
    rows: Rows = []
    for position in (-half, -0.5 * half, 0.0, 0.5 * half, half):
        frequency = closed_port_natural_frequency(parameters, position) / (2 * math.pi)
        rows.append(("natural frequency, ports shut", place_text(position), frequency, "Hz"))
    lowest, at = closed_port_natural_frequency(parameters, softest), place_text(softest)
    rows.append(("lowest natural frequency", at, lowest / (2 * math.pi), "Hz", "lowest frequency"))
    for position in dict.fromkeys((0.0, softest)):
        stiffness = closed_port_stiffness(parameters, position) * MILLIMETRE / 1e3
        rows.append(("stiffness, ports shut", place_text(position), stiffness, "kN/mm"))
    for leak in EXAMINED_LEAKS:
        damping, at = _figure(_damping, leaking(parameters, leak), place), f"{place_text(place)}, {leak_text(leak)}"
        rows.append(("damping ratio, linearised", at, damping, "1", f"damping {leak_text(leak)}"))
    return rows


def _loop(task: TaskConfig, place: float) -> Rows:
    largest, friction = "largest stable gain", "simulated with friction"
    places = places_in_reach(task.plant)
    span = f"worst, {places[0] / MILLIMETRE:+.0f} to {places[-1] / MILLIMETRE:+.0f} mm"
    timed = f"{largest} ({1e3 * task.control_period:g} ms, {1e3 * task.command_latency:g} ms late)"
    plants = {
        f"{place_text(place)}, {leak_text(leak)}": beyond_dead_band(leaking(task.plant, leak))
        for leak in EXAMINED_LEAKS
    }
    rows: Rows = []
    healthy = None
    for leak, (here, plant) in zip(EXAMINED_LEAKS, plants.items(), strict=True):
        rows.append((timed, here, _figure(_largest_gain, plant, place, task), "1/m"))
        over_reach, key = weakest(loops_over_reach(task, task.plant, leak)), ""
        if leak == HEALTHY_LEAK:
            healthy, key = over_reach, "gain over the reach"
        rows.append((largest, f"{span}, {leak_text(leak)}", _gain(over_reach), "1/m", key))
    worst, within = weakest(loops_within_ranges(task)), f"worst of {DRAWN} plants in the ranges"
    rows.append((largest, f"{within}, {leak_text(HEALTHY_LEAK)}", _gain(worst), "1/m", "gain in the ranges"))
    try:
        quiet = quiet_gains(task)
    except HydroError as error:
        return [*rows, ("recommended gain", str(error), "none", "1/m", "no gain")]
    recommended = SHARE_OF_STABLE * quiet.worst
    rows.append(("recommended gain", friction, recommended, "1/m", "recommended gain"))
    for which, gain, weak in (("own values", quiet.own, healthy), ("worst in the ranges", quiet.worst, worst)):
        at, margin = f"recommended gain, {which}", 20.0 * math.log10(gain / recommended)
        rows += [
            ("largest quiet gain", f"{which}, {friction}", gain, "1/m", f"quiet, {which}"),
            ("gain margin", f"{at}, {friction}", margin, "dB", f"gain margin, {which}"),
        ]
        if weak:
            phase = _figure(weak.loop.phase_margin, recommended)
            rows.append(("phase margin", f"{at}, without friction", phase, "°", f"phase margin, {which}"))
    for here, plant in plants.items():
        stiffness = _figure(_static_stiffness, plant, place, recommended)
        rows.append(("static stiffness", f"recommended gain, {here}", stiffness, "kN/mm"))
    return rows


def _resonances(task: TaskConfig, place: float, gain: list[Any]) -> Rows:
    """Oscillations of an axis with a second mass or with waves in its lines, alone and with the recommended gain.

    With the gain, each is followed from its eigenvalue exp(λ T) of the sampled loop without feedback. A damping below
    zero grows: the gain excites it, as far as dry friction does not stop it.
    """
    plant = beyond_dead_band(leaking(task.plant, HEALTHY_LEAK))
    rows: Rows = []
    if not (plant.structure.tip or plant.structure.lines):
        return rows
    try:
        modes = linearise(plant.replace(friction={"model": "none"}), position=place).modes
        loop = sampled_loop(plant, place, task.control_period, task.command_latency)
    except HydroError:
        return [("oscillations", place_text(place), HELD_NOWHERE, "Hz")]
    for number, mode in enumerate(modes, 1):
        what = f"oscillation {number}, {RESONATES.get(mode.state.split('_')[0], 'mass on its oil')}"
        frequency = mode.natural_frequency / (2.0 * math.pi)
        rows += [
            (what, place_text(place), frequency, "Hz", f"resonance {number}"),
            ("its damping ratio", what, mode.damping_ratio, "1", f"resonance {number} alone"),
        ]
        for recommended in gain:
            value = complex(np.exp(mode.eigenvalue * task.control_period))
            for part in np.linspace(0.0, recommended, 41):
                values = np.linalg.eigvals(loop.closed(part))
                value = complex(values[np.argmin(np.abs(values - value))])
            damping = -math.log(abs(value)) / (task.control_period * mode.natural_frequency)
            at, key = f"{what}, recommended gain", f"resonance {number} with gain"
            rows.append(("its damping ratio", at, damping, "1", key))
    return rows


def _gain(loop: Weakest | None) -> float | str:
    return _figure(float, loop.gain) if loop else HELD_NOWHERE


def _figure(compute: Callable[..., float], *arguments: Any) -> float | str:
    """A figure, or the reason for its absence."""
    try:
        value = compute(*arguments)
    except ArithmeticError:
        return OVERDAMPED
    except HydroError:
        return HELD_NOWHERE
    return value if math.isfinite(value) else "unlimited"


def _damping(parameters: PlantParameters, place: float) -> float:
    return linearise(parameters.replace(friction={"model": "none"}), position=place).hydraulic_mode.damping_ratio


def _largest_gain(parameters: PlantParameters, place: float, task: TaskConfig) -> float:
    return sampled_loop(parameters, place, task.control_period, task.command_latency).largest_stable_gain()


def _static_stiffness(parameters: PlantParameters, place: float, gain: float) -> float:
    return sampled_loop(parameters, place).static_stiffness(gain) * MILLIMETRE / 1e3


def place_text(position: float) -> str:
    """A position in m as text."""
    return "mid-stroke" if abs(position) < 5e-7 else f"x = {position / MILLIMETRE:+.1f} mm"


def leak_text(leak: float) -> str:
    """A leak as text."""
    return f"{leak:g} l/min"
