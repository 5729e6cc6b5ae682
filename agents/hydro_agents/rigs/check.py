"""The hand calculations of an engineer for a rig."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import partial
from typing import NamedTuple

import numpy as np

from hydro_agents.controllers.sampled_loop import places_in_reach, sampled_loop
from hydro_agents.rigs.stable_gain import (
    DRAWN,
    HEALTHY_LEAK,
    Weakest,
    beyond_dead_band,
    leaking,
    loops_within_ranges,
    nominal_loops,
    weakest,
)
from hydro_env import HydroError, PlantParameters, TaskConfig
from hydro_env.plant.analysis import (
    chamber_volumes,
    closed_port_natural_frequency,
    closed_port_stiffness,
    force_limits,
    reachable_range,
    softest_position,
    speed_limits,
)
from hydro_env.plant.arrays import equilibrium, plant_coefficients
from hydro_env.plant.kernel import TOLERANCE
from hydro_env.plant.linearisation import fastest_eigenvalue, linearise
from hydro_env.plant.probe import ALLOWED_ERROR, PERIOD, probe
from hydro_env.plant.states import State
from hydro_env.plant.workable import inner_step, refuse_unworkable, shortest_inner_step
from hydro_env.task.randomisation import default_randomisation
from hydro_env.units import FULL_VOLTAGE, LITRE_PER_MINUTE

LEAKS = (HEALTHY_LEAK, 0.3, 1.0, 4.0)  # l/min at 100 bar: a healthy seal, and three leaking ones

BAR, MILLIMETRE, CUBIC_CENTIMETRE, SQUARE_CENTIMETRE = 1e5, 1e-3, 1e-6, 1e-4


class Row(NamedTuple):
    """One figure of the table."""

    group: str
    quantity: str
    at: str  # its condition
    value: float | str  # text if there is no number
    unit: str

    def text(self, digits: int) -> str:
        """The value with a number of significant digits."""
        return self.value if isinstance(self.value, str) else f"{self.value:.{digits}g}"


def check_rig(parameters: PlantParameters, source: str = "rig", task: TaskConfig | None = None) -> list[Row]:
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
        >>> row.group, row.quantity, row.text(4), row.unit
        ('cylinder', 'area a (bore side)', '12.57', 'cm²')
    """
    refuse_unworkable(parameters, source)
    place = resting_place(parameters)
    return [
        *_geometry(parameters),
        *_flows_and_speeds(parameters),
        *_forces(parameters),
        *_oscillation(parameters, place),
        *_loop(task or TaskConfig(plant=parameters, randomisation=default_randomisation(parameters)), place),
        *_integration(parameters, place),
    ]


def resting_place(parameters: PlantParameters) -> float:
    """Position in m at which a rig is examined: mid-stroke, or else the middle one of the positions that can be held.

    Raises:
        HydroError: none of the candidate positions can be held.
    """
    low, high = reachable_range(parameters)
    middle = 0.0 if low < 0.0 < high else 0.5 * (low + high)
    if _can_be_held(parameters, middle):
        return middle
    held = [place for place in np.linspace(low, high, 41).tolist() if _can_be_held(parameters, place)]
    if not held:
        equilibrium(parameters, middle)  # raises the error with the reason
    return float(held[len(held) // 2])


def _can_be_held(parameters: PlantParameters, position: float) -> bool:
    try:
        equilibrium(parameters, position)
    except HydroError:
        return False
    return True


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
    spool_per_volt = c.drive_rate / c.coil_rate * c.spool_gain
    free = speed_limits(parameters)
    limits = force_limits(parameters)
    flow = c.edge_gain * math.sqrt(0.5 * (supply.pressure - supply.tank_pressure))
    loaded = (
        speed_limits(parameters, parameters.load.external_force + limits.extending * 2 / 3).extending,
        speed_limits(parameters, parameters.load.external_force - limits.retracting * 2 / 3).retracting,
    )
    drop = (supply.pressure - supply.tank_pressure) / BAR
    rated = f"{valve.rated_pressure_drop / BAR:g} bar over both edges"
    rows = [
        Row("valve", "gain K of one edge", "fully open", edge, "l/(min √bar)"),
        Row("valve", "rated flow", rated, valve.rated_flow / LITRE_PER_MINUTE, "l/min"),
        Row("valve", "spool at 10 V", "full = 1", min(FULL_VOLTAGE * spool_per_volt, 1.0), "1"),
        *([Row("valve", "dead band", "to each side", valve.overlap / spool_per_volt, "V")] if valve.overlap else []),
        Row("valve", "no-load flow", f"{drop:g} bar over both edges", flow / LITRE_PER_MINUTE, "l/min"),
    ]
    for direction, speed, slow, area in (
        ("out", free.extending, loaded[0], c.area_a),
        ("in", free.retracting, loaded[1], c.area_b),
    ):
        flow = speed * area / LITRE_PER_MINUTE
        rows += [
            Row("speed", f"no-load speed {direction}", "fully open", speed / MILLIMETRE, "mm/s"),
            Row("speed", f"speed {direction}", "2/3 of force limit", slow / MILLIMETRE, "mm/s"),
            Row("speed", f"flow from the supply {direction}", "no-load speed", flow, "l/min"),
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
    stiffness = parameters.load.spring_stiffness
    against = f"spring {stiffness / 1e3:g} N/mm" if stiffness else "stroke"
    pressure = f"{parameters.supply.pressure / BAR:g} bar"
    return [
        Row("force", "force limit out", pressure, limits.extending / 1e3, "kN"),
        Row("force", "force limit in", pressure, limits.retracting / 1e3, "kN"),
        Row("force", "reach in", against, low / MILLIMETRE, "mm"),
        Row("force", "reach out", against, high / MILLIMETRE, "mm"),
    ]


def _oscillation(parameters: PlantParameters, place: float) -> list[Row]:
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
    for leak in LEAKS:
        damping = _figure(_damping, leaking(parameters, leak), place)
        rows.append(
            Row("oil column", "damping ratio, linearised", f"{_position(place)}, {leak_text(leak)}", damping, "1")
        )
    return rows


def _loop(task: TaskConfig, place: float) -> list[Row]:
    places = places_in_reach(task.plant)
    span = f"worst, {places[0] / MILLIMETRE:+.0f} to {places[-1] / MILLIMETRE:+.0f} mm"
    thumb = "gain 2 ζ ω / speed (no sampling)"
    stable = f"largest stable gain ({1e3 * task.control_period:g} ms, {1e3 * task.command_latency:g} ms late)"
    found = {leak: weakest(nominal_loops(task, leak)) for leak in LEAKS}
    worst = weakest(loops_within_ranges(task))
    rows, sampled = [], []
    for leak, over_reach in found.items():
        plant, at = beyond_dead_band(leaking(task.plant, leak)), f"{_position(place)}, {leak_text(leak)}"
        rows.append(Row("position loop", thumb, at, _figure(_rule_of_thumb, plant, place), "1/m"))
        largest = _figure(partial(_largest_gain, task), plant, place)
        sampled += [
            Row("position loop", stable, at, largest, "1/m"),
            Row("position loop", "largest stable gain", f"{span}, {leak_text(leak)}", _gain(over_reach), "1/m"),
        ]
    within = f"worst of {DRAWN} plants in the ranges, {leak_text(HEALTHY_LEAK)}"
    sampled.append(Row("position loop", "largest stable gain", within, _gain(worst), "1/m"))
    if worst is None or not 0.0 < worst.gain < math.inf:
        return [*rows, *sampled]
    gain = worst.recommended
    sampled.append(Row("position loop", "recommended gain", "half of the worst in the ranges", gain, "1/m"))
    for which, weak in (("own values", found[HEALTHY_LEAK]), ("worst in the ranges", worst)):
        if weak is not None:
            at, phase = f"recommended gain, {which}", weak.loop.phase_margin(gain)
            sampled += [
                Row("position loop", "gain margin", at, _text(weak.gain_margin(gain)), "dB"),
                Row("position loop", "phase margin", at, _text(phase), "°"),
            ]
    for leak in LEAKS:
        plant, at = beyond_dead_band(leaking(task.plant, leak)), f"{_position(place)}, {leak_text(leak)}"
        stiffness = _figure(partial(_static_stiffness, gain), plant, place)
        sampled.append(Row("position loop", "static stiffness", f"recommended gain, {at}", stiffness, "kN/mm"))
    return [*rows, *sampled]


def _gain(found: Weakest | None) -> float | str:
    return "cannot be held" if found is None else _text(found.gain)


def _text(value: float) -> float | str:
    return value if math.isfinite(value) else "unlimited"


def _integration(parameters: PlantParameters, place: float) -> list[Row]:
    shortest, here = shortest_inner_step(parameters), inner_step(parameters, place)
    at = {"rest": _position(place), "here": f"{_position(place)} ({_words(here.cause)})"}
    rows = [
        Row("integration", "fastest rate |λ|, at rest", at["rest"], _figure(_fastest, parameters, place), "1/s"),
        Row("integration", "fastest rate |λ|, bound", at["here"], here.rate, "1/s"),
        Row("integration", "fastest rate |λ|, bound", f"whole stroke ({_words(shortest.cause)})", shortest.rate, "1/s"),
        Row("integration", "longest stable step", at["rest"], 1e3 * here.stable, "ms"),
        Row("integration", "longest stable step", "whole stroke", 1e3 * shortest.stable, "ms"),
    ]
    run = f"±10 V in turn from {_position(place)}"
    try:
        done = probe(parameters, place)
    except HydroError as error:
        return [*rows, Row("integration", "inner steps", run, str(error), "")]
    estimate = f"estimated error ({_words(done.state)})"
    enough = "yes" if done.error <= ALLOWED_ERROR else "no"
    period = f"{1e3 * PERIOD:g} ms"
    return [
        *rows,
        Row("integration", f"inner steps in {period}, mean", run, done.mean_steps, "1"),
        Row("integration", f"inner steps in {period}, most", run, float(done.most_steps), "1"),
        Row("integration", "mean inner step", run, 1e3 * PERIOD / done.mean_steps, "ms"),
        Row("integration", estimate, f"tolerance {TOLERANCE:g}", done.error, "of its range"),
        Row("integration", "is the inner step small enough", f"error ≤ {ALLOWED_ERROR:g}", enough, ""),
    ]


def _words(name: str) -> str:
    return name.replace("_", " ")


def _figure(
    compute: Callable[[PlantParameters, float], float], parameters: PlantParameters, place: float
) -> float | str:
    """A figure, or the reason for its absence."""
    try:
        return _text(compute(parameters, place))
    except ArithmeticError:
        return "overdamped"
    except HydroError:
        return "cannot be held"


def _damping(parameters: PlantParameters, place: float) -> float:
    return linearise(parameters.replace(friction={"model": "none"}), position=place).hydraulic_mode.damping_ratio


def _rule_of_thumb(parameters: PlantParameters, place: float) -> float:
    """2 ζ ω divided by the mean no-load speed: continuous loop, ideal valve, symmetric cylinder (Merritt 1967)."""
    mode = linearise(parameters.replace(friction={"model": "none"}), position=place).hydraulic_mode
    return 4.0 * mode.damping_ratio * mode.natural_frequency / sum(speed_limits(parameters))


def _largest_gain(task: TaskConfig, parameters: PlantParameters, place: float) -> float:
    return sampled_loop(parameters, place, task.control_period, task.command_latency).largest_stable_gain()


def _static_stiffness(gain: float, parameters: PlantParameters, place: float) -> float:
    return sampled_loop(parameters, place).static_stiffness(gain) * MILLIMETRE / 1e3


def _fastest(parameters: PlantParameters, place: float) -> float:
    state, voltage = equilibrium(parameters, place)
    return fastest_eigenvalue(parameters, State(**state), voltage)


def _position(position: float) -> str:
    return "mid-stroke" if abs(position) < 5e-7 else f"x = {position / MILLIMETRE:+.1f} mm"


def leak_text(leak: float) -> str:
    """A leak as text."""
    return f"{leak:g} l/min"
