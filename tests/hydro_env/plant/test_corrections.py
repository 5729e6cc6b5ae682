"""Each correction of the printed equations (docs/model.md, Corrections): the printed form misses a known answer."""

import math

import numpy as np
import pytest

from hydro_env import PlantParameters, equilibrium, resistance_from_flow, simulate
from hydro_env.plant.arrays import derivative_array, plant_coefficients
from hydro_env.plant.parts.valve import edge_flows
from hydro_env.plant.states import STATE_NAMES, State
from paper.force_rate import force_rate_terms

PLANT = PlantParameters().replace(
    fluid={"air_fraction": 0.0}, valve={"underlap": 0.0, "transition_pressure": 1.0}, supply={"model": "constant"}
)
C = plant_coefficients(PLANT)
TANK = PLANT.supply.tank_pressure
RATED_DROP = PLANT.valve.rated_pressure_drop / 2


def at(**values):
    return State(**(dict.fromkeys(STATE_NAMES, 0.0) | {"supply_pressure": 70e5, "gas_volume": 1e-3} | values))


def test_rated_flow_counts_the_density_once():
    """(3) with (18): the valve's data sheet is the known answer."""
    flow = edge_flows(at(spool_position=1.0, pressure_a=70e5 - RATED_DROP), C)[0]
    assert flow == pytest.approx(PLANT.valve.rated_flow, rel=1e-9)


def test_flow_goes_with_the_root_of_the_pressure_drop():
    """(18) rows 3 and 4: half the drop gives 1/√2 of the flow; the printed difference gives half, and a wrong size."""
    flows = [edge_flows(at(spool_position=1.0, pressure_a=70e5 - drop), C)[0] for drop in (RATED_DROP, RATED_DROP / 2)]
    assert flows[1] / flows[0] == pytest.approx(math.sqrt(0.5), rel=1e-9)


def test_oil_leaves_chamber_a_on_the_other_side_of_the_spool():
    """(18) rows 3 and 4: with P_a = P_s the printed flow P→A vanishes; the oil flows to the tank."""
    _, a_to_tank, _, _ = edge_flows(at(spool_position=-1.0, pressure_a=70e5), C)
    assert a_to_tank == pytest.approx(C.edge_gain * math.sqrt(70e5 - TANK), rel=1e-9)


def test_chamber_b_shrinks_as_the_piston_extends():
    """(16), (18), (24): the oil shut in, V exp(P/β), stays only with V_b0 − A_b x."""
    plant = PLANT.replace(leakage={"internal_resistance": math.inf}, load={"spring_stiffness": 0.0})
    start = at(position=0.05, velocity=0.05, pressure_a=30e5, pressure_b=58.8e5)._asdict()
    run = simulate(plant, np.zeros(200), 0.25e-3, start)
    spread = {}
    for sign in (-1.0, 1.0):
        oil = (C.volume_b0 + sign * C.area_b * run.position) * np.exp(run.pressure_b / C.bulk_modulus)
        spread[sign] = np.ptp(oil) / (C.area_b * np.ptp(run.position))
    assert spread[-1.0] < 1e-4
    assert spread[1.0] > 1.0


def test_external_leakage_raises_the_force():
    """(16): dF/dt from the run itself decides the sign; with − it is missed."""
    plant = PLANT.replace(leakage={"internal_resistance": math.inf, "external_resistance": 1e11})
    run = simulate(plant, np.zeros(20), 1e-6, at(pressure_a=40e5, pressure_b=60e5)._asdict())
    terms = force_rate_terms(run)
    rate = np.gradient(run.load_force, run.time)[10]
    correct = sum(terms)[10]
    printed = correct - 2 * terms[3][10]
    assert correct == pytest.approx(rate, rel=1e-3)
    assert abs(printed - rate) > abs(rate)


def test_leakage_acts_at_standstill_and_lowers_chamber_b_outwards():
    """(21), (22): as a factor of dV/dt the leak would do nothing while the piston stands; + P_b/R_e would fill b."""
    plant = PLANT.replace(leakage={"internal_resistance": resistance_from_flow(1.0), "external_resistance": 5e12})
    c = plant_coefficients(plant)
    rate = State(*derivative_array(np.array(at(pressure_a=50e5, pressure_b=20e5)), np.array(c), 0.0))
    leak = 30e5 / resistance_from_flow(1.0)
    assert rate.pressure_a == pytest.approx(-c.bulk_modulus / c.volume_a0 * leak, rel=1e-9)
    out = 20e5 / 5e12
    assert rate.pressure_b == pytest.approx(c.bulk_modulus / c.volume_b0 * (leak - out), rel=1e-9)


def test_friction_belongs_to_the_steady_force():
    """(17) → (18): at steady speed the pressures carry damping and friction; without F_f the balance is open."""
    plant = PLANT.replace(load={"spring_stiffness": 0.0})
    run = simulate(plant, np.full(200, 2.0), 2.5e-3, {"position": -0.05})
    assert abs(run.acceleration[-1]) < 1e-2
    without = plant.load.viscous_damping * run.velocity[-1]
    assert run.load_force[-1] == pytest.approx(without + run.friction_force[-1], abs=1.0)
    assert run.load_force[-1] - without > 100.0


def test_bulk_modulus_is_a_pressure():
    """Printed in N/m: then β/V·Q would be no rate of pressure. Squeezing 1 % of the volume gives 1 % of β, in Pa."""
    assert type(PLANT.fluid).model_fields["bulk_modulus"].json_schema_extra["unit"] == "Pa"
    rate = State(*derivative_array(np.array(at(velocity=1.0)), np.array(C), 0.0))
    assert rate.pressure_b * 0.01 * C.volume_b0 / C.area_b == pytest.approx(0.01 * C.bulk_modulus, rel=1e-9)


def test_oil_leaks_from_b_to_a_at_rest():
    """Section 4: P_b = 1.96 P_a without load, so that P_a − P_b is not low, and the leak runs b → a."""
    plant = PLANT.replace(load={"spring_stiffness": 0.0}, leakage={"internal_resistance": resistance_from_flow(1.0)})
    state, _ = equilibrium(plant)
    assert state["pressure_b"] / state["pressure_a"] == pytest.approx(1.96, abs=0.005)
    run = simulate(plant, [0.0], 1e-5, state)
    assert run.leakage_flow[0] < -0.1e-3 / 60  # more than 0.1 l/min where the paper neglects it
