"""A check that no one here wrote: the closed loop of Hopsan's example "Position Servo", with the model's parameters.

The example has what real servo axes have: an overlapped valve with dynamics, a pump that limits the flow, a relief
valve, and an integrating controller, which makes a limit cycle. Nothing is fitted. Hopsan writes pressures absolute,
here they are gauge pressures; its relief valve has a lag of 1 ms, here it has none.
"""

import math
from pathlib import Path

import numpy as np
import pytest

from hydro_env import PlantParameters, simulate
from hydro_env.plant.states import STATE_NAMES

RECORDED = Path(__file__).parents[2] / "recorded_elsewhere" / "hopsan_position_servo.csv"

AREA, BORE, STROKE = 1e-3, 0.05, 1.0  # m², m (any bore that leaves room for two rods), m
SPOOL_STROKE, OVERLAP, SPOOL_DIAMETER = 0.01, 1e-4, 0.01  # m
EDGE_AREA = math.pi * SPOOL_DIAMETER * (SPOOL_STROKE - OVERLAP)  # m², fully open, edge around the whole spool
PROPORTIONAL, INTEGRAL = 0.0264249, 0.000672426  # m of spool per m, per m s
STEP = 1e-4  # s, Hopsan's own


def position_servo() -> PlantParameters:
    """The plant with the parameters of the example."""
    rod = math.sqrt(BORE**2 - 4.0 * AREA / math.pi)
    return PlantParameters().replace(
        cylinder={"bore_diameter": BORE, "rod_diameter": rod, "rod_diameter_a": rod, "stroke": STROKE}
        | {"dead_volume": 3e-4, "piston_mass": 0.0, "end_stop_stiffness": 1e9, "end_stop_damping": 1e5},
        valve={"model": "spool", "natural_frequency": 200.0, "damping_ratio": 1.0, "slew_limit": 1e5}
        | {"rated_flow": 0.67 * EDGE_AREA * math.sqrt(2.0 * 35e5 / 890.0), "rated_pressure_drop": 70e5}
        | {"underlap": 0.0, "overlap": OVERLAP / SPOOL_STROKE, "transition_pressure": 1e3},
        fluid={"density": 890.0, "bulk_modulus": 1e9, "air_fraction": 0.0},
        # The spring rests where the piston starts, half a stroke from the middle.
        load={"mass": 100.0, "spring_stiffness": 100.0, "viscous_damping": 0.0, "external_force": 50.0},
        friction={"model": "none"},
        supply={"model": "pump", "pressure": 199e5, "tank_pressure": 0.0, "relief_slope": 1e-8, "line_volume": 1e-3}
        | {"pump_flow": 25e-5 / (2.0 * math.pi) * 200.0},
        leakage={"internal_resistance": math.inf},
    )


def closed_loop(duration: float) -> np.ndarray:
    """Position in m from the start at each step; all pressures are zero at first."""
    plant, integral = position_servo(), 0.0
    state = dict.fromkeys(STATE_NAMES, 0.0) | {"position": -0.5 * STROKE, "gas_volume": 1e-3}
    positions = [0.0]
    for step in range(round(duration / STEP)):
        error = (0.2 if step * STEP < 1.0 else 0.7) - positions[-1]
        integral += error * STEP
        opening = (PROPORTIONAL * error + INTEGRAL * integral) / SPOOL_STROKE
        run = simulate(plant, [10.0 * min(max(opening, -1.0), 1.0)], STEP, state)
        state = dict(zip(STATE_NAMES, run.states[-1].tolist(), strict=True))
        positions.append(state["position"] + 0.5 * STROKE)
    return np.array(positions)


def worst_share(begin: float, end: float) -> float:
    """Largest difference from Hopsan's position between two times (s), as a share of the range it covers there."""
    time, position = np.loadtxt(RECORDED, delimiter=",", skiprows=4).T
    chosen = (time >= begin) & (time < end)
    assert chosen.sum() > 30
    own = closed_loop(float(time[chosen].max()) + STEP)
    difference = np.interp(time[chosen], STEP * np.arange(len(own)), own) - position[chosen]
    return float(np.abs(difference).max() / np.ptp(position[chosen]))


def test_the_closed_loop_starts_as_hopsan_computed_it():
    assert worst_share(0.0, 0.3) < 0.024


@pytest.mark.slow
def test_the_second_step_begins_in_the_same_phase_of_the_limit_cycle():
    assert worst_share(1.0, 1.3) < 0.03
