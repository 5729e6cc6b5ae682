"""Standstills of an evaluation: a controller in a limit cycle is counted, named and never taken for a good baseline."""

import numpy as np
import pandas as pd
import pytest

from hydro_agents.controllers.registry import make_controller
from hydro_agents.evaluation.evaluate import evaluate
from hydro_agents.evaluation.limit_cycles import comes_to_rest, counted, is_broken, rest_text, rest_warning
from hydro_agents.running.seeds import EVALUATION
from hydro_env import REFERENCE_FAMILIES, TaskConfig

CONFIG = TaskConfig(episode_duration=0.4)
SIZE = {"plants": 3, "leak_levels": (4.0, 0.03, 1.0), "families": ("step",), "standstill_plants": 2}
WILD = make_controller("pid", CONFIG, {"proportional": 1500.0})


def standstills(amplitudes, failed=0, count=16):
    """``count`` standstills, of which the first have a limit cycle of these amplitudes in µm."""
    cycles = len(amplitudes)
    return pd.DataFrame(
        {
            "limit_cycle": np.arange(count) < cycles,
            "amplitude_um": [*amplitudes, *[2.0] * (count - cycles)],
            "frequency_hz": [5.0 + number for number in range(cycles)] + [np.nan] * (count - cycles),
            "failed": np.arange(count) >= count - failed,
        }
    )


def test_standstills_are_counted_with_the_largest_limit_cycle():
    assert counted(standstills([20.0, 90.0, 30.0], failed=2)) == {
        "limit_cycles": 3,
        "standstills": 16,
        "failures": 2,
        "largest_amplitude_um": 90.0,
        "frequency_hz": 6.0,
    }
    none = counted(standstills([]))
    assert (none["limit_cycles"], none["largest_amplitude_um"]) == (0, 0.0)
    assert np.isnan(none["frequency_hz"])
    assert comes_to_rest(none)
    assert not comes_to_rest(counted(standstills([], failed=1)))


@pytest.mark.parametrize(
    ("amplitudes", "failed", "broken", "text"),
    [
        ([], 0, False, "no limit cycle at 16 standstills"),
        ([45.0], 0, False, "limit cycle at 1 of 16 standstills, up to 45 µm"),
        ([199.0] * 16, 0, False, "limit cycle at 16 of 16 standstills, up to 199 µm"),  # each settles within ±0.2 mm
        ([201.0] * 7, 0, False, "limit cycle at 7 of 16 standstills, up to 201 µm"),
        ([201.0] * 8, 0, True, "limit cycle at 8 of 16 standstills, up to 201 µm"),
        ([7900.0] * 14, 0, True, "limit cycle at 14 of 16 standstills, up to 7.9 mm"),
        ([], 9, True, "failure at 9 of 16 standstills"),
        ([20.0], 7, True, "limit cycle at 1 of 16 standstills, up to 20 µm and failure at 7 of 16 standstills"),
    ],
)
def test_a_controller_is_broken_that_often_leaves_the_settling_band_at_rest(amplitudes, failed, broken, text):
    found = counted(standstills(amplitudes, failed))
    assert is_broken(found) == broken
    assert rest_text(found) == text
    if comes_to_rest(found):
        assert rest_warning("PID", found, baseline=True) == ""
        return
    assert rest_warning("PID", found, baseline=False) == f"PID: {text}"
    against = "a broken controller" if broken else "a controller that does not come to rest"
    assert rest_warning("PID", found, baseline=True) == f"PID: {text}: ratios to it compare with {against}"


def test_an_evaluation_finds_the_limit_cycles_of_a_high_gain_and_none_of_flow_linearisation():
    result = evaluate(CONFIG, {"PID": WILD, "calm": "flow_linearising"}, settings=SIZE)
    cases = result.limit_cycles
    assert set(cases["leakage_flow_lpm"]) == {0.03, 4.0}  # the smallest and the largest leak
    user = EVALUATION.of_family(REFERENCE_FAMILIES.index("user"), np.arange(2))
    assert set(cases["seed"]) == set(user)
    assert len(cases) == 2 * 2 * 2
    wild, calm = result.limit_cycle_summary.to_dict("records")
    assert (wild["controller"], wild["limit_cycles"], wild["standstills"]) == ("PID", 4, 4)
    assert wild["largest_amplitude_um"] > 500.0
    assert is_broken(wild)
    assert (calm["controller"], calm["limit_cycles"], calm["standstills"]) == ("calm", 0, 4)
    one_leak = SIZE | {"leak_levels": (0.3,)}
    assert set(evaluate(CONFIG, {"PID": WILD}, settings=one_leak).limit_cycles["leakage_flow_lpm"]) == {0.3}


def test_an_evaluation_without_standstills_has_no_table_of_them_and_the_same_errors():
    without = evaluate(CONFIG, {"PID": WILD}, settings=SIZE | {"standstill_plants": 0})
    assert without.limit_cycles.empty
    assert without.limit_cycle_summary.empty
    pd.testing.assert_frame_equal(without.cases, evaluate(CONFIG, {"PID": WILD}, settings=SIZE).cases)


def test_training_seeds_share_a_row_and_a_failing_one_costs_only_itself():
    class Broken:
        def predict(self, observation, state=None, episode_start=None, deterministic=True):
            return np.full((len(observation), 1), np.nan), None

    seeds = {"mine#0": "pid", "mine#1": "flow_linearising"}
    both = evaluate(CONFIG, {"PID": "pid", **seeds}, settings=SIZE)
    assert both.controllers == ["PID", "mine"]
    own = both.cases[both.cases["controller"] == "mine"]
    assert own.groupby("training_seed").size().tolist() == [9, 9]
    ratios = both.ratios[both.ratios["group"] == "all"]
    assert ratios["controller"].tolist() == ["mine"]
    mean = both.cases.groupby("controller")["mean_error_mm"].mean()
    assert ratios["ratio"].item() == pytest.approx(mean["mine"] / mean["PID"], rel=1e-12)
    assert both.limit_cycle_summary["standstills"].tolist() == [4, 8]
    with pytest.warns(UserWarning, match=r"mine#2: seed 2000000"):
        result = evaluate(CONFIG, {"PID": "pid", **seeds, "mine#2": Broken()}, settings=SIZE)
    assert list(result.errors) == ["mine#2"]
    pd.testing.assert_frame_equal(result.cases, both.cases)
    pd.testing.assert_frame_equal(result.ratios, both.ratios)
