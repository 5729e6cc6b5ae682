"""What the paper could not show: maps, frequency response, holding, energy, sensitivity."""

import numpy as np
import pytest

from agents.reproduction.bode import FREQUENCIES, bode_table
from agents.reproduction.energy import energy_table
from agents.reproduction.holding import CONTROLLERS, TARGET, held_error
from agents.reproduction.maps import map_table
from agents.reproduction.rig import simplified, with_leak
from agents.reproduction.sensitivity import assumed_parameters, rubbing, sensitivity_table
from hydro_env import PlantParameters, equilibrium


def test_damping_grows_with_the_leak_everywhere():
    table = map_table(PlantParameters())
    grid = table.pivot(index="leak_lpm", columns="position_mm", values="damping_ratio")
    assert np.all(np.diff(grid.to_numpy(), axis=0) > 0.0)
    frequency = table.pivot(index="leak_lpm", columns="position_mm", values="natural_frequency_hz").iloc[0]
    assert -100.0 < frequency.idxmin() < 100.0  # stiffest near the ends


def test_the_slowest_response_is_that_of_the_balance():
    """At low frequency the gain is the slope of the position that a voltage holds."""
    table = bode_table(PlantParameters())
    part = table[table["leak_lpm"] == 4.0]
    plant = with_leak(simplified(PlantParameters(), False, True), 4.0, "laminar")
    (_, low), (_, high) = equilibrium(plant, 0.0195), equilibrium(plant, 0.0205)
    assert part["gain_mm_per_v"].iloc[0] == pytest.approx(1.0 / (high - low), rel=0.1)
    assert part["frequency_hz"].iloc[0] == pytest.approx(FREQUENCIES[0])
    peaks = table[table["frequency_hz"] > 40].groupby("leak_lpm")["gain_mm_per_v"].max()
    assert peaks.is_monotonic_decreasing


def test_the_integral_part_takes_the_error():
    plant = with_leak(PlantParameters(), 1.0, "throttle")
    proportional, command = held_error(plant, CONTROLLERS["P"])
    integral, _ = held_error(plant, CONTROLLERS["PI"])
    assert proportional > 1e-3
    assert command == pytest.approx(CONTROLLERS["P"].proportional * proportional, rel=0.05)
    assert abs(integral) < 0.1 * proportional
    _, needed = equilibrium(plant, TARGET - proportional)
    assert command == pytest.approx(needed, abs=0.15)


def test_a_leak_costs_energy():
    table = energy_table(PlantParameters())
    for _, part in table.groupby("law"):
        ordered = part.sort_values("leak_lpm")
        for column in ("holding_0_mm_w", "holding_40_mm_w", "cycle_j"):
            assert ordered[column].iloc[-1] > 1.1 * ordered[column].iloc[0]


def test_sensitivity_is_ranked_and_whole():
    base = PlantParameters()
    table = sensitivity_table(base)
    ranked = table[table["kind"] == "parameter"]
    assert set(ranked["name"]) == set(assumed_parameters(rubbing(base, 0.02)))
    assert len(ranked) > 20
    assert np.all(np.diff(ranked["effect_s"].dropna()) <= 0.0)
    damping = ranked.set_index("name").loc["load.viscous_damping"]
    assert damping["low_s"] > damping["normal_s"] > damping["high_s"]
    scan = table[table["kind"] == "friction"].pivot(index="value", columns="leak_lpm", values="normal_s")
    assert scan[0.01].is_monotonic_decreasing
    assert scan.loc[0.0, 0.01] > 3.0 * scan.loc[0.0, 1.0]
    assert scan.loc[1.0, 0.01] < 1.5 * scan.loc[1.0, 1.0]
