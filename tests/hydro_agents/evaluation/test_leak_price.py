"""The cost of a leak at steady state, against the flow law and the forces of full pressure."""

import numpy as np
import pytest

from hydro_agents.evaluation import leak_price as module
from hydro_agents.evaluation.leak_price import full_command_speed, leak_price, stall_force
from hydro_env import TaskConfig, resistance_from_flow
from hydro_env.plant.analysis import full_pressure_forces, speed_limits
from hydro_env.plant.arrays import plant_coefficients

TIGHT = TaskConfig().plant.replace(leakage={"internal_resistance": np.inf}, valve={"underlap": 0.0})


@pytest.mark.parametrize("force", [-2000.0, 0.0, 3000.0])
def test_a_tight_seal_gives_the_speed_of_the_flow_law_and_stalls_at_the_force_of_full_pressure(force):
    speeds, forces = speed_limits(TIGHT, force), full_pressure_forces(TIGHT)
    for sign, speed, stall in ((1.0, speeds.extending, forces.extending), (-1.0, speeds.retracting, forces.retracting)):
        assert sign * full_command_speed(TIGHT, sign, force) == pytest.approx(speed, rel=5e-3)
        assert stall_force(TIGHT, sign) == pytest.approx(stall, rel=1e-3)


def test_the_speed_lost_is_about_the_leak_over_the_area():
    """Against a load, v falls by less than the largest leak over the smaller area; helped by one, it rises."""
    leaking = TIGHT.replace(leakage={"internal_resistance": resistance_from_flow(4.0)})
    lost, gained = (
        full_command_speed(TIGHT, 1.0, force) - full_command_speed(leaking, 1.0, force) for force in (3000.0, -3000.0)
    )
    assert gained < 0.0 < lost < 70e5 / resistance_from_flow(4.0) / plant_coefficients(leaking).area_b


@pytest.mark.parametrize("law", ["laminar", "orifice"])
def test_every_price_rises_with_the_leak(law):
    table = leak_price(TaskConfig(leakage={"law": law}), [0.01, 1.0, 4.0, 8.0])
    assert (np.diff(table["holding_power_w"]) > 0.0).all()
    assert (np.diff(table["holding_command"]) > 0.0).all()
    for name in ("speed_out_mm_s", "speed_back_mm_s", "force_out_n", "force_back_n"):
        assert (np.diff(table[name]) < 0.0).all(), name


def test_a_place_that_a_leak_makes_impossible_has_no_price(monkeypatch):
    monkeypatch.setattr(module, "working_place", lambda plant: 0.097)
    row = leak_price(TaskConfig(), [20.0]).iloc[0]
    assert np.isnan(row["holding_power_w"])
    assert row["speed_out_mm_s"] == 0.0
