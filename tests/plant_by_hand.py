"""The right-hand side written a second time: plain Python from the equations of docs/model.md.

It shares only the names of the states with the compiled one.
"""

from collections.abc import Callable, Sequence
from math import inf, pi, sqrt

from hydro_env import PlantParameters
from hydro_env.plant.states import State

RightHandSide = Callable[[float, Sequence[float], float], State]

ATMOSPHERE = 101_325.0  # Pa
VAPOUR = -0.9e5  # Pa, gauge


def right_hand_side(parameters: PlantParameters) -> RightHandSide:
    """f(t, y, u): derivative of the states y (order of ``STATE_NAMES``, SI) at the voltage u (V).

    The valve with its drive, friction without bristles, supply constant or with accumulator.
    """
    cylinder, valve, fluid = parameters.cylinder, parameters.valve, parameters.fluid
    lines = parameters.lines
    load, friction, supply, leakage = parameters.load, parameters.friction, parameters.supply, parameters.leakage
    area_a = pi / 4 * (cylinder.bore_diameter**2 - cylinder.rod_diameter_a**2)
    area_b = pi / 4 * (cylinder.bore_diameter**2 - cylinder.rod_diameter**2)
    half = cylinder.stroke / 2
    mass = load.mass + cylinder.piston_mass
    gain = valve.rated_flow / sqrt(valve.rated_pressure_drop / 2)
    omega, zeta, slew = valve.natural_frequency, valve.damping_ratio, valve.slew_limit
    external = 0.0 if leakage.external_resistance == inf else 1 / leakage.external_resistance
    coulomb = 0.0 if friction.model == "none" else friction.coulomb_force
    stribeck = friction.breakaway_force - friction.coulomb_force if friction.model == "stribeck" else 0.0

    def root(drop: float) -> float:  # S(Δp)
        return drop / sqrt(sqrt(drop**2 + valve.transition_pressure**2))

    def edge(stroke: float) -> float:  # opening, with overlap and knee
        beyond = (stroke - valve.overlap) / (1 - valve.overlap)
        opening = (sqrt(beyond**2 + valve.underlap**2) + beyond) / 2
        before = valve.knee_opening / valve.knee_position
        after = (1 - valve.knee_opening) / (1 - valve.knee_position)
        return before * opening + max(beyond - valve.knee_position, 0.0) * (after - before)

    def modulus(pressure: float) -> float:  # β_eff
        absolute = max(pressure, VAPOUR) + ATMOSPHERE
        air = fluid.air_fraction * ATMOSPHERE
        return 1 / (1 / fluid.bulk_modulus + air / (((1 - fluid.air_fraction) * absolute + air) * absolute))

    def f(t: float, y: Sequence[float], u: float) -> State:
        del t
        s = State(*y)
        x, v, p_a, p_b, p_s = s.position, s.velocity, s.pressure_a, s.pressure_b, s.supply_pressure
        spool, spool_speed, current = s.spool_position, s.spool_velocity, s.coil_current
        # valve drive, spool with its limits
        current_rate = (valve.amplifier_gain * u - valve.coil_resistance * current) / valve.coil_inductance
        spool_rate = min(max(spool_speed, -slew), slew)
        if (spool >= 1 and spool_rate > 0) or (spool <= -1 and spool_rate < 0):
            spool_rate = 0.0
        spool_acceleration = omega**2 * (valve.spool_gain * current - spool) - 2 * zeta * omega * spool_speed
        if (spool_speed >= slew and spool_acceleration > 0) or (spool_speed <= -slew and spool_acceleration < 0):
            spool_acceleration = 0.0
        # four edges, leakage
        forward, backward = edge(spool - valve.null_shift), edge(valve.null_shift - spool)
        into_a, out_of_a = gain * forward * root(p_s - p_a), gain * backward * root(p_a - supply.tank_pressure)
        gain_b = valve.edge_ratio * gain
        out_of_b, into_b = gain_b * forward * root(p_b - supply.tank_pressure), gain_b * backward * root(p_s - p_b)
        leak = (p_a - p_b) / leakage.internal_resistance + leakage.orifice_gain * root(p_a - p_b)
        # chambers
        volume_a = cylinder.dead_volume + lines.volume_a + area_a * (half + x)
        volume_b = cylinder.dead_volume + lines.volume_b + area_b * (half - x)
        softness_a = volume_a / modulus(p_a) + lines.volume_a / lines.wall_bulk_modulus
        softness_b = volume_b / modulus(p_b) + lines.volume_b / lines.wall_bulk_modulus
        rate_a = (into_a - out_of_a - area_a * v - leak) / softness_a
        rate_b = (into_b - out_of_b + area_b * v + leak - external * p_b) / softness_b
        if p_a <= VAPOUR:
            rate_a = max(rate_a, 0.0)
        if p_b <= VAPOUR:
            rate_b = max(rate_b, 0.0)
        # load
        lubrication = coulomb + stribeck / (1 + (v / friction.stribeck_velocity) ** 2)
        ratio = v / friction.transition_velocity
        force = p_a * area_a - p_b * area_b - load.spring_stiffness * x - load.viscous_damping * v
        force -= lubrication * ratio / sqrt(1 + ratio**2) + load.external_force
        if x > half:
            force -= max(cylinder.end_stop_stiffness * (x - half) + cylinder.end_stop_damping * v, 0.0)
        elif x < -half:
            force += max(cylinder.end_stop_stiffness * (-x - half) - cylinder.end_stop_damping * v, 0.0)
        # supply
        supply_rate = gas_rate = 0.0
        if supply.model == "accumulator":
            relief = supply.relief_slope * max(p_s - supply.pressure, 0.0)
            surplus = supply.pump_flow - into_a - into_b - relief
            supply_rate = supply.polytropic_index * (p_s + ATMOSPHERE) / s.gas_volume * surplus
            gas_rate = -surplus
        return State(
            position=v,
            velocity=force / mass,
            pressure_a=rate_a,
            pressure_b=rate_b,
            spool_position=spool_rate,
            spool_velocity=spool_acceleration,
            coil_current=current_rate,
            supply_pressure=supply_rate,
            gas_volume=gas_rate,
            bristle_deflection=0.0,
        )

    return f
