"""The compiled right-hand side equals the one that is written by hand from the equations of docs/model.md."""

import numpy as np
import plant_by_hand
import pytest

from hydro_env import PlantParameters
from hydro_env.plant.arrays import coefficient_array, derivative_array
from hydro_env.plant.states import State

RIGS = (
    PlantParameters(),
    PlantParameters().replace(supply={"model": "constant"}, friction={"model": "coulomb"}),
    PlantParameters().replace(
        friction={"model": "none"},
        cylinder={"rod_diameter_a": 0.02},
        leakage={"internal_resistance": 1e11, "external_resistance": 1e12, "orifice_gain": 1e-8},
        load={"external_force": 500.0},
        valve={"null_shift": -0.02},
    ),
    PlantParameters().replace(
        valve={"overlap": 0.05, "knee_position": 0.4, "knee_opening": 0.1, "edge_ratio": 0.5},
        lines={"volume_a": 50e-6, "volume_b": 80e-6, "wall_bulk_modulus": 0.3e9},
    ),
)


@pytest.mark.parametrize("rig", RIGS)
def test_the_rates_are_the_same(rig):
    by_hand, coefficients = plant_by_hand.right_hand_side(rig), coefficient_array(rig)
    generator = np.random.default_rng(1)
    for _ in range(200):
        state = State(
            position=generator.uniform(-0.201, 0.201),
            velocity=generator.normal(),
            pressure_a=generator.uniform(-1.0e5, 70e5),
            pressure_b=generator.uniform(-1.0e5, 70e5),
            spool_position=generator.uniform(-1.1, 1.1),
            spool_velocity=generator.normal(0.0, 80.0),
            coil_current=generator.normal(),
            supply_pressure=generator.uniform(50e5, 80e5),
            gas_volume=generator.uniform(1e-4, 9e-4),
            bristle_deflection=0.0,
        )
        voltage = generator.uniform(-10.0, 10.0)
        np.testing.assert_allclose(
            by_hand(0.0, state, voltage), derivative_array(np.array(state), coefficients, voltage), rtol=1e-9
        )
