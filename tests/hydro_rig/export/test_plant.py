"""The generated C99 plant against the compiled kernel, over drawn rigs."""

import ctypes

import numpy as np
import pytest
from exported_code import library

from hydro_env import PlantParameters, ServoHydraulicVectorEnv, equilibrium, simulate
from hydro_env.plant.arrays import coefficient_array
from hydro_env.plant.kernel import (
    MAXIMUM_STEP,
    MOST_STEPS_PER_PERIOD,
    N_COEFFICIENTS,
    N_PEAKS,
    Accuracy,
    Plants,
    integrate,
)
from hydro_env.plant.parameters import from_vector, to_vector
from hydro_env.plant.states import STATE_NAMES
from hydro_rig.export.plant import plant_code

NUMBER = ctypes.c_double
PERIOD = 5e-3


def state_in_c(names):
    def array(self):
        return np.array([getattr(self, name) for name in names])

    return type("StateInC", (ctypes.Structure,), {"_fields_": [(name, NUMBER) for name in names], "array": array})


StateInC = state_in_c(STATE_NAMES)


class AccuracyInC(ctypes.Structure):
    _fields_ = [("maximum_step", NUMBER), ("tolerance", NUMBER), ("most_steps", NUMBER)]


def loaded(folder, parameters, state):
    in_c = library(folder, plant_code(parameters))
    array = np.ctypeslib.ndpointer(np.float64, flags="C")
    in_c.plant_coefficients.argtypes, in_c.plant_coefficients.restype = [array, array], None
    in_c.plant_equilibrium.argtypes = [NUMBER, array, ctypes.POINTER(state), ctypes.POINTER(NUMBER)]
    in_c.plant_advance.argtypes = [ctypes.POINTER(state), array, NUMBER, NUMBER, ctypes.POINTER(AccuracyInC)]
    in_c.plant_advance.restype = NUMBER
    return in_c


@pytest.fixture(scope="module")
def plant(tmp_path_factory):
    return loaded(tmp_path_factory.mktemp("plant"), None, StateInC)


def drawn_rigs(count):
    envs = ServoHydraulicVectorEnv(count, leakage={"faulty_range": [0.1, 8.0]})
    envs.reset(seed=11)
    rigs = [(envs.axes.physical[axis].copy(), envs.axes.column("position")[axis]) for axis in range(count)]
    other = PlantParameters().replace(
        valve={"overlap": 0.05, "knee_position": 0.4, "knee_opening": 0.2, "edge_ratio": 0.6, "null_shift": 0.01},
        lines={"volume_a": 2e-5, "volume_b": 3e-5, "wall_bulk_modulus": 3e8},
        friction={"model": "lugre"},
        supply={"model": "pump"},
    )
    return [*rigs, (to_vector(other), 0.02)]


def test_it_follows_the_kernel(plant):
    generator = np.random.default_rng(3)
    accuracy = AccuracyInC(MAXIMUM_STEP, 1e-6, MOST_STEPS_PER_PERIOD)
    for vector, position in drawn_rigs(12):
        parameters = from_vector(vector)
        constants = np.zeros(N_COEFFICIENTS)
        plant.plant_coefficients(vector, constants)
        expected = coefficient_array(parameters)
        np.testing.assert_allclose(constants, expected, rtol=1e-12)

        state, voltage = StateInC(), NUMBER()
        assert plant.plant_equilibrium(position, vector, ctypes.byref(state), ctypes.byref(voltage))
        rest, holding = equilibrium(parameters, position)
        np.testing.assert_allclose(state.array(), list(rest.values()), rtol=1e-9, atol=1e-12)
        assert voltage.value == pytest.approx(holding, abs=1e-9)

        row, other = np.array([list(rest.values())]), StateInC(*rest.values())
        ours, theirs = [], []
        for command in generator.uniform(-8.0, 8.0, 100):
            arrays = [np.array([[command]]), np.array([[PERIOD]]), np.zeros((1, N_PEAKS))]
            integrate(Plants(row, expected[None], *arrays), Accuracy(), 0, 1)
            plant.plant_advance(ctypes.byref(other), constants, command, PERIOD, ctypes.byref(accuracy))
            ours.append(row[0].copy())
            theirs.append(other.array())
        ranges = np.maximum(np.ptp(ours, axis=0), 1e-12)
        assert (np.abs(np.subtract(ours, theirs)) / ranges).max() <= 1e-9


def test_the_same_source_gives_the_same_code():
    first, second = plant_code(), plant_code()
    assert first == second
    assert "plant_default_parameters" in first["plant.h"]
    assert plant_code(PlantParameters().replace(load={"mass": 77.0}))["plant.c"] != first["plant.c"]


def test_an_axis_with_waves_second_mass_and_sharp_edges_follows_the_kernel(tmp_path):
    parameters = PlantParameters().replace(
        lines={"volume_a": 1e-4, "volume_b": 1e-4, "length_a": 2.0, "length_b": 2.0},
        load={"tip_share": 0.6, "tip_frequency": 40.0},
        valve={"underlap": 0.0, "overlap": -0.0075},
        leakage={"internal_resistance": 5e11},
    )
    rest, _ = equilibrium(parameters, 0.02)
    kind = state_in_c(tuple(rest))
    in_c, vector, constants = loaded(tmp_path, parameters, kind), to_vector(parameters), np.zeros(N_COEFFICIENTS)
    in_c.plant_coefficients(vector, constants)
    state, voltage = kind(), NUMBER()
    assert in_c.plant_equilibrium(0.02, vector, ctypes.byref(state), ctypes.byref(voltage))
    np.testing.assert_allclose(state.array(), list(rest.values()), rtol=1e-9, atol=1e-12)
    commands = np.repeat([3.0, -5.0, 0.2], 4)
    run = simulate(parameters, commands, PERIOD, rest)
    size = np.maximum(np.abs(run.states).max(axis=0), 1e-12)
    accuracy = AccuracyInC(MAXIMUM_STEP, 1e-6, MOST_STEPS_PER_PERIOD)
    for volts, expected in zip(commands, run.states[1:], strict=True):
        in_c.plant_advance(ctypes.byref(state), constants, volts, PERIOD, ctypes.byref(accuracy))
        np.testing.assert_allclose(state.array() / size, expected / size, rtol=0.0, atol=1e-6)
