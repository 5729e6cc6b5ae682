"""The hand calculations of an engineer for a rig, and the gains of a PID that follow from them."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import partial
from typing import NamedTuple

import numpy as np

from hydro_agents.controllers.pid import PIDGains
from hydro_agents.controllers.sampled_loop import COMMAND_LATENCY, CONTROL_PERIOD, places_in_reach, sampled_loop
from hydro_env import HydroError, PlantParameters, TaskConfig
from hydro_env.files import Group
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
from hydro_env.plant.parts.leakage import leak_past_piston
from hydro_env.plant.probe import ALLOWED_ERROR, PERIOD, probe
from hydro_env.plant.states import State
from hydro_env.plant.workable import inner_step, refuse_unworkable, shortest_inner_step
from hydro_env.units import FULL_VOLTAGE, LITRE_PER_MINUTE

LEAKS = (0.01, 0.3, 1.0, 4.0)  # l/min at 100 bar: a healthy seal, and three leaking ones

SHARE_OF_STABLE = 0.5  # proportional gain over the largest stable one: a gain margin of 6 dB
INTEGRAL_SHARE = 0.1  # rate of the integral over the crossover frequency: it costs 6° of phase there

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


def check_rig(parameters: PlantParameters, source: str = "rig") -> list[Row]:
    """All figures of a rig, in the units of practice.

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
        *_loop(parameters, place),
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
        damping = _figure(_damping, _leaking(parameters, leak), place)
        rows.append(
            Row("oil column", "damping ratio, linearised", f"{_position(place)}, {leak_text(leak)}", damping, "1")
        )
    return rows


def _loop(parameters: PlantParameters, place: float) -> list[Row]:
    places = places_in_reach(parameters)
    span = f"worst, {places[0] / MILLIMETRE:+.0f} to {places[-1] / MILLIMETRE:+.0f} mm"
    timing = f"({1e3 * CONTROL_PERIOD:g} ms, {1e3 * COMMAND_LATENCY:g} ms late)"
    thumb, stable = "gain 2 ζ ω / speed (no sampling)", f"largest stable gain {timing}"
    rows, sampled = [], []
    for leak in LEAKS:
        plant, at = beyond_dead_band(_leaking(parameters, leak)), f"{_position(place)}, {leak_text(leak)}"
        rows.append(Row("position loop", thumb, at, _figure(_rule_of_thumb, plant, place), "1/m"))
        sampled.append(Row("position loop", stable, at, _figure(_largest_gain, plant, place), "1/m"))
        worst = worst_gain(plant, places)
        sampled.append(Row("position loop", "largest stable gain", f"{span}, {leak_text(leak)}", worst, "1/m"))
        if isinstance(worst, float) and worst > 0.0:
            stiffness = _figure(partial(_static_stiffness, 0.5 * worst), plant, place)
            sampled.append(Row("position loop", "static stiffness", f"half of it, {at}", stiffness, "kN/mm"))
    return [*rows, *sampled]


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


def beyond_dead_band(parameters: PlantParameters) -> PlantParameters:
    """The rig with a controller that jumps over the dead band of its valve; without an overlap the rig itself.

    Within the dead band the valve passes next to nothing, so that almost any gain seems stable there. Each edge opens
    as before, from where its overlap ends: y = (o + √(o² + x_0²)) / 2 with o = x_s / (1 − x_d).
    """
    valve = parameters.valve
    if valve.overlap == 0.0:
        return parameters
    rest = 1.0 - valve.overlap
    return parameters.replace(
        valve={"overlap": 0.0, "rated_flow": valve.rated_flow / rest, "underlap": valve.underlap * rest}
    )


def _leaking(parameters: PlantParameters, leak: float) -> PlantParameters:
    return parameters.replace(leakage=leak_past_piston(leak, "laminar"))


def _figure(
    compute: Callable[[PlantParameters, float], float], parameters: PlantParameters, place: float
) -> float | str:
    """A figure, or the reason for its absence."""
    try:
        value = compute(parameters, place)
        return value if math.isfinite(value) else "unlimited"
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


def _largest_gain(parameters: PlantParameters, place: float, *timing: float) -> float:
    return sampled_loop(parameters, place, *timing).largest_stable_gain()


def _static_stiffness(gain: float, parameters: PlantParameters, place: float) -> float:
    return sampled_loop(parameters, place).static_stiffness(gain) * MILLIMETRE / 1e3


def worst_gain(
    parameters: PlantParameters,
    places: list[float],
    control_period: float = CONTROL_PERIOD,
    latency: float = COMMAND_LATENCY,
) -> float | str:
    """The smallest of the largest stable proportional gains (1/m) over some positions, or why it does not exist."""
    gains = [_figure(lambda *at: _largest_gain(*at, control_period, latency), parameters, place) for place in places]
    numbers = [gain for gain in gains if isinstance(gain, float)]
    return min(numbers) if numbers else max(map(str, gains))  # "unlimited" comes after "cannot be held"


def _fastest(parameters: PlantParameters, place: float) -> float:
    state, voltage = equilibrium(parameters, place)
    return fastest_eigenvalue(parameters, State(**state), voltage)


def _position(position: float) -> str:
    return "mid-stroke" if abs(position) < 5e-7 else f"x = {position / MILLIMETRE:+.1f} mm"


def leak_text(leak: float) -> str:
    """A leak as text."""
    return f"{leak:g} l/min"


def pid_from_figures(task: TaskConfig) -> PIDGains | None:
    """Half of the largest stable gain, and the inverse of the no-load speeds as feed-forward; no derivative.

    ``None`` if no gain makes the loop of the task's plant, control period and latency unstable, or each gain does.
    """
    plant = beyond_dead_band(task.plant)
    stable = worst_gain(plant, places_in_reach(task.plant), task.control_period, task.command_latency)
    out, back = speed_limits(plant)
    if not isinstance(stable, float) or stable <= 0.0 or min(out, back) <= 0.0:
        return None
    proportional = SHARE_OF_STABLE * stable
    crossover = proportional * 0.5 * (out + back)
    return PIDGains(
        proportional=proportional,
        integral=INTEGRAL_SHARE * crossover * proportional,
        feedforward_extending=1.0 / out,
        feedforward_retracting=1.0 / back,
        lead_in_integral=False,
    )


def stable_start(task: TaskConfig, given: Group) -> Group:
    """The given gains; for a PID whose gains would make the position loop unstable, those from the rig's figures."""
    if not isinstance(given, PIDGains):
        return given
    own = pid_from_figures(task)
    return own if own is not None and given.proportional > own.proportional / SHARE_OF_STABLE else given
