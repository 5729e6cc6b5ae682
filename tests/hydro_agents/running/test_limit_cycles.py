"""Limit cycles are found, counted and named; an evaluation never takes a controller in one for a good baseline."""

import numpy as np
import pandas as pd
import pytest
from proportional import Relay

from hydro_agents.controllers.registry import make_controller
from hydro_agents.evaluation.evaluate import evaluate
from hydro_agents.running.cases import Cases, run_cases
from hydro_agents.running.limit_cycles import (
    comes_to_rest,
    counted,
    find_limit_cycle,
    rest_warning,
    standstill_metrics,
    standstill_task,
)
from hydro_agents.running.seeds import EVALUATION, VALIDATION_SEEDS
from hydro_env import REFERENCE_FAMILIES, TaskConfig

CONFIG = TaskConfig(episode_duration=0.4)
SIZE = {"plants": 3, "leak_levels": (4.0, 0.03, 1.0), "families": ("step",), "standstill_plants": 2}
WILD = make_controller("pid", CONFIG, {"proportional": 1500.0})


PERIOD = 0.005
TIME = PERIOD * np.arange(300)
FLOOR = 15e-6
WAVE = np.sin(2.0 * np.pi * 12.0 * TIME)


def test_a_lasting_sine_is_found_with_amplitude_and_frequency():
    noise = np.random.default_rng(0).normal(scale=5e-6, size=len(TIME))
    cycle = find_limit_cycle(0.03 + 50e-6 * WAVE + noise + 1e-4 * TIME, PERIOD, FLOOR)
    assert cycle.sustained
    assert cycle.amplitude == pytest.approx(50e-6, rel=0.05)
    assert cycle.frequency == pytest.approx(12.0, abs=0.4)


@pytest.mark.parametrize(
    "motion",
    [
        np.zeros(len(TIME)),
        10e-6 * WAVE,  # below the floor
        100e-6 * WAVE * np.exp(-4.0 * TIME),  # dying out
        200e-6 * TIME,  # drift
        100e-6 * np.sin(2.0 * np.pi * 0.5 * TIME),  # slower than three cycles
        np.random.default_rng(1).normal(scale=5e-6, size=len(TIME)),
    ],
)
def test_what_comes_to_rest_is_none(motion):
    assert not find_limit_cycle(motion, PERIOD, FLOOR).sustained


def test_a_relay_on_the_plant_oscillates_and_a_weak_loop_does_not():
    config = TaskConfig()
    first = VALIDATION_SEEDS.start
    cases = Cases(np.arange(first, first + 3), np.array([0.03, 1.0, 4.0]), None)
    still = standstill_task(config)
    weak = make_controller("pid", config, {"proportional": 10.0, "integral": 1.0})
    found = {}
    for name, controller in {"relay": Relay(0.3, config), "weak": weak}.items():
        found[name] = standstill_metrics(run_cases(still, controller, cases), still)
    assert found["relay"]["limit_cycle"].tolist() == [1.0] * 3
    assert np.all(found["relay"]["frequency_hz"] > 3.0)
    assert np.all(found["relay"]["amplitude_um"] > 100.0)
    assert found["weak"]["limit_cycle"].tolist() == [0.0] * 3
    assert np.isnan(found["weak"]["frequency_hz"]).all()
    assert np.all(found["weak"]["failed"] == 0.0)


def standstills(amplitudes, failed=0, count=16):
    """``count`` standstills, of which the first have a limit cycle of these amplitudes in µm."""
    number, cycles = np.arange(count), len(amplitudes)
    columns = {"limit_cycle": number < cycles, "amplitude_um": [*amplitudes, *[2.0] * (count - cycles)]}
    columns |= {"frequency_hz": np.where(number < cycles, 5.0 + number, np.nan), "failed": number >= count - failed}
    return pd.DataFrame(columns)


def test_standstills_are_counted_with_the_largest_limit_cycle():
    expected = {"limit_cycles": 3, "standstills": 16, "failures": 2, "largest_amplitude_um": 90.0, "frequency_hz": 6.0}
    assert counted(standstills([20.0, 90.0, 30.0], failed=2)) == expected
    none = counted(standstills([]))
    assert (none["limit_cycles"], none["largest_amplitude_um"]) == (0, 0.0)
    assert np.isnan(none["frequency_hz"])
    assert comes_to_rest(none)
    assert rest_warning("PID", none, baseline=True) == ""
    assert not comes_to_rest(counted(standstills([], failed=1)))


def test_an_evaluation_finds_the_limit_cycles_of_a_high_gain_and_none_of_flow_linearisation():
    result = evaluate(CONFIG, {"PID": WILD, "calm": "flow_linearising"}, settings=SIZE)
    cases = result.table("limit_cycles")
    assert set(cases["leakage_flow_lpm"]) == {0.03, 4.0}  # the smallest and the largest leak
    assert set(cases["seed"]) == set(EVALUATION.of_family(REFERENCE_FAMILIES.index("user"), np.arange(2)))
    assert len(cases) == 2 * 2 * 2
    wild, calm = result.table("limit_cycle_summary").to_dict("records")
    assert (wild["controller"], wild["limit_cycles"], wild["standstills"]) == ("PID", 4, 4)
    assert wild["largest_amplitude_um"] > 500.0
    assert (calm["controller"], calm["limit_cycles"], calm["standstills"]) == ("calm", 0, 4)
    alone = evaluate(CONFIG, {"PID": WILD}, settings=SIZE | {"leak_levels": (0.3,)}).table("limit_cycles")
    assert set(alone["leakage_flow_lpm"]) == {0.3}
