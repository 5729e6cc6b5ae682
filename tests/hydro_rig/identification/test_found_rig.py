"""Fit of several windows, held-back parts, ranges of the rig that was found: known answers."""

import math
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import yaml

from hydro_agents.controllers.flow_linearising import FlowLinearising, FlowLinearisingGains
from hydro_agents.detection.detector import measured_run
from hydro_agents.running.cases import Cases
from hydro_agents.running.seeds import VALIDATION_SEEDS
from hydro_env import PlantParameters, TaskConfig
from hydro_env.plant.parameters import MODEL_CODES, PARAMETER_PATHS
from hydro_env.task.configuration import task_config
from hydro_env.task.randomisation import Distribution, own_value
from hydro_env.task.rig import rig_from
from hydro_env.task.sensors import POSITION
from hydro_env.units import resistance_from_flow
from hydro_rig.identification import common_fit
from hydro_rig.identification.fit import Fit, Unknown
from hydro_rig.identification.found_rig import _line, _with_unit, found_values, narrowed
from hydro_rig.identification.held_back import (
    HeldBack,
    _first_known,
    _share,
    errors_in_words,
    forecast,
    simulate_held_back,
    whole_parts,
)
from hydro_rig.identification.identify import Identification
from hydro_rig.recordings.parts import Stretch


def test_the_share_of_variance_is_that_of_a_regression():
    measured = np.array([0.0, 2.0, 4.0, np.nan])
    assert _share([(measured, measured)]) == 1.0
    assert _share([(measured, np.full(4, 2.0))]) == pytest.approx(0.0)
    assert _share([(measured, measured[::-1] * np.nan)]) == -math.inf
    assert math.isnan(_share([(np.full(3, np.nan), np.zeros(3))]))


def test_errors_are_those_of_position_speed_and_pressures():
    time = 0.005 * np.arange(400)
    measured = np.full((4, 400), np.nan)
    measured[POSITION] = 0.1 * np.where(time < 1.0, time, 2.0 - time)
    measured[1] = 20e5
    simulated = measured.copy()
    simulated[POSITION], simulated[1] = 1.02 * measured[POSITION], 20.5e5
    part = HeldBack(0, 0.0, time, measured, simulated, np.zeros(4, bool))
    assert part.whole.error[1] == pytest.approx(0.5e5)
    assert part.whole.speed_error == pytest.approx(2e-3, rel=0.05)
    assert errors_in_words(whole_parts([part, part])).startswith("1.2 mm")
    assert errors_in_words(whole_parts([part._replace(measured=np.full((4, 400), np.nan))])) == ""


CONFIG = TaskConfig()
RANGES = {
    "load.mass": Distribution(factor=(0.5, 1.5)),
    "friction.coulomb_force": Distribution(uniform=(50.0, 300.0)),
    "friction.breakaway_force": Distribution(uniform=(1.1, 1.5), times="friction.coulomb_force"),
    "load.spring_stiffness": Distribution(factor=(0.8, 1.2), otherwise=0.0, otherwise_probability=0.1),
    "leakage.external_resistance": Distribution(
        log_uniform=(1e12, 1e13), otherwise=math.inf, otherwise_probability=0.8
    ),
}


def fit_of(values, remaining=None):
    """A fit with given values and ends of intervals by name: (value, low, high)."""
    left = remaining or {}
    unknowns = [Unknown(name, *three, left.get(name, 0.1), 1.0) for name, three in values.items()]
    return Fit(tuple(unknowns), np.zeros(5))


@pytest.mark.parametrize("misfit", [1.0, 9.0], ids=["explained", "not explained"])
def test_a_fit_that_explains_no_window_says_so_first(misfit):
    """A bore that is 4 % wrong predicts the motion, but differs from the readings of every window."""
    fit = fit_of({"valve.rated_flow": (9e-4, 1e-3, 1.1e-3)})._replace(misfit=np.full(5, misfit))
    time, moving = np.linspace(0.0, 1.0, 101), np.tile(np.linspace(0.0, 0.1, 101), (4, 1))
    held = HeldBack(0, 0.0, time, moving, moving + 1e-5, np.ones(4, bool))
    rig = SimpleNamespace(randomisation={"valve.rated_flow": Distribution(uniform=(8e-4, 2e-3))})
    empty = dict.fromkeys(("recordings", "checked", "parts"), ())
    found = Identification(rig=rig, config=CONFIG, fit=fit, held_back=[held], **empty)
    assert found.describes
    assert found.unexplained == (misfit > 4.0)
    assert found.verdict().startswith("no window is explained: " if misfit > 4.0 else "1 of 1 unknowns determined")
    other = SimpleNamespace(randomisation={"valve.rated_flow": Distribution(uniform=(4e-4, 6e-4))})
    outside = replace(found, rig=other)
    assert outside.describes == (misfit < 4.0)  # a value outside its range, and no window explained: refused
    assert any("rated flow" in note for note in outside.noted)
    assert not any("rated flow" in note for note in found.noted)


def test_a_wrong_null_adds_up_over_a_recording_and_not_over_a_forecast():
    """A controller that nobody records held the axis in place; the simulation gets its commands alone."""
    config = task_config(plant={"load": {"spring_stiffness": 0.0}}, randomisation={}, episode_duration=14.0)
    cases = Cases(VALIDATION_SEEDS.start + 997_000 + np.arange(1), families=np.array(["multi_sine"]))
    signals, _ = measured_run(config, FlowLinearising(FlowLinearisingGains(), config), cases)
    part, valve = Stretch(0, 0.0, signals[0], np.full((2, signals.shape[2]), np.nan)), config.plant.valve
    tested = {}
    for shift in (0.0, 0.004):
        moved = valve.model_copy(update={"null_shift": valve.null_shift + shift})
        held = simulate_held_back(part, config, config.plant.model_copy(update={"valve": moved}), {})
        tested[shift] = forecast([held]), whole_parts([held])
    ahead, whole = tested[0.004]
    assert ahead.error[POSITION] < whole.error[POSITION]
    assert whole.share[POSITION] < 0.9 < ahead.share[POSITION]
    assert tested[0.0][0].share[POSITION] > 0.999
    short = simulate_held_back(
        part._replace(signals=signals[0, :, :600], boundary=part.boundary[:, :600]), config, config.plant, {}
    )
    assert forecast([short]) is None


def test_a_held_back_part_begins_where_the_position_is_known():
    position = np.concatenate([np.full(50, np.nan), np.zeros(20), np.full(80, np.nan), np.zeros(100)])
    assert 130 <= _first_known(position, 40) <= 150


def test_ranges_are_narrowed_to_the_intervals_and_never_widened():
    fit = fit_of(
        {
            "load.mass": (80.0, 70.0, 95.0),
            "friction.coulomb_force": (100.0, 90.0, 110.0),
            "friction.breakaway_force": (120.0, 95.0, 130.0),
            "load.spring_stiffness": (90e3, 89e3, 91e3),
        }
    )
    found = narrowed(fit, CONFIG, RANGES)
    assert found["load.mass"] == {"uniform": [70.0, 90.0]}  # 60 kg, at most 1.5 times
    assert found["friction.coulomb_force"] == {"uniform": [90.0, 110.0]}
    # Breakaway stays a multiple of Coulomb friction, which is 100 N now: 1.1 to 1.5 before, 0.95 to 1.3 found.
    assert found["friction.breakaway_force"] == {"uniform": [1.1, 1.3], "times": "friction.coulomb_force"}
    assert found["load.spring_stiffness"] == {"uniform": [89e3, 91e3]}


def test_what_is_not_determined_keeps_its_range_in_si():
    left = {"load.mass": 0.8, "load.spring_stiffness": 0.9}
    fit = fit_of({"load.mass": (80.0, 40.0, 95.0), "load.spring_stiffness": (90e3, 1e3, 99e3)}, left)
    found = narrowed(fit, CONFIG, RANGES)
    assert found["load.mass"] == {"uniform": [30.0, 90.0]}
    spring = CONFIG.plant.load.spring_stiffness
    assert found["load.spring_stiffness"]["uniform"] == pytest.approx([0.8 * spring, 1.2 * spring])
    assert found["load.spring_stiffness"]["otherwise_probability"] == 0.1


def test_leaks_and_springs_stay_within_their_bounds():
    path = "leakage.external_resistance"
    tight = fit_of({"external_leakage_flow_lpm": (0.0, -0.01, 0.01)})
    assert narrowed(tight, CONFIG, RANGES)[path]["otherwise"] == math.inf
    leaking = narrowed(fit_of({"external_leakage_flow_lpm": (0.2, 0.15, 0.25)}), CONFIG, RANGES)[path]
    assert leaking["log_uniform"] == pytest.approx([resistance_from_flow(flow) for flow in (0.25, 0.15)], rel=1e-5)
    below = fit_of({"leakage_flow_lpm": (-0.01, -0.02, 0.0), "load.spring_stiffness": (-5.0, -9.0, 1.0)})
    values = found_values(below, CONFIG)
    assert values["load.spring_stiffness"] == 0.0
    assert values["leakage.internal_resistance"] == math.inf


@pytest.mark.parametrize(("misfit", "kept"), [([1, 2, 3, 20], [0, 1, 2]), ([9, 9, 9, 200, 300], [0, 1, 2, 3])])
def test_a_large_misfit_is_an_outlier_sooner_where_most_windows_are_explained(misfit, kept):
    assert common_fit.without_outliers(np.array(misfit, float)).tolist() == kept


def test_every_number_of_a_rig_is_read_back_from_its_text_with_unit():
    plant = PlantParameters()
    values = {path: own_value(plant, path) for path in PARAMETER_PATHS if path not in MODEL_CODES}
    assert len(values) > 40
    groups: dict[str, list[str]] = {}
    for path, value in values.items():
        group, field = path.split(".")
        groups.setdefault(group, []).append(f"  {_line(field, _with_unit(path, value))}\n")
    text = "".join(f"{group}:\n{''.join(lines)}" for group, lines in groups.items())
    for unit in ("bar", "l/min", "Hz", "GPa", "cm³"):
        assert f" {unit}\n" in text
    read = rig_from(yaml.safe_load(text), "rig.yaml").plant
    assert {path: own_value(read, path) for path in values} == pytest.approx(values, rel=1e-5)
