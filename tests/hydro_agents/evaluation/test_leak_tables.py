"""Tables of the leakage protocol on a made-up run whose figures are known."""

import numpy as np
import pytest
from small_leaks import made_up_tables


@pytest.fixture(scope="module")
def made():
    return made_up_tables()


def row(table, **wanted):
    for name, value in wanted.items():
        table = table[table[name] == value]
    assert len(table) == 1
    return table.iloc[0]


def test_detection_per_window_and_per_hour(made):
    healthy = row(made["detection"], detector="head", condition="plain", level=0.0)
    assert healthy["flagged"] == 0.01
    assert healthy["per_hour"] == pytest.approx(0.01 * 1800)  # windows of 2 s, one after the other
    assert healthy["flagged_low"] < 0.01 < healthy["flagged_high"]
    assert row(made["detection"], detector="estimator", condition="null", level=0.0)["cannot_tell"] == 0.8


def test_sizes_over_windows_in_which_the_detector_tells(made):
    plain = row(made["sizes"], detector="head", condition="plain", level=0.3)
    assert plain["rms_log10"] == pytest.approx(np.log10(1.1))
    assert plain["coverage"] == 1.0  # 10 % beside the truth, intervals of 20 %
    assert plain["bound_lpm"] == pytest.approx(0.02)  # the median
    assert plain["ratio_to_bound"] == pytest.approx(np.log10(1.1) / (0.02 / 0.3 / np.log(10.0)))
    assert row(made["sizes"], detector="head", condition="null", level=0.3)["coverage"] == 0.0
    silent = row(made["sizes"], detector="estimator", condition="null", level=0.3)
    assert silent["told"] == 0
    assert np.isnan(silent["rms_log10"])
