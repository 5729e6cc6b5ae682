"""Fit of several windows, parts of a recording, ranges of the rig that was found: known answers."""

import math

import numpy as np
import pytest
import yaml

from hydro_agents.estimation.unknowns import Prior
from hydro_agents.recordings.sampling import Sampled
from hydro_agents.rigs.fit import Fit, combinations, unknowns_of
from hydro_agents.rigs.found_rig import _line, _with_unit, found_values, narrowed
from hydro_agents.rigs.parts import COMMAND, POSITION, _share, parts_of
from hydro_env import ConfigurationError, PlantParameters, TaskConfig
from hydro_env.plant.parameters import PARAMETER_PATHS
from hydro_env.task.randomisation import Distribution
from hydro_env.task.rig import rig_from
from hydro_env.units import resistance_from_flow

PERIOD = 0.005


def samples_of(count, place=None):
    """A recording of ``count`` samples that moves in its second half."""
    time = PERIOD * np.arange(count)
    signals = np.zeros((5, count))
    signals[POSITION] = np.where(time > 0.5 * time[-1], 0.01 * np.sin(9.0 * time), 0.0)
    signals[COMMAND] = np.linspace(-0.5, 0.5, count)
    place = np.arange(count) if place is None else place
    return Sampled(place, PERIOD * place, signals, PERIOD, {}, [])


def test_seven_tenths_are_fitted_and_the_rest_is_held_back():
    parts = parts_of(samples_of(4000), "a.csv")
    assert parts.fitted.begin.tolist() == [0.0, 2.0, 4.0, 6.0, 8.0, 10.0, 12.0]
    assert parts.begin == 14.0
    np.testing.assert_array_equal(parts.held_back, samples_of(4000).signals[:, 2800:])
    assert parts.findings == []


def test_of_a_long_recording_each_section_gives_its_liveliest_window():
    parts = parts_of(samples_of(40_000), "a.csv")
    assert len(parts.fitted.begin) == 12
    assert (np.diff(parts.fitted.begin) > 0.0).all()
    # The axis moves from 100 s on: the section that holds this moment gives a window behind it.
    assert not ((parts.fitted.begin >= 94.0) & (parts.fitted.begin < 98.0)).any()
    assert parts.held_back.shape[1] == 2000


def test_short_gaps_of_the_command_are_interpolated_and_told():
    place = np.delete(np.arange(4003), [500, 501, 1300])
    parts = parts_of(samples_of(4000, place), "a.csv")
    assert len(parts.fitted.begin) == 7
    command = parts.fitted.signals[1, COMMAND]
    assert command[100] == pytest.approx(command[99] + (command[102] - command[99]) / 3.0, abs=1e-5)
    assert np.isnan(parts.fitted.signals[1, POSITION, 100])
    assert "filled in" in parts.findings[0].line()


def test_windows_with_a_long_gap_are_left_out():
    place = np.concatenate([np.arange(1000), np.arange(1300, 4300)])
    parts = parts_of(samples_of(4000, place), "a.csv")
    assert 4.0 not in parts.fitted.begin
    assert 6.0 not in parts.fitted.begin


@pytest.mark.parametrize(
    ("row", "columns", "value", "words"),
    [
        (POSITION, slice(None), np.nan, "position was not recorded"),
        (COMMAND, slice(None), -1.0, "command is at its limit for 100 %"),
        (
            COMMAND,
            np.add.outer(np.arange(0, 4000, 400), np.arange(4)).ravel(),
            np.nan,
            "only 0 windows of 2 s have all commands",
        ),
    ],
)
def test_what_tells_nothing_is_refused(row, columns, value, words):
    samples = samples_of(4000)
    samples.signals[row, columns] = value
    with pytest.raises(ConfigurationError, match=words):
        parts_of(samples, "a.csv")


def test_a_recording_of_a_second_is_refused():
    with pytest.raises(ConfigurationError, match="holds 1 s of samples; at least 2 s are needed"):
        parts_of(samples_of(200), "a.csv")


def test_the_share_of_variance_is_that_of_a_regression():
    measured = np.array([0.0, 2.0, 4.0, np.nan])
    assert _share(measured, measured) == 1.0
    assert _share(measured, np.full(4, 2.0)) == pytest.approx(0.0)
    assert _share(measured, measured[::-1] * np.nan) == -math.inf
    assert math.isnan(_share(np.full(3, np.nan), np.zeros(3)))


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
    names = tuple(values)
    value, low, high = np.array(list(values.values())).T
    left = np.array([(remaining or {}).get(name, 0.1) for name in names])
    priors = {name: Prior(1.0, 1.0) for name in names}
    return Fit(names, priors, value, low, high, left, 1.0, np.eye(len(names)), np.zeros(5))


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


def test_a_tight_rod_seal_stays_tight_and_a_leaking_one_gets_a_range():
    path = "leakage.external_resistance"
    tight = fit_of({"external_leakage_flow_lpm": (0.0, -0.01, 0.01)})
    assert narrowed(tight, CONFIG, RANGES)[path]["otherwise"] == math.inf
    leaking = fit_of({"external_leakage_flow_lpm": (0.2, 0.15, 0.25)})
    low, high = narrowed(leaking, CONFIG, RANGES)[path]["log_uniform"]
    assert low == pytest.approx(resistance_from_flow(0.25), rel=1e-5)
    assert high == pytest.approx(resistance_from_flow(0.15), rel=1e-5)


def test_values_stay_within_the_bounds_of_their_fields():
    fit = fit_of({"leakage_flow_lpm": (-0.01, -0.02, 0.0), "load.spring_stiffness": (-5.0, -9.0, 1.0)})
    values = found_values(fit, CONFIG)
    assert values["load.spring_stiffness"] == 0.0
    assert values["leakage.internal_resistance"] == math.inf


def test_two_unknowns_that_compensate_each_other_are_named_as_one_combination():
    fit = fit_of({"load.mass": (1.0, 1.0, 1.0), "valve.underlap": (1.0, 1.0, 1.0), "supply.pressure": (1.0, 1.0, 1.0)})
    ridge = np.array([1.0, 1.0, 0.0])  # only their sum shows
    fit = fit._replace(information=100.0 * np.outer(ridge, ridge) + np.diag([0.0, 0.0, 4.0]))
    least, pressure, most = combinations(fit)
    assert least.singular_value == pytest.approx(0.0, abs=1e-6)
    parts = dict(least.parts)
    assert parts["load.mass"] == pytest.approx(-parts["valve.underlap"])
    assert pressure.singular_value == pytest.approx(2.0)
    assert dict(pressure.parts) == pytest.approx({"supply.pressure": 1.0})
    assert most.singular_value == pytest.approx(math.sqrt(200.0))


def test_without_ranges_leak_biases_and_start_alone_are_unknown():
    names = unknowns_of(CONFIG, {}, np.array([True, False, False, True]))
    assert names[:3] == ["leakage_flow_lpm", "position_bias", "spool_position_bias"]
    assert all(name.startswith("start.") for name in names[3:])
    assert "external_leakage_flow_lpm" in unknowns_of(CONFIG, RANGES, np.ones(4, dtype=bool))


def test_every_number_of_a_rig_is_read_back_from_its_text_with_unit():
    plant = PlantParameters()
    values = {path: getattr(getattr(plant, path.split(".")[0]), path.split(".")[1]) for path in PARAMETER_PATHS}
    values = {path: float(value) for path, value in values.items() if isinstance(value, int | float)}
    assert len(values) > 40
    groups: dict[str, list[str]] = {}
    for path, value in values.items():
        group, field = path.split(".")
        groups.setdefault(group, []).append(f"  {_line(field, _with_unit(path, value, plant))}\n")
    text = "".join(f"{group}:\n{''.join(lines)}" for group, lines in groups.items())
    for unit in ("bar", "l/min", "Hz", "GPa", "cm³"):
        assert f" {unit}\n" in text
    read = rig_from(yaml.safe_load(text), "rig.yaml").plant
    for path, value in values.items():
        group, field = path.split(".")
        assert math.isclose(getattr(getattr(read, group), field), value, rel_tol=1e-5), path
