"""The known answers of the model: closed forms, published values, conservation laws, a second solver."""

import math

import numpy as np
import pytest

from hydro_env import PlantParameters, equilibrium, simulate
from hydro_env.errors import HydroError, InvalidStateError
from hydro_env.plant.analysis import closed_port_natural_frequency, closed_port_stiffness, reachable_range, speed_limits
from hydro_env.plant.linearisation import linearise
from hydro_env.plant.states import STATE_NAMES

CLOSED_VALVE = {"underlap": 0.0}
TIGHT = {"internal_resistance": math.inf}
NO_FRICTION = {"model": "none"}
PURE_OIL = {"air_fraction": 0.0}
CONSTANT_SUPPLY = {"model": "constant", "tank_pressure": 0.0}


def double_rod_cylinder() -> PlantParameters:
    """The published closed-port cylinder: A = 20.44 cm², β = 0.981 GPa, V = 106.3 cm³ a side, 1000 kg."""
    area, volume, stroke = 20.44e-4, 106.3e-6, 0.09
    return PlantParameters().replace(
        cylinder={
            "bore_diameter": math.sqrt(4 * area / math.pi),
            "rod_diameter": 0.0,
            "stroke": stroke,
            "dead_volume": volume - area * stroke / 2,
            "piston_mass": 0.0,
        },
        valve=CLOSED_VALVE,
        fluid={"bulk_modulus": 0.981e9, **PURE_OIL},
        load={"mass": 1000.0, "spring_stiffness": 0.0, "viscous_damping": 0.0},
        friction=NO_FRICTION,
        leakage=TIGHT,
    )


def test_closed_port_natural_frequency_and_oscillation_are_the_published_ones():
    parameters = double_rod_cylinder()
    assert closed_port_stiffness(parameters) == pytest.approx(77.1e6, rel=1e-3)  # 2 β A² / V
    assert closed_port_natural_frequency(parameters) == pytest.approx(277.7, abs=0.1)
    assert linearise(parameters, voltage=0.0).hydraulic_mode.natural_frequency == pytest.approx(277.7, abs=0.1)
    run = simulate(parameters, np.zeros(4000), 0.25e-3, {"velocity": 0.01})
    rising = np.flatnonzero((run.velocity[:-1] < 0) & (run.velocity[1:] >= 0))
    crossing = run.time[rising] - run.velocity[rising] * 0.25e-3 / (run.velocity[rising + 1] - run.velocity[rising])
    assert 2 * np.pi / np.diff(crossing).mean() == pytest.approx(277.7, rel=1e-3)
    assert np.abs(run.velocity[-400:]).max() == pytest.approx(0.01, rel=1e-2)  # nothing damps it


@pytest.mark.parametrize(
    ("voltage", "speed", "bar_a", "bar_b"), [(10.0, 0.176, 8.2, 16.1), (-10.0, -0.126, 31.5, 61.8)]
)
def test_no_load_speed_and_pressures(voltage, speed, bar_a, bar_b):
    parameters = PlantParameters().replace(
        valve=CLOSED_VALVE,
        supply=CONSTANT_SUPPLY,
        friction=NO_FRICTION,
        load={"spring_stiffness": 0.0, "viscous_damping": 0.0},
        leakage=TIGHT,
    )
    run = simulate(parameters, np.full(120, voltage), 5e-3, {"position": -0.08 * np.sign(voltage)})
    assert run.velocity[-1] == pytest.approx(speed, abs=5e-4)
    assert run.pressure_a[-1] / 1e5 == pytest.approx(bar_a, abs=0.1)
    assert run.pressure_b[-1] / 1e5 == pytest.approx(bar_b, abs=0.1)
    limits = speed_limits(parameters)
    assert abs(run.velocity[-1]) == pytest.approx(limits.extending if voltage > 0 else limits.retracting, rel=1e-3)


def no_load_speed(voltage, **valve):
    """Mean speed of a frictionless piston that carries nothing, from 0.5 to 0.75 s."""
    parameters = PlantParameters().replace(
        valve={"underlap": 0.0, **valve},
        load={"mass": 1.0, "spring_stiffness": 0.0, "viscous_damping": 0.0},
        friction=NO_FRICTION,
        supply=CONSTANT_SUPPLY,
        leakage=TIGHT,
    )
    run = simulate(parameters, np.full(150, voltage), 5e-3, {"position": 0.0})
    return (run.position[-1] - run.position[-51]) / 0.25, parameters


@pytest.mark.parametrize(
    ("voltage", "edges", "share"),
    [
        (0.9, {"overlap": 0.1}, 0.0),  # a dead band that keeps the rated flow
        (5.5, {"overlap": 0.1}, 0.5),
        (10.0, {"overlap": 0.1}, 1.0),
        (4.0, {"knee_position": 0.4, "knee_opening": 0.1}, 0.1),
        (7.0, {"knee_position": 0.4, "knee_opening": 0.1}, 0.55),
        (-10.0, {"knee_position": 0.4, "knee_opening": 0.1}, 1.0),
    ],
)
def test_overlap_and_knee_bend_the_flow_curve(voltage, edges, share):
    full, _ = no_load_speed(math.copysign(10.0, voltage))
    assert no_load_speed(voltage, **edges)[0] == pytest.approx(share * full, rel=1e-3, abs=1e-6)


def test_a_spool_cut_to_the_areas_keeps_the_pressures_at_a_reversal():
    """Edges in the ratio of the areas: p_a + p_b = P_s and p_a A_a = p_b A_b in both directions.

    Equal edges need p_a = P_s A_b³/(A_a³ + A_b³) to extend and P_s A_a² A_b/(A_a³ + A_b³) to retract.
    """
    area_a, area_b = 0.25 * math.pi * 0.040**2, 0.25 * math.pi * (0.040**2 - 0.028**2)
    cubes = area_a**3 + area_b**3
    matched = 70e5 * area_b / (area_a + area_b)
    equal = (70e5 * area_b**3 / cubes, 70e5 * area_a**2 * area_b / cubes)
    speeds = []
    for ratio, expected in ((area_b / area_a, (matched, matched)), (1.0, equal)):
        parameters = PlantParameters().replace(
            valve={"underlap": 0.0, "edge_ratio": ratio, "transition_pressure": 1e3},
            load={"mass": 1.0, "spring_stiffness": 0.0, "viscous_damping": 0.0},
            friction=NO_FRICTION,
            supply={**CONSTANT_SUPPLY, "pressure": 70e5},
            leakage=TIGHT,
        )
        for voltage, pressure in zip((5.0, -5.0), expected, strict=True):
            run = simulate(parameters, np.full(100, voltage), 5e-3, {"position": 0.0})
            assert run.pressure_a[-1] == pytest.approx(pressure, rel=1e-3)
            speeds.append(abs(run.velocity[-1]))
    root = math.sqrt(area_a / area_b)
    assert speeds[0] == pytest.approx(root * speeds[1], rel=1e-3)
    assert speeds[2] == pytest.approx(root * speeds[3], rel=1e-3)


def test_reachable_range_is_where_equilibria_end():
    low, high = reachable_range(PlantParameters())
    assert (low, high) == pytest.approx((-0.0490, 0.0981), abs=5e-4)
    equilibrium(PlantParameters(), 0.95 * high)
    with pytest.raises(HydroError, match="cannot be held"):
        equilibrium(PlantParameters(), 1.15 * high)


def test_state_outside_the_valid_range_is_named():
    parameters = PlantParameters().replace(
        supply={"accumulator_volume": 2e-6, "pump_flow": 0.0, "precharge_pressure": 69e5},
        valve={"underlap": 0.0},
        leakage=TIGHT,
    )
    start = {
        **dict.fromkeys(STATE_NAMES, 0.0),
        "pressure_a": 20e5,
        "pressure_b": 39.2e5,
        "supply_pressure": 70e5,
        "gas_volume": 2e-6,
    }
    with pytest.raises(InvalidStateError, match=r"gas_volume left its valid range at t = .* s: .* m³, allowed"):
        simulate(parameters, np.full(200, 10.0), 5e-3, start)
