"""Poisson intervals, and the tail of the peaks: known answers."""

import numpy as np
import pytest

from hydro_agents.detection.alarm_calibration import fit_tail, peaks, poisson_interval, rate_with_interval
from hydro_env import ConfigurationError


@pytest.mark.parametrize(("count", "low", "high"), [(0, 0.0, 3.689), (1, 0.0253, 5.572), (10, 4.795, 18.39)])
def test_poisson_interval_is_that_of_the_tables(count, low, high):
    interval = poisson_interval(count, 2.0)
    assert interval.value == count / 2.0
    assert (interval.low, interval.high) == pytest.approx((low / 2.0, high / 2.0), rel=1e-3)


def test_poisson_interval_holds_the_truth():
    counts = np.random.default_rng(0).poisson(4.0, 2000)
    holds = [interval.low <= 4.0 <= interval.high for interval in (poisson_interval(int(n), 1.0) for n in counts)]
    assert 0.95 <= np.mean(holds) <= 0.99, "exact, therefore a little wide"


def test_a_rate_needs_hours():
    with pytest.raises(ConfigurationError, match="exposure must be positive"):
        poisson_interval(3, 0.0)


def test_an_excursion_has_one_peak():
    found = peaks(np.array([[0.0, 1.0, 3.0, 2.0, 0.0, 0.0, 5.0], [0.0] * 7]))
    assert [list(values) for values in found] == [[3.0, 5.0], []]


@pytest.mark.parametrize("shape", [0.0, 0.4])
def test_tail_finds_thresholds_beyond_the_hours(shape):
    generator = np.random.default_rng(5)
    uniform = 1.0 - generator.random(20_000)
    values = -np.log(uniform) if shape == 0.0 else (uniform**-shape - 1.0) / shape
    hours = 100.0
    tail = fit_tail(values, hours, highest=1000)
    wanted = 0.2  # per hour: one in a thousand
    exact = np.log(1000.0) if shape == 0.0 else (1000.0**shape - 1.0) / shape
    assert tail.shape == pytest.approx(shape, abs=0.1)
    assert tail.threshold_at(wanted) == pytest.approx(exact, rel=0.2)
    assert tail.rate_above(tail.threshold_at(wanted)) == pytest.approx(wanted)


def test_interval_of_the_rate_widens_where_alarms_cluster():
    generator = np.random.default_rng(6)
    even = [generator.exponential(1.0, 20) for _ in range(100)]
    clustered = [generator.exponential(1.0 if axis % 20 else 3.0, 20) for axis in range(100)]
    narrow, wide = (rate_with_interval(axes, 100.0, 6.0) for axes in (even, clustered))
    assert narrow.low <= 100.0 * 20.0 * np.exp(-6.0) <= narrow.high
    assert wide.high - wide.low > narrow.high - narrow.low
    with pytest.raises(ConfigurationError, match="too few for a tail"):
        fit_tail(np.ones(3), 1.0)
