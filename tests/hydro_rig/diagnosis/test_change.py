"""Before and after: the fall of the leak has an interval, and the temperature of the oil explains no fall."""

from types import SimpleNamespace

import numpy as np
import pytest

from hydro_rig.diagnosis.diagnose import change_of
from hydro_rig.diagnosis.oil import Oil
from hydro_rig.diagnosis.verdict import Kind, Leak, Verdict

OIL = Oil.of("46")


def diagnosed(value, temperature=40.0, error=0.05):
    """What a diagnosis says; NaN: it gives no leak."""
    leak = None if np.isnan(value) else Leak(value, (1.0 - error) * value, (1.0 + error) * value)
    return SimpleNamespace(verdict=Verdict(Kind.LEAK, "position moves the wrong way", leak), temperature=temperature)


@pytest.mark.parametrize(("before", "after", "sign"), [(0.3, 0.01, 1), (0.01, 0.3, -1), (0.3, 0.29, 0)])
def test_the_fall_has_an_interval(before, after, sign):
    fall = change_of(diagnosed(before), diagnosed(after), OIL).fall
    assert fall.value == pytest.approx(before - after, abs=1e-9)
    assert fall.low < fall.value < fall.high
    assert (fall.low > 0.0) - (fall.high < 0.0) == sign


def test_colder_oil_is_no_new_seal():
    fall = change_of(diagnosed(0.3 / float(OIL.factor(60.0)), 60.0), diagnosed(0.3, 40.0), OIL).fall
    assert fall.low < 0.0 < fall.high
    unknown = change_of(diagnosed(0.3, np.nan), diagnosed(0.01, np.nan), OIL).fall
    assert 0.0 < unknown.low < change_of(diagnosed(0.3), diagnosed(0.01), OIL).fall.low


def test_a_recording_without_a_leak_gives_no_fall():
    found = change_of(diagnosed(np.nan), diagnosed(0.01), OIL)
    assert found.fall is None
    assert "before: position moves the wrong way" in found.line
