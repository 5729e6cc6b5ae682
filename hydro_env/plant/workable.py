"""Checks that a rig can work; an error of one line names each impossible figure."""

import math

import numpy as np

from hydro_env.errors import ConfigurationError, HydroError
from hydro_env.plant.analysis import force_limits, full_pressure_forces, reachable_range, speed_limits
from hydro_env.plant.arrays import coefficient_array, equilibrium, functions_of
from hydro_env.plant.kernel import STABLE_PRODUCT
from hydro_env.plant.linearisation import fastest_motion
from hydro_env.plant.parameters import PARAMETER_UNITS, PlantParameters
from hydro_env.plant.parts.leakage import LEAK_LAWS, ROD_SEAL
from hydro_env.plant.simulate import DERIVED_NAMES, valid_ranges
from hydro_env.plant.states import STATE_NAMES, state_kind
from hydro_env.units import FULL_VOLTAGE, LITRE_PER_MINUTE

LEAST_TRAVEL = 1e-3  # m; a rig must be able to move this far from the free length of its spring
LEAST_OPENING = 0.01  # smallest allowed spool position at 10 V
MOST_STEPS = 4000  # largest allowed number of inner steps in 5 ms
STEPS_PERIOD = 5e-3  # s; steps are counted over this period

CAUSES = {
    "pressure_a": "cylinder.dead_volume, valve.transition_pressure, a leak, or load.mass on this oil column",
    "pressure_b": "cylinder.dead_volume, valve.transition_pressure, a leak, or load.mass on this oil column",
    "velocity": "friction.transition_velocity, load.viscous_damping or cylinder.end_stop_damping for this load.mass",
    "position": "load.mass on this spring, or cylinder.end_stop_stiffness",
    "bristle_deflection": "friction.bristle_stiffness for this coulomb_force",
    "spool_position": "valve.natural_frequency",
    "spool_velocity": "valve.natural_frequency",
    "coil_current": "valve.coil_inductance",
    "supply_pressure": "supply.line_volume",
    "tip_position": "load.tip_frequency",
    "tip_velocity": "load.tip_frequency",
}
"""Figures that make a state move too fast."""

LINES = "lines.length_a, length_b or their volumes"

PLACES = 5  # number of positions over the reachable range; the axis must be able to hold one of them


def fastest_rate(parameters: PlantParameters) -> tuple[float, str]:
    """|λ| in 1/s of the fastest motion where it is fastest, and the state that moves most in it.

    The valve is fully open without a pressure drop, at mid-stroke and on both end stops. LuGre friction relaxes faster
    at a higher speed: its rate is that at the speed without load.
    """
    supply, stop = parameters.supply, 0.5 * parameters.cylinder.stroke + 1e-4
    lugre = parameters.friction.model == "lugre"
    kind = state_kind(parameters.structure)
    open_valve = kind(**dict.fromkeys(kind._fields, 0.0))._replace(
        velocity=max(speed_limits(parameters)) if lugre else 0.0,
        pressure_a=supply.pressure,
        pressure_b=supply.tank_pressure,
        spool_position=1.0,
        supply_pressure=supply.pressure,
        gas_volume=supply.accumulator_volume,
    )
    for number in (1, 2, 3) if parameters.structure.lines else ():
        pressures = {f"line_a_pressure_{number}": supply.pressure, f"line_b_pressure_{number}": supply.tank_pressure}
        open_valve = open_valve._replace(**pressures)
    places = (open_valve, open_valve._replace(position=stop), open_valve._replace(position=-stop))
    return max(fastest_motion(parameters, state) for state in places)


def refuse_unworkable(parameters: PlantParameters, source: str = "rig") -> None:
    """Check that commands can move a rig, that it can rest somewhere, and that it does not need extremely short steps.

    :class:`~hydro_env.plant.parameters.PlantParameters` itself checks for figures that contradict each other (a rod
    that fills the bore, a supply below tank, an accumulator that stays empty).

    Raises:
        ConfigurationError: one line with the impossible figure and its limit.
    """
    load, supply = parameters.load, parameters.supply
    out, back = force_limits(parameters)
    full_out, full_back = full_pressure_forces(parameters)
    least = load.spring_stiffness * LEAST_TRAVEL
    for force, own, direction in ((out, full_out, "out"), (back, full_back, "in")):
        where = f"{supply.pressure / 1e5:g} bar give {max(own, 0.0):.4g} N {direction}"
        if own <= 0.0:
            raise ConfigurationError(
                f"{source}: supply.tank_pressure = {supply.tank_pressure / 1e5:g} bar: {where} against it on these "
                f"areas; lower it or raise supply.pressure"
            )
        if force <= 0.0:
            raise ConfigurationError(
                f"{source}: load.external_force = {load.external_force:g} N: {where}; "
                f"it must stay within {-full_back:.4g} to {full_out:.4g} N"
            )
        if least >= force:
            raise ConfigurationError(
                f"{source}: load.spring_stiffness = {load.spring_stiffness:g} N/m: {where}, which does not move it "
                f"{1e3 * LEAST_TRAVEL:g} mm; the limit is {force / LEAST_TRAVEL:.4g} N/m"
            )
    largest_friction, weaker = parameters.friction.largest_force, min(out, back)
    if largest_friction >= weaker - least:
        name = "coulomb_force" if parameters.friction.model == "coulomb" else "breakaway_force"
        raise ConfigurationError(
            f"{source}: friction.{name} = {largest_friction:g} N: {supply.pressure / 1e5:g} bar give {weaker:.4g} N "
            f"{'out' if out < back else 'in'}, which does not move it {1e3 * LEAST_TRAVEL:g} mm; the limit is "
            f"{weaker - least:.4g} N"
        )
    _refuse_valve_and_pump(parameters, source)
    rate, state = fastest_rate(parameters)
    steps = math.ceil(min(STEPS_PERIOD * rate / STABLE_PRODUCT, 1e15))
    if steps > MOST_STEPS:
        raise ConfigurationError(
            f"{source}: {CAUSES.get(state, LINES)}: {state} moves at {rate:.3g} 1/s, which requires {steps:,} inner "
            f"steps in {1e3 * STEPS_PERIOD:g} ms; the limit is {MOST_STEPS:,} "
            f"({MOST_STEPS * STABLE_PRODUCT / STEPS_PERIOD:.3g} 1/s)"
        )
    if _rest(parameters) is None:
        raise ConfigurationError(f"{source}: {_why_no_rest(parameters)}")


def _refuse_valve_and_pump(parameters: PlantParameters, source: str) -> None:
    """Check the opening of the valve at 10 V, the coil current, and the slope of the relief valve."""
    valve, supply = parameters.valve, parameters.supply
    current = FULL_VOLTAGE * valve.amplifier_gain / valve.coil_resistance
    limits = dict(zip(STATE_NAMES, zip(*valid_ranges(parameters), strict=True), strict=True))
    if current > limits["coil_current"][1]:
        raise ConfigurationError(
            f"{source}: valve.amplifier_gain = {valve.amplifier_gain:g} V/V: 10 V drive {current:.3g} A through the "
            f"coil; the limit is {limits['coil_current'][1] * valve.coil_resistance / FULL_VOLTAGE:.4g} V/V"
        )
    if current * valve.spool_gain < LEAST_OPENING:
        raise ConfigurationError(
            f"{source}: valve.amplifier_gain = {valve.amplifier_gain:g} V/V, coil_resistance = "
            f"{valve.coil_resistance:g} Ω, spool_gain = {valve.spool_gain:g} 1/A: 10 V open the valve by "
            f"{100.0 * current * valve.spool_gain:.3g} %; it must be at least {100.0 * LEAST_OPENING:g} %"
        )
    highest = limits["supply_pressure"][1]
    if supply.is_regulated and supply.pressure + supply.pump_flow / supply.relief_slope > highest:
        raise ConfigurationError(
            f"{source}: supply.relief_slope = {supply.relief_slope:g} m³/(s Pa): a pump of {supply.pump_flow:g} m³/s "
            f"raises the supply above {highest / 1e5:g} bar; it must be at least "
            f"{supply.pump_flow / (highest - supply.pressure):.3g}"
        )


def _rest(parameters: PlantParameters) -> dict[str, float] | None:
    """A state at rest within the reachable range, or None."""
    low, high = (0.9 * end for end in reachable_range(parameters))
    for number in range(PLACES):
        try:
            return equilibrium(parameters, low + (0.5 + 0.5 * number) % 1.0 * (high - low))[0]
        except HydroError:
            continue
    return None


def _why_no_rest(parameters: PlantParameters) -> str:
    supply, leakage = parameters.supply, parameters.leakage
    fed = _rest(parameters.replace(supply={"model": "constant"}))
    if fed is not None:
        derived = functions_of(parameters.structure).derived(
            np.array([list(fed.values())]), coefficient_array(parameters)[None]
        )
        flow = derived[0, DERIVED_NAMES.index("supply_flow")]
        pump, drawn = supply.pump_flow / LITRE_PER_MINUTE, flow / LITRE_PER_MINUTE
        return (
            f"supply.pump_flow = {supply.pump_flow:.3g} m³/s ({pump:.3g} l/min): at rest valve and leaks draw "
            f"{flow:.3g} m³/s ({drawn:.3g} l/min); it must be more, or supply.model constant"
        )
    for law in (*LEAK_LAWS.values(), ROD_SEAL):
        name, value, tight = law.parameter, getattr(leakage, law.parameter), law.value(0.0)
        if value != tight and _rest(parameters.replace(leakage={name: tight})) is not None:
            return (
                f"leakage.{name} = {value:.3g} {PARAMETER_UNITS[f'leakage.{name}']}: more oil leaks than the valve "
                f"feeds from {supply.pressure / 1e5:g} bar, and no position can be held"
            )
    return "no position can be held: leaks, forces and supply pressure contradict each other"
