"""Evidence over time: known run lengths, own and absolute baselines, latch."""

import numpy as np
import pytest

from hydro_agents.detection.activity import Activity
from hydro_agents.detection.alarm import AlarmSettings, AlarmState, LeakAlarm
from hydro_agents.detection.detector import Cause, Reading

SCALE = {"highest_baseline": 0.0, "learning": 5, "spread": 1.0, "shift": 1.0}


def alarm(learning=5, **changes):
    scales = {a.name.lower(): {**SCALE, "learning": learning} for a in Activity}
    return LeakAlarm(AlarmSettings(**{"clip": 1e6, "scales": scales, "threshold": 3.0, **changes}))


def follow(watch, score, state=None, cause=Cause.NONE, activity=Activity.MOVING, sigma=np.nan):
    """Looks at N axes, (N, L), one after the other: their memory over time, (N, …, L), and at the end."""
    score = np.atleast_2d(np.asarray(score, dtype=float))
    state = watch.begin(len(score)) if state is None else state
    fields = [np.broadcast_to(values, score.shape) for values in (sigma, cause, activity)]
    said = []
    for now in range(score.shape[1]):
        sigmas, causes, activities = (values[:, now] for values in fields)
        look = Reading.of(score[:, now], causes, sigma=sigmas)
        state = watch.update(look, np.asarray(activities, dtype=np.int8), state)
        said.append(state)
    return AlarmState(*(np.stack(values, axis=1) for values in zip(*said, strict=True))), state


def learnt(watch, count):
    """A memory whose baselines are known, at zero."""
    state = watch.begin(count)
    return state._replace(seen=np.full_like(state.seen, 5.0))


def first_alarm(raised):
    return np.where(raised.any(axis=1), raised.argmax(axis=1) + 1, raised.shape[1])


@pytest.mark.parametrize(("mean", "drift"), [(0.0, -0.5), (1.0, 0.5)], ids=["false alarm", "delay"])
def test_run_length_of_the_cusum_is_that_of_siegmund(mean, drift):
    watch = alarm()
    score = np.random.default_rng(1).normal(mean, 1.0, (2000, 600 if mean == 0.0 else 100))
    result, _ = follow(watch, score, learnt(watch, len(score)))
    boundary = 3.0 + 1.166  # Siegmund, Sequential Analysis (1985), (2.57)
    expected = (np.exp(-2.0 * drift * boundary) + 2.0 * drift * boundary - 1.0) / (2.0 * drift**2)
    assert first_alarm(result.alarm).mean() == pytest.approx(expected, rel=0.06)


@pytest.mark.parametrize(
    ("score", "sigma", "total"),
    [([1.0, np.nan, 2.0, np.nan, -4.0], np.nan, [0.5, 0.5, 2.0, 2.0, 0.0]), ([2.0, 2.0], [0.5, 2.0], [1.5, 1.875])],
    ids=["no score adds nothing", "the detector's own uncertainty weighs a look"],
)
def test_totals_by_hand(score, sigma, total):
    watch = alarm(threshold=1.0)
    result, _ = follow(watch, score, learnt(watch, 1), sigma=np.array([sigma]))
    np.testing.assert_allclose(result.total[0], total)
    _, state = follow(watch, score)
    assert state.seen[0, Activity.MOVING] == np.isfinite(score).sum()


def test_an_axis_is_judged_against_its_own_baseline():
    watch = alarm(threshold=5.0)
    quiet, noise = np.full(30, -4.0), np.zeros(30)
    result, _ = follow(watch, [np.append(quiet, quiet + 2.0), np.append(noise, noise)])
    assert not result.alarm[:, :30].any()
    assert result.alarm[:, -1].tolist() == [True, False], "a rise of two design leaks, and none"
    assert result.total[0, -1] == pytest.approx(30 * 1.5)


@pytest.mark.parametrize(("learning", "threshold", "first"), [(5, 3.0, 7), (0, 5.0, 11)])
def test_a_leak_that_is_there_from_the_start_is_found_with_and_without_learning(learning, threshold, first):
    result, _ = follow(alarm(learning, threshold=threshold), [np.full(40, 1.0), np.full(40, -0.1)])
    assert result.alarm[:, -1].tolist() == [True, False]
    assert first_alarm(result.alarm)[0] == first, "half the design leak a look, against healthy axes"


def test_slow_drift_is_not_learnt_away():
    drift = np.concatenate([np.full(20, -3.0), np.linspace(-3.0, -1.0, 400)])
    result, _ = follow(alarm(), [drift, np.concatenate([np.full(20, -3.0), np.linspace(-3.0, -2.6, 400)])])
    assert result.alarm[0, -1], "a drift of two design leaks"
    assert not result.alarm[1].any(), "a drift of less than half a design leak"


def test_alarm_latches():
    watch = alarm()
    score = np.concatenate([np.full(10, -1.0), np.full(10, 3.0), np.full(30, -9.0)])
    _, state = follow(watch, [score, np.full(50, -1.0)])
    assert state.total[0] == 0.0
    assert state.alarm.tolist() == [True, False]
    assert state.mean[0, Activity.MOVING] == -1.0
    watch.update(Reading.of([9.0, 9.0]), np.full(2, Activity.MOVING), state)
    assert not state.alarm[1], "the memory that was given stays as it was"


def test_what_the_detector_cannot_explain_raises_no_alarm_and_a_named_fault_clears_none():
    score = np.append(np.full(20, -3.0), np.full(80, 9.0))
    for cause, raised in ((Cause.UNKNOWN, False), (Cause.VALVE, True)):
        causes = np.append(np.zeros(20), np.full(80, cause))
        result, _ = follow(alarm(interval=1.0), score, cause=causes[None])
        assert result.alarm.any() == raised
