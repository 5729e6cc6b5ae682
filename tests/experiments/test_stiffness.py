"""Force on a held axis: against the static stiffness of the linearised loop, and its limits."""

import numpy as np
import pandas as pd
import pytest
from proportional import Proportional, exact_task

from hydro_agents.controllers.sampled_loop import sampled_loop
from hydro_agents.evaluation.stiffness import force_sine, force_step
from hydro_env import resistance_from_flow


def static_stiffness(task, leak, gain, place):
    plant = task.plant.replace(leakage={"internal_resistance": resistance_from_flow(leak)})
    return sampled_loop(plant, place, task.control_period, task.command_latency).static_stiffness(gain)


@pytest.mark.parametrize("leak", [1.0, 4.0])
def test_a_small_force_meets_the_static_stiffness_of_the_loop(leak):
    task, gain, force = exact_task(), 80.0, 2.0
    table = force_step(task, {"P": Proportional(gain, task)}, [leak], 1, force=force, place=0.02)
    stiffness = static_stiffness(task, leak, gain, 0.02)  # N/m
    assert table["static_mm_per_kn"].item() == pytest.approx(1e6 / stiffness, rel=0.02)
    assert table["peak_mm"].item() >= table["remaining_mm"].item()
    slow = force_sine(task, {"P": Proportional(gain, task)}, [leak], 1, [0.05], force=force, place=0.02)
    assert slow["compliance_mm_per_kn"].item() == pytest.approx(1e6 / stiffness, rel=0.05)


def test_a_leak_makes_the_loop_soft_and_gain_makes_it_stiff():
    task = exact_task()
    controllers = {str(gain): Proportional(gain, task) for gain in (40.0, 80.0)}
    table = force_step(task, controllers, [0.3, 4.0], 1, force=2.0, place=0.02)
    soft = table.set_index(["controller", "leakage_flow_lpm"])["static_mm_per_kn"]
    assert soft["40.0", 4.0] > 3.0 * soft["40.0", 0.3]
    assert soft["40.0", 4.0] == pytest.approx(2.0 * soft["80.0", 4.0], rel=0.1)
    assert (table["recovery_s"] < 1.5).all()


def test_deviations_are_counted_from_the_rest_before_the_force():
    task = exact_task()
    table = force_step(task, {"P": Proportional(40.0, task)}, [1.0], 2, force=1e-9, place=0.02)
    assert (table["peak_mm"] < 1e-3).all()
    assert np.isfinite(table["recovery_s"]).all()


def test_forces_and_leaks_that_the_task_changes_by_itself_do_not_count():
    plain = exact_task()
    busy = exact_task(leakage={"schedule": "growth"}, disturbance={"kind": "mixed", "force_share": (0.3, 0.5)})
    tables = [
        force_step(task, {"P": Proportional(40.0, task)}, [1.0], 1, force=2.0, place=0.02) for task in (plain, busy)
    ]
    pd.testing.assert_frame_equal(*tables)
