"""Oil and energy: neither comes from nowhere, for any plant, start and input.

With a constant bulk modulus the model carries oil at the density of the chamber: V exp(P/β) is conserved but for flow,
and U = β V (exp(P/β) − 1) − P V is its energy: dU = −P dV + h(P) Q dt with h(P) = β (exp(P/β) − 1), which rises with P.
Both hold exactly in the continuous model as long as no chamber cavitates: a void counts no oil.

The examples are not the same on every machine: Hypothesis also takes constants from the modules of the project that
happen to be loaded. So each property must hold for whatever case is drawn, and excludes what it does not cover.
"""

import numpy as np
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from hydro_env import PlantParameters, resistance_from_flow, simulate

SAMPLE_TIME = 0.25e-3


@st.composite
def cases(draw, underlap):
    real = st.floats
    parameters = PlantParameters().replace(
        valve={"underlap": underlap},
        fluid={"air_fraction": 0.0, "bulk_modulus": draw(real(1.0e9, 1.5e9))},
        load={"mass": draw(real(40.0, 80.0)), "viscous_damping": draw(real(100.0, 800.0))},
        supply={"model": "constant"},
        leakage={
            "internal_resistance": resistance_from_flow(draw(real(0.003, 4.0))),
            "orifice_gain": draw(st.sampled_from([0.0, 1e-9, 1e-8])),
        },
    )
    position, pressure_b = draw(real(-0.02, 0.04)), draw(real(40e5, 50e5))
    bore, rod = parameters.cylinder.bore_diameter, parameters.cylinder.rod_diameter
    held = parameters.load.spring_stiffness * position / (np.pi / 4 * bore**2) + pressure_b * (1 - (rod / bore) ** 2)
    start = {  # near the balance of forces: a chamber that cavitates holds a void, and its pressure counts no oil
        "position": position,
        "velocity": draw(real(-0.02, 0.02)),
        "pressure_a": held + draw(real(-3e5, 3e5)),
        "pressure_b": pressure_b,
        "supply_pressure": 70e5,
        "gas_volume": 1e-3,
        **dict.fromkeys(("spool_position", "spool_velocity", "coil_current"), 0.0),
    }
    return parameters, start


def volumes(run):
    c = run.parameters.cylinder
    area_a = np.pi / 4 * c.bore_diameter**2
    area_b = area_a - np.pi / 4 * c.rod_diameter**2
    return (
        c.dead_volume + area_a * (c.stroke / 2 + run.position),
        c.dead_volume + area_b * (c.stroke / 2 - run.position),
    )


def run_without_cavitation(case, voltages):
    """The run of a case; Hypothesis draws another case where a chamber falls to a gauge pressure of zero."""
    parameters, start = case
    run = simulate(parameters, voltages, SAMPLE_TIME, start)
    assume(min(run.pressure_a.min(), run.pressure_b.min()) > 0.0)
    return run


def gained(rate):
    return np.concatenate([[0.0], np.cumsum(0.5 * (rate[1:] + rate[:-1]) * SAMPLE_TIME)])


def energy(run):
    """J; kinetic, spring, and compression of the oil."""
    load, beta = run.parameters.load, run.parameters.fluid.bulk_modulus
    mass = load.mass + run.parameters.cylinder.piston_mass
    total = 0.5 * mass * run.velocity**2 + 0.5 * load.spring_stiffness * run.position**2
    for volume, pressure in zip(volumes(run), (run.pressure_a, run.pressure_b), strict=True):
        total = total + beta * volume * np.expm1(pressure / beta) - pressure * volume
    return total


def head(run, pressure):
    beta = run.parameters.fluid.bulk_modulus
    return beta * np.expm1(pressure / beta)


def assert_oil_is_conserved(run, into_a, into_b, tolerance):
    """The integrals of the flows into the chambers (m³/s) are the oil that these gained."""
    beta = run.parameters.fluid.bulk_modulus
    rows = zip(volumes(run), (run.pressure_a, run.pressure_b), (into_a, into_b), strict=True)
    for volume, pressure, flow in rows:
        oil = volume * np.exp(pressure / beta)
        error = np.abs(oil - oil[0] - gained(flow * np.exp(pressure / beta))).max()
        assert error < tolerance * (np.ptp(volume) + np.abs(flow).sum() * SAMPLE_TIME) + 1e-12 * volume.max()


@settings(max_examples=10, deadline=None, derandomize=True)
@given(cases(underlap=0.0))
def test_a_closed_valve_with_a_leak_conserves_oil(case):
    run = run_without_cavitation(case, np.zeros(400))
    assert_oil_is_conserved(run, -run.leakage_flow, run.leakage_flow, 1e-3)


@settings(max_examples=10, deadline=None, derandomize=True)
@given(cases(underlap=0.0))
def test_a_closed_valve_only_loses_energy(case):
    run = run_without_cavitation(case, np.zeros(400))
    stored = energy(run)
    lost = (
        run.leakage_flow * (head(run, run.pressure_a) - head(run, run.pressure_b))
        + run.parameters.load.viscous_damping * run.velocity**2
        + run.friction_force * run.velocity
    )
    assert (lost >= 0.0).all()
    assert np.diff(stored).max() < 1e-6 * stored.max()
    moved = stored[0] - stored[-1]
    assert np.abs(stored[0] - stored - gained(lost)).max() < 0.02 * moved + 1e-6 * stored.max()


@settings(max_examples=10, deadline=None, derandomize=True)
@given(cases(underlap=0.015), st.lists(st.floats(-10, 10), min_size=4, max_size=4))
def test_the_supply_is_the_only_source_of_energy_and_oil(case, levels):
    run = run_without_cavitation(case, np.repeat(levels, 100))
    returned = run.supply_flow - run.flow_a + run.flow_b
    work = gained(
        run.supply_flow * head(run, run.supply_pressure) - returned * head(run, run.parameters.supply.tank_pressure)
    )
    brought = energy(run) - energy(run)[0]
    assert (brought <= work + 2e-3 * np.abs(work).max() + 1e-6 * energy(run).max()).all()
    assert_oil_is_conserved(run, run.flow_a - run.leakage_flow, run.leakage_flow - run.flow_b, 5e-3)
