"""Parts of the circuit exchanged or switched off by configuration, each against a closed form or a conservation law."""

import math

import numpy as np
import pytest

from hydro_env import PlantParameters, ServoHydraulicEnv, equilibrium, simulate
from hydro_env.plant.parameters import from_vector, to_vector
from hydro_env.plant.states import ATMOSPHERIC_PRESSURE

SAMPLE = 0.5e-3


def step(parameters, voltage, duration=0.05, start=None):
    return simulate(parameters, np.full(round(duration / SAMPLE), voltage), SAMPLE, start)


def test_an_ideal_spool_follows_the_command_at_once():
    plant = PlantParameters().replace(valve={"model": "ideal"})
    run = simulate(plant, [3.0, 3.0, -5.0, 12.0 - 2.0], SAMPLE)
    np.testing.assert_allclose(run.spool_position[1:], [0.3, 0.3, -0.5, 1.0], rtol=1e-12)
    assert np.abs(run.spool_velocity).max() < 1e-12


def test_an_ideal_drive_leaves_the_spool_of_second_order():
    """Step response of a second-order system, below the slew limit."""
    plant = PlantParameters().replace(valve={"model": "spool"})
    rest, _ = equilibrium(plant)
    run = step(plant, 1.0, 0.02, rest | {"spool_position": 0.0, "coil_current": 0.0})
    omega, zeta = plant.valve.natural_frequency, plant.valve.damping_ratio
    damped = omega * math.sqrt(1.0 - zeta**2)
    phase = np.cos(damped * run.time) + zeta * omega / damped * np.sin(damped * run.time)
    expected = 0.1 * (1.0 - np.exp(-zeta * omega * run.time) * phase)
    assert np.abs(run.spool_velocity).max() < plant.valve.slew_limit
    assert np.abs(run.spool_position - expected).max() < 1e-6
    assert np.allclose(run.coil_current[1:], 0.25)


def test_the_whole_drive_adds_the_lag_of_the_coil():
    plant = PlantParameters()
    rest, _ = equilibrium(plant)
    run = step(plant, 1.0, 0.01, rest | {"spool_position": 0.0, "coil_current": 0.0})
    lag = plant.valve.coil_inductance / plant.valve.coil_resistance
    assert np.abs(run.coil_current - 0.25 * (1.0 - np.exp(-run.time / lag))).max() < 1e-6


def test_a_pump_without_accumulator_settles_on_its_relief_valve():
    """Closed zero-lapped valve: P_s rises as 1 − exp(−β slope t / V_line) to where the relief valve passes the pump."""
    plant = PlantParameters().replace(
        supply={"model": "pump"}, valve={"underlap": 0.0}, leakage={"internal_resistance": math.inf}
    )
    supply = plant.supply
    rest, _ = equilibrium(plant)
    run = step(plant, 0.0, 0.02, rest | {"supply_pressure": supply.pressure, "spool_position": 0.0})
    rate = plant.fluid.bulk_modulus * supply.relief_slope / supply.line_volume
    rise = supply.pump_flow / supply.relief_slope
    expected = supply.pressure + rise * (1.0 - np.exp(-rate * run.time))
    # The regularised root lets a trace of oil pass a zero-lapped valve; nothing else differs.
    assert np.abs(run.supply_pressure - expected).max() < 1e-3 * rise
    assert rest["supply_pressure"] == pytest.approx(supply.pressure + rise, rel=1e-4)


def test_an_accumulator_alone_gives_what_its_gas_gives():
    """Pump standing still: (P_s + p_atm) V^n stays, and the gas grows by the oil that left."""
    plant = PlantParameters().replace(supply={"pump_flow": 0.0})
    run = simulate(plant, np.repeat([6.0, -6.0], 400), SAMPLE)
    invariant = (run.supply_pressure + ATMOSPHERIC_PRESSURE) * run.gas_volume**plant.supply.polytropic_index
    assert np.ptp(invariant) / invariant[0] < 1e-6
    drawn = np.concatenate([[0.0], np.cumsum(0.5 * (run.supply_flow[1:] + run.supply_flow[:-1]) * SAMPLE)])
    assert drawn[-1] > 2e-5
    assert run.gas_volume - run.gas_volume[0] == pytest.approx(drawn, abs=2e-3 * drawn[-1])
    assert run.supply_pressure[-1] < run.supply_pressure[0] - 1e5


IDEAL = {"valve": {"model": "ideal"}, "supply": {"model": "constant"}, "friction": {"model": "none"}}
CIRCUITS = [
    IDEAL | {"cylinder": {"rod_diameter_a": 0.028}, "load": {"spring_stiffness": 0.0}},
    {"valve": {"model": "spool", "underlap": 0.0}, "supply": {"model": "pump"}, "friction": {"model": "coulomb"}},
    {"friction": {"model": "lugre"}, "supply": {"pump_flow": 0.0}, "leakage": {"orifice_gain": 5e-9}},
    {"fluid": {"air_fraction": 0.0}},
]


@pytest.mark.parametrize("changes", CIRCUITS)
def test_every_part_of_a_circuit_meets_the_reference_solver(changes):
    plant = PlantParameters().replace(**changes)
    assert from_vector(to_vector(plant)) == plant
    env = ServoHydraulicEnv(plant=plant.model_dump(), episode_duration=0.2)
    env.reset(seed=1)
    steps = [env.step(np.array([0.2 * math.sin(0.3 * step)])) for step in range(40)]
    assert not any(terminated for _, _, terminated, _, _ in steps)
    assert np.isfinite([observation for observation, *_ in steps]).all()
    voltage = np.array([3.0, -10.0, 10.0, 0.0, 0.5])
    start = {"position": 0.01, "velocity": 0.02}
    fast, exact = (simulate(plant, voltage, 5e-3, start, method=method) for method in ("fast", "radau"))
    size = np.maximum(np.ptp(exact.states, axis=0), 0.01 * np.array([0.1, 0.1, 7e6, 7e6, 1, 100, 2.5, 7e6, 1e-3, 4e-5]))
    assert (np.abs(fast.states - exact.states).max(axis=0) / size).max() < 1e-4
