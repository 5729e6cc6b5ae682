"""Parts that an axis may lack: lines with waves, a second mass, sharp edges; against closed forms and the reference."""

import math

import numpy as np
import pytest

from hydro_env import (
    ConfigurationError,
    PlantParameters,
    ServoHydraulicEnv,
    ServoHydraulicVectorEnv,
    TaskConfig,
    equilibrium,
    linearise,
    simulate,
)
from hydro_env.plant.analysis import closed_port_stiffness
from hydro_env.plant.arrays import plant_coefficients
from hydro_env.plant.equations import Coefficients
from hydro_env.plant.parts.valve import edge_openings

LINES = {"lines": {"volume_a": 1e-4, "volume_b": 1e-4, "length_a": 2.0, "length_b": 2.0, "wall_bulk_modulus": 1e9}}
TIP = {"load": {"tip_share": 0.6, "tip_frequency": 2 * math.pi * 6.0, "tip_damping_ratio": 0.01}}
SHARP = {"valve": {"underlap": 0.0, "overlap": -0.0075}}
STRUCTURES = {"lines": LINES, "tip": TIP, "sharp": SHARP, "all": LINES | TIP | SHARP}
STILL = {"friction": {"model": "none"}, "supply": {"model": "constant"}, "leakage": {"internal_resistance": math.inf}}


def rig_with(**groups):
    plant = PlantParameters()
    for group, fields in groups.items():
        plant = plant.replace(**{group: fields})
    return plant


@pytest.mark.parametrize("length", [0.5, 2.0, 6.0])
def test_first_wave_of_a_line_has_the_frequency_and_damping_of_the_closed_form(length):
    volume, viscosity = 5e-5 * length, 46e-6
    oil = {"bulk_modulus": 1.2e9, "air_fraction": 0.0, "kinematic_viscosity": viscosity}
    lines = {"volume_a": volume, "volume_b": volume, "length_a": length, "length_b": length}
    # Closed at a valve without leakage, open at a chamber too large to feel it.
    plant = rig_with(lines=lines, fluid=oil, cylinder={"dead_volume": 0.1}, valve={"underlap": 0.0}, **STILL)
    speed = math.sqrt(1.2e9 / plant.fluid.density)
    first = min(mode for mode in linearise(plant).modes if mode.state.startswith("line_"))
    assert first.natural_frequency / (2 * math.pi) == pytest.approx(speed / (4 * length), rel=0.02)
    omega = math.pi * speed / (2 * length)
    damping = math.sqrt(viscosity / (2 * omega)) / math.sqrt(5e-5 / math.pi)
    assert first.damping_ratio == pytest.approx(damping, rel=0.03)


def test_two_masses_have_the_eigenvalues_of_the_textbook():
    load = {"mass": 400.0, "tip_share": 0.7, "tip_frequency": 40.0, "tip_damping_ratio": 0.0, "viscous_damping": 0.0}
    plant = rig_with(load=load, fluid={"air_fraction": 0.0}, valve={"underlap": 0.0}, **STILL)
    behind, ahead = 0.7 * 400.0, 0.3 * 400.0 + plant.cylinder.piston_mass
    spring, oil = behind * 40.0**2, closed_port_stiffness(plant)
    stiffness = np.array([[(oil + spring) / ahead, -spring / ahead], [-spring / behind, spring / behind]])
    expected = np.sqrt(np.sort(np.linalg.eigvals(stiffness)))
    found = [mode.natural_frequency for mode in linearise(plant).modes]
    np.testing.assert_allclose(found, expected, rtol=1e-3)


def test_a_sharp_underlap_opens_all_edges_as_the_textbook_says():
    lap = 0.0075
    c = plant_coefficients(rig_with(valve={"underlap": 0.0, "overlap": -lap}))
    for spool in (-0.02, -lap, -0.003, 0.0, 0.005, 0.1):
        wanted = [max(spool + lap, 0.0) / (1 + lap), max(-spool + lap, 0.0) / (1 + lap)]
        np.testing.assert_allclose(edge_openings(spool, Coefficients(*c)), wanted, atol=1e-15)


EACH = [pytest.param(name, marks=() if name == "all" else pytest.mark.slow) for name in STRUCTURES]


@pytest.mark.parametrize("name", EACH)
def test_an_axis_at_rest_stays_at_rest(name):
    plant = rig_with(**STRUCTURES[name]).replace(leakage={"internal_resistance": 3e11})
    start, voltage = equilibrium(plant, 0.02)
    run = simulate(plant, np.full(40, voltage), 5e-3, start)
    assert run.state_names == tuple(start)
    assert np.abs(run.position - 0.02).max() < 1e-8
    assert np.ptp(run.pressure_a) < 100.0


@pytest.mark.parametrize("name", EACH)
def test_both_solvers_agree(name):
    plant = rig_with(**STRUCTURES[name])
    voltage = np.repeat([4.0, -9.0, 0.5, -0.5, 0.05], 4)
    fast, exact = (simulate(plant, voltage, 5e-3, method=method).states for method in ("fast", "radau"))
    error = np.abs(fast - exact).max(axis=0) / np.maximum(np.ptp(exact, axis=0), 1e-9)
    assert error.max() < 1e-4


def test_axes_of_several_structures_move_as_each_does_alone():
    law = {"count": 6, "split": "validation", "structure": {"tip_share": 0.5}}
    task = TaskConfig(law=law, episode_duration=0.1)
    together = ServoHydraulicVectorEnv(6, task)
    numbers = list(range(6))
    seen, _ = together.reset(seed=numbers, options={"rig": np.arange(6)})
    assert len({rig.plant.structure for rig in together.rigs}) == 2
    alone = ServoHydraulicEnv(task)
    own = [alone.reset(seed=number, options={"rig": number})[0] for number in numbers]
    np.testing.assert_array_equal(seen, own)
    for number in numbers:
        together.reset(seed=numbers, options={"rig": np.arange(6)})
        alone.reset(seed=number, options={"rig": number})
        for _ in range(10):
            seen, *_, info = together.step(np.full((6, 1), 0.2))
            observation, *_, one = alone.step([0.2])
            np.testing.assert_array_equal(seen[number], observation)
        assert info["tip_position"][number] == one["tip_position"]


def test_pressure_sensors_at_the_valve_read_the_valve():
    plant = rig_with(**LINES)
    read = {}
    for place in ("cylinder", "valve"):
        env = ServoHydraulicEnv(plant=plant.model_dump(), sensors={"pressures_at": place}, randomisation={})
        env.reset(seed=1)
        column = env.observation_names.index("pressure_a")
        read[place] = np.array([env.step([0.5])[0][column] for _ in range(20)])
    assert np.abs(read["valve"] - read["cylinder"]).max() > 0.02  # bar over 50 bar: the wave is seen there


def test_no_episode_adds_a_second_mass():
    with pytest.raises(ConfigurationError, match="tip_share"):
        ServoHydraulicEnv().reset(options={"parameters": {"load": {"tip_share": 0.3}}})
    with pytest.raises(ConfigurationError, match="give both"):
        PlantParameters().replace(lines={"volume_a": 1e-4, "length_a": 1.0})
