"""The plant at steady state: the cost of a leak even if the axis holds its position, and what the nominal rig can do.

A leak costs power from the supply, and reserve of speed and force. No controller changes these figures.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pandas as pd
from scipy.optimize import brentq

from hydro_env import PlantParameters, TaskConfig, equilibrium
from hydro_env.errors import HydroError
from hydro_env.plant.analysis import full_pressure_forces, reachable_range, speed_limits
from hydro_env.plant.arrays import coefficient_array, derived_array, plant_coefficients
from hydro_env.plant.equations import Derived
from hydro_env.plant.parts.leakage import leak_past_piston
from hydro_env.plant.states import STATE_NAMES
from hydro_env.units import FULL_VOLTAGE

PRICE_LEAKS = (0.01, 0.1, 0.3, 1.0, 2.0, 4.0, 6.0, 8.0)  # l/min at 100 bar

PLACE = 0.3
"""Working position: share of the range that the supply of the nominal rig can hold, outwards from mid-stroke.

There a spring pushes against the piston; its pressure difference drives the leak.
"""


def working_place(plant: PlantParameters, share: float = PLACE) -> float:
    """Position in m at a share (−1 to 1) of the range that the supply of the nominal rig can hold."""
    low, high = reachable_range(plant)
    return share * high if share > 0.0 else -share * low


def full_speed(plant: PlantParameters, position: float) -> float:
    """The smaller of the two steady speeds of the nominal rig at full command at a position (m), m/s."""
    return min(speed_limits(plant, plant.load.spring_stiffness * position + plant.load.external_force))


def leak_price(config: TaskConfig, leaks: Sequence[float] = PRICE_LEAKS) -> pd.DataFrame:
    """Cost of a leak on the nominal rig of a task, with the leakage law of the task.

    Args:
        config: the task.
        leaks: l/min at 100 bar.

    Returns:
        Per leak: leakage_flow_lpm, place_mm (:func:`working_place`), holding_power_w (flow through the valve times
        supply pressure), holding_command (1 = 10 V); speed_out_mm_s and speed_back_mm_s (steady speed at full command
        against the spring at this place), force_out_n and force_back_n (largest load that the axis can still hold at
        full command). NaN if the leak is too large to hold the place.
    """
    position = working_place(config.plant)
    load = config.plant.load.spring_stiffness * position + config.plant.load.external_force
    rows = []
    for leak in leaks:
        plant = config.plant.replace(leakage=leak_past_piston(leak, config.leakage.law))
        power, command = _holding(plant, position)
        row = {"leakage_flow_lpm": leak, "place_mm": 1e3 * position, "holding_power_w": power}
        row["holding_command"] = command
        for direction, name in ((1.0, "out"), (-1.0, "back")):
            row[f"speed_{name}_mm_s"] = 1e3 * max(direction * full_command_speed(plant, direction, load), 0.0)
            row[f"force_{name}_n"] = stall_force(plant, direction)
        rows.append(row)
    return pd.DataFrame(rows)


def _flows(plant: PlantParameters, **state: float) -> Derived:
    """Flows of a plant in a state; states that are not given are zero."""
    row = np.array([[state.get(name, 0.0) for name in STATE_NAMES]])
    return Derived(*derived_array(row, coefficient_array(plant)[None])[0].tolist())


def _holding(plant: PlantParameters, position: float) -> tuple[float, float]:
    """Power in W from the supply and command (1 = 10 V) while a position (m) is held."""
    try:
        state, voltage = equilibrium(plant, position)
    except HydroError:  # the leak is too large
        return float("nan"), float("nan")
    return _flows(plant, **state).supply_flow * state["supply_pressure"], voltage / FULL_VOLTAGE


def full_command_speed(plant: PlantParameters, direction: float, force: float) -> float:
    """Steady speed in m/s with the valve fully open, at the set supply pressure, leaks included.

    The force and both flows balance: p_a A_a − p_b A_b = F, A_a v = Q_a − leak, A_b v = Q_b − leak + external leak.
    Dry friction is neglected.

    Args:
        plant: the plant.
        direction: 1 extends, −1 retracts.
        force: N, of the load, positive against extension.
    """
    c = plant_coefficients(plant)
    supply, tank = plant.supply.pressure, plant.supply.tank_pressure

    def speeds(pressure_a: float) -> tuple[float, float]:
        """Speeds at which the flow of chamber a, and that of chamber b, balances."""
        pressure_b = (c.area_a * pressure_a - force) / c.area_b
        pressures = {"pressure_a": pressure_a, "pressure_b": pressure_b, "supply_pressure": supply}
        q = _flows(plant, **pressures, spool_position=direction, gas_volume=1.0)
        return (q.flow_a - q.leakage_flow) / c.area_a, (q.flow_b - q.leakage_flow + q.external_leakage_flow) / c.area_b

    # Chamber a cannot exceed the supply, nor can chamber b; a load beyond that moves the axis backwards.
    low = max(tank, (force + c.area_b * tank) / c.area_a) - 0.5 * supply
    high = min(supply, (force + c.area_b * supply) / c.area_a) + 0.5 * supply
    pressure = brentq(lambda p: np.subtract(*speeds(p)), low, high, xtol=1.0)
    return float(speeds(pressure)[0])


def stall_force(plant: PlantParameters, direction: float) -> float:
    """Largest load in N that the fully open valve still holds against the leak (its steady speed is 0)."""
    limit = full_pressure_forces(plant)
    tight = limit.extending if direction > 0.0 else -limit.retracting
    return float(direction * brentq(lambda force: full_command_speed(plant, direction, force), 0.0, 1.05 * tight))
