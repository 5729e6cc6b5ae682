"""What the paper could not show: maps, frequency response, holding, energy, sensitivity."""

import math

import numpy as np
import pandas as pd
import pytest

from hydro_env import PlantParameters, equilibrium, simulate
from paper.frequency import LOWEST, bode_table, map_table
from paper.holding import controllers, energy_table, held_error
from paper.results import RESULTS, setting_of
from paper.rig import Rig, own_rig, simplified, with_leak
from paper.settling import friction_scan_table
from paper.variations import unused_parameters


def test_damping_grows_with_the_leak_everywhere():
    table = map_table(Rig())
    grid = table.pivot(index="leak_lpm", columns="position_mm", values="damping_ratio")
    assert np.all(np.diff(grid.to_numpy(), axis=0) > 0.0)
    frequency = table.pivot(index="leak_lpm", columns="position_mm", values="natural_frequency_hz").iloc[0]
    assert -100.0 < frequency.idxmin() < 100.0  # stiffest near the ends


def test_the_slowest_response_is_that_of_the_balance():
    """At low frequency the gain is the slope of the position that a voltage holds."""
    table = bode_table(Rig())
    part = table[table["leak_lpm"] == 4.0]
    plant = with_leak(simplified(PlantParameters(), "none", True), 4.0, "laminar")
    (_, low), (_, high) = equilibrium(plant, 0.0195), equilibrium(plant, 0.0205)
    assert part["gain_mm_per_v"].iloc[0] == pytest.approx(1.0 / (high - low), rel=0.1)
    assert part["frequency_hz"].iloc[0] == pytest.approx(LOWEST)
    peaks = table[table["frequency_hz"] > 40].groupby("leak_lpm")["gain_mm_per_v"].max()
    assert peaks.is_monotonic_decreasing


def test_the_integral_part_takes_the_error():
    plant = with_leak(PlantParameters(), 1.0, "throttle")
    gains, target = controllers(Rig()), Rig().hold
    proportional, command = held_error(plant, gains["P"], target)
    integral, _ = held_error(plant, gains["PI"], target)
    assert proportional > 1e-3
    assert command == pytest.approx(gains["P"].proportional * proportional, rel=0.05)
    assert abs(integral) < 0.1 * proportional
    _, needed = equilibrium(plant, target - proportional)
    assert command == pytest.approx(needed, abs=0.15)


def test_a_leak_costs_energy():
    table = energy_table(Rig())
    for _, part in table.groupby("law"):
        ordered = part.sort_values("leak_lpm")
        for column in ("holding_first_w", "holding_second_w", "cycle_j"):
            assert ordered[column].iloc[-1] > 1.1 * ordered[column].iloc[0]


@pytest.fixture(scope="module")
def sensitivity(folder):
    return pd.read_csv(folder / "sensitivity.csv")


def test_every_assumed_parameter_is_ranked_for_every_result(sensitivity):
    names = {
        f"{group}.{field}"
        for group, settings in PlantParameters.model_fields.items()
        for field, details in settings.annotation.model_fields.items()
        if details.description.startswith("assumed")
    }
    unused = {"friction.bristle_stiffness", "friction.bristle_damping", "supply.line_volume"}
    assert set(unused_parameters(Rig())) == unused
    names -= unused
    assert len(names) >= 29
    assert set(sensitivity["result"]) == {result.name for result in RESULTS if not result.name.startswith("settling")}
    for _, part in sensitivity.groupby("result"):
        assert set(part["parameter"]) == names
        assert np.all(np.diff(part.sort_values("rank")["effect_percent"].dropna()) <= 0.0)
        assert part["effect_percent"].max() > 1.0


def test_effects_with_known_answers(sensitivity):
    rows = sensitivity.set_index(["result", "parameter"])
    mass = rows.loc[("natural_frequency_hz", "cylinder.piston_mass")]  # 3 of 63 kg
    assert mass["at_low"] / mass["normal"] == pytest.approx(math.sqrt(63.0 / 62.4), rel=1e-3)
    for name in ("valve.amplifier_gain", "valve.spool_gain"):
        gain = rows.loc[("gain_limit_per_m", name)]  # a factor of the loop gain like any other
        assert gain["at_low"] / gain["normal"] == pytest.approx(1 / 0.8, rel=1e-6)
        assert gain["at_high"] / gain["normal"] == pytest.approx(1 / 1.2, rel=1e-6)
    settling, at = next(result for result in RESULTS if result.name == "settling_s"), setting_of(Rig())
    damped = (
        settling.compute(PlantParameters().replace(load={"viscous_damping": factor * 300.0}), at, 1.0)
        for factor in (0.8, 1.2)
    )
    assert next(damped) > settling.compute(PlantParameters(), at, 1.0) > next(damped)


def test_the_held_error_is_that_of_the_simulated_loop(sensitivity):
    plant = with_leak(simplified(PlantParameters(), "none", True), 1.0, "throttle")
    error, _ = held_error(plant, controllers(Rig())["P"], Rig().hold)
    assert sensitivity.query("result == 'held_error_mm'")["normal"].iloc[0] == pytest.approx(1e3 * error, rel=0.01)


def test_friction_hides_the_trend_little_by_little():
    table = friction_scan_table(Rig(), (0.01, 1.0), (0.0, 0.02, 0.2, 1.0))
    scan = table.pivot(index="friction_share", columns="leak_lpm", values="settling_s")
    assert scan[0.01].is_monotonic_decreasing
    assert scan.loc[0.0, 0.01] > 3.0 * scan.loc[0.0, 1.0]
    assert scan.loc[1.0, 0.01] < 1.5 * scan.loc[1.0, 1.0]


@pytest.mark.parametrize(
    ("changes", "unused"),
    [
        ({"valve": {"model": "ideal"}}, {"valve.coil_inductance", "valve.natural_frequency", "valve.slew_limit"}),
        ({"friction": {"model": "lugre"}}, {"friction.transition_velocity", "supply.line_volume"}),
        ({"supply": {"model": "pump"}}, {"supply.precharge_pressure", "supply.polytropic_index"}),
    ],
)
def test_parameters_that_are_not_used_change_nothing(changes, unused):
    plant = PlantParameters().replace(**changes)
    assert unused <= set(unused_parameters(own_rig(plant, "changed")))
    voltage, start = np.repeat([5.0, -5.0], 20), {"position": 0.0}
    run = simulate(plant, voltage, 1e-3, start)
    for path in unused:
        group, name = path.split(".")
        value = getattr(getattr(plant, group), name)
        moved = simulate(plant.replace(**{group: {name: 0.8 * value}}), voltage, 1e-3, start)
        assert abs(moved.position - run.position).max() < 1e-8
