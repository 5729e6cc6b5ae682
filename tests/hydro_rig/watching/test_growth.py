"""The trend of a growing leak: its intervals hold the truth, and what does not grow reaches no limit."""

import numpy as np
import pytest

from hydro_rig.watching.growth import growth

DAYS = np.arange(30.0)
RATE = 1.0 / 40.0  # decades per day


def lasting(generator, count, share, length):
    """Errors of standard deviation 1 of which a share of the variance lasts for some readings."""
    errors, memory = np.zeros(count), np.exp(-1.0 / length)
    slow = generator.standard_normal()
    for k in range(count):
        slow = memory * slow + np.sqrt(1.0 - memory**2) * generator.standard_normal()
        errors[k] = np.sqrt(share) * slow + np.sqrt(1.0 - share) * generator.standard_normal()
    return errors


@pytest.mark.parametrize(("share", "length"), [(0.0, 1.0), (0.8, 5.0)])
def test_the_interval_holds_the_time_to_the_limit_also_where_errors_last(share, length):
    generator = np.random.default_rng(7)
    size = 0.3 * 10.0 ** (RATE * (DAYS - DAYS[-1] - 12.0))  # the limit is reached 12 days after the last reading
    holds, early = [], []
    for _ in range(60):
        errors = 0.04 * lasting(generator, len(DAYS), share, length)
        found = growth(DAYS, size * 10.0**errors, 0.3, 0.09 * size)
        holds.append(found.ahead.low <= 12.0 <= found.ahead.high)
        early.append(found.not_before > 12.0)
        assert found.not_before <= found.ahead.low <= found.ahead.value <= found.ahead.high
    assert 0.84 <= np.mean(holds) <= 0.99
    assert np.mean(early) <= 0.05


def test_a_leak_that_was_healthy_for_long_is_dated_by_its_growth_alone():
    size = 0.01 * 10.0 ** (np.maximum(DAYS - 15.0, 0.0) / 10.0)  # a decade in ten days, from day 15 on
    noise = 10.0 ** (0.02 * np.random.default_rng(1).standard_normal(len(DAYS)))
    found = growth(DAYS, size * noise, 1.0, 0.05 * size)
    assert found.ahead.low <= 6.0 <= found.ahead.high  # two decades after day 15
    assert found.ahead.high < 8.0
    assert found.rate.low <= 0.1 <= found.rate.high


def test_what_does_not_grow_reaches_no_limit():
    noise = np.random.default_rng(8).normal(0.0, 0.05, len(DAYS))
    found = growth(DAYS, 0.02 * 10.0**noise, 0.3, np.full(len(DAYS), 0.002))
    assert found.rate.low < 0.0 < found.rate.high
    assert found.ahead.high == np.inf
    assert found.not_before > 20.0
    falling = growth(DAYS, 0.1 * 10.0 ** (noise - DAYS / 10.0), 1.0, np.full(len(DAYS), 1e-3))
    assert falling.ahead.low == np.inf
    assert falling.grows < 0.01
    above = growth(DAYS, 5.0 * 10.0 ** (noise + DAYS / 60.0), 1.0, np.full(len(DAYS), 0.5))
    assert (above.ahead.low, above.ahead.high, above.not_before) == (0.0, 0.0, 0.0)


def test_too_few_readings_give_no_trend():
    for time, flow in (
        (np.zeros(0), np.zeros(0)),
        (np.arange(4.0), np.ones(4)),
        (np.zeros(20), np.ones(20)),
        (np.arange(200.0), np.full(200, np.nan)),
    ):
        assert np.isnan(growth(time, flow, 1.0, 0.1 * flow).rate.value)
