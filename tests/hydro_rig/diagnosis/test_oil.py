"""Viscosity by ISO VG grade, and leaks at one temperature: known answers."""

import numpy as np
import pytest
from refusal import refused

from hydro_rig.diagnosis.oil import GRADES, REFERENCE, THERMOMETER, Oil, common_error, referred
from hydro_rig.diagnosis.verdict import Leak

KNOWN = ((68.0, 8.6, 28.65), (30.0, 5.23, 14.53), (30.0, 4.24, 13.11), (70.0, 11.1, 32.92), (30.0, 5.81, 15.27))
"""mm²/s at 40, 100 and 60 °C; the last by another program for ASTM D341 (libvisc, its example)."""

VARIED = {32: (86.8, 15.1), 46: (134.0, 20.6), 68: (214.0, 28.7)}
"""mm²/s at 20 and 60 °C by grade, of viscosity index 100, from D341 and D2270 by hand."""


@pytest.mark.parametrize(("at_40", "at_100", "at_60"), KNOWN)
def test_the_viscosity_is_that_of_another_program(at_40, at_100, at_60):
    assert Oil(at_40, at_100).viscosity(60.0) == pytest.approx(at_60, rel=0.012)


def test_a_grade_is_its_viscosity_at_40_degrees():
    for grade, hot in GRADES.items():
        assert Oil.of(f"{grade}").viscosity([40.0, 100.0]) == pytest.approx([grade, hot])
    for grade, values in VARIED.items():
        assert Oil.of(f"{grade}").viscosity([20.0, 60.0]) == pytest.approx(values, rel=0.01)
    assert Oil.of("46/8.1").viscosity(100.0) == pytest.approx(8.1)


@pytest.mark.parametrize("text", ["45", "46/60", "46/0.1", "thick", "", "9999/10"])
def test_an_impossible_oil_is_told(text):
    with refused("^oil "):
        Oil.of(text)


def leak(value):
    return Leak(value, 0.9 * value, 1.1 * value)


def test_the_same_gap_has_one_size_at_any_temperature():
    oil = Oil.of("46")
    for warm in (25.0, 40.0, 60.0):
        measured = leak(0.2 / float(oil.factor(warm)))  # a laminar gap passes flow in proportion to 1/viscosity
        found = referred(measured, oil, warm)
        assert found.value == pytest.approx(0.2)
        assert found.low < 0.18
        assert found.high > 0.22
        assert found.high < 0.24
    assert float(oil.factor(60.0)) == pytest.approx(20.6 / 46.0, rel=0.01)
    assert float(oil.factor(REFERENCE)) == pytest.approx(1.0)


def test_an_unknown_temperature_widens_the_interval_to_the_range():
    wide = referred(leak(0.1), Oil.of("46"), np.nan)
    assert wide.value == pytest.approx(0.1)
    assert wide.low < 0.055
    assert wide.high > 0.22


def test_the_error_of_the_thermometer_is_common_to_all_readings():
    oil = Oil.of("46")
    step = np.log10(oil.viscosity(40.0 - THERMOMETER) / oil.viscosity(40.0 + THERMOMETER)) / 2.0
    assert common_error(oil, 40.0) == pytest.approx(float(step))
    assert common_error(oil, np.nan) > 5.0 * float(step)
