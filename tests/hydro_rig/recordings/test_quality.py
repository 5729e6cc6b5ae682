"""Every kind of damage to a recording is found, told with its remedy, and weighed."""

import numpy as np
import pytest
from recorded import CONFIG, changed, healthy

from hydro_env.plant.arrays import plant_coefficients
from hydro_env.task.configuration import task_config
from hydro_rig.recordings.findings import Weight
from hydro_rig.recordings.quality import balance, check_recording, flow_into_a
from hydro_rig.recordings.recording import Recording
from hydro_rig.recordings.sampling import bridged, cut, on_grid, sampled

BAR = 1e5
NOTE, FAULT, SEVERE = Weight.NOTE, Weight.FAULT, Weight.SEVERE


@pytest.fixture(scope="module")
def recording(tmp_path_factory):
    return healthy(tmp_path_factory.mktemp("recorded"))


def scaled(*factors):
    return lambda r: changed(r, signals=r.signals * np.array(factors)[:, None])


def edited(row, part, value):
    def change(recording):
        signals = recording.signals.copy()
        signals[row, part] = value if not callable(value) else value(signals[row, part])
        return changed(recording, signals=signals)

    return change


def rows(chosen):
    return lambda r: changed(r, time=r.time[chosen(len(r.time))], signals=r.signals[:, chosen(len(r.time))])


def restamped(stamp):
    return lambda r: changed(r, time=stamp(r.time))


def late(recording):
    """With stamps that come up to 4 ms early or late."""
    random = np.random.default_rng(0)
    return changed(recording, time=np.sort(recording.time + random.uniform(-4e-3, 4e-3, len(recording.time))))


def blank(every):
    """Pressures in each so many row alone, as a slower program logs them."""

    def change(recording):
        signals = recording.signals.copy()
        signals[1:3, np.arange(signals.shape[1]) % every > 0] = np.nan
        return changed(recording, signals=signals)

    return change


def held(values):
    """As a historian holds them within a dead band of 1 bar."""
    kept = values.copy()
    for row in kept:
        for k in range(1, len(row)):
            if abs(row[k] - row[k - 1]) < BAR:
                row[k] = row[k - 1]
    return kept


def as_set_point(scale):
    """The position 40 ms later stands in the column of the command."""
    return lambda r: changed(r, signals=np.vstack([r.signals[:4], scale * np.roll(r.signals[0], -8)]))


def resting_encoder(recording):
    """From 4.5 s on the axis rests: an encoder of 25 µm repeats its value while the command hunts in the dead band."""
    signals, noise = recording.signals.copy(), np.random.default_rng(3)
    count = signals.shape[1] - 900
    signals[:, 900:] = signals[:, 899:900] + np.array([0.0, 5e3, 2e4, 1e-3, 0.0])[:, None] * noise.normal(size=count)
    signals[3:, 900:] += 0.015 * np.sin(0.8 * np.arange(count)) - signals[3:, 899:900]
    signals[0] = 25e-6 * np.round(signals[0] / 25e-6)
    return changed(recording, signals=signals)


CASES = {
    "encoder at rest": (resting_encoder, []),
    "end of the position's range": (
        edited(0, slice(None), lambda v: np.minimum(v, np.quantile(v, 0.7))),
        [(NOTE, " mm, the end of its readings: left out there")],
    ),
    "position frozen": (edited(0, slice(700, None), 0.0), [(FAULT, "position is stuck at one value")]),
    "nothing": (lambda r: r, []),
    "clock 1 % off": (restamped(lambda t: 1.01 * t), []),
    "chambers exchanged": (
        lambda r: changed(r, signals=r.signals[[0, 2, 1, 3, 4]]),
        [(SEVERE, "with the pressures of the chambers exchanged")],
    ),
    "position turned": (scaled(-1, 1, 1, 1, 1), [(SEVERE, "the other sign of the position")]),
    "spool turned": (scaled(1, 1, 1, -1, 1), [(SEVERE, "spool_position moves against the command")]),
    "valve turned": (scaled(1, 1, 1, -1, -1), [(SEVERE, "the other sign of spool and command")]),
    "mm as m": (scaled(1e3, 1, 1, 1, 1), [(SEVERE, "position reads")]),
    "m as mm": (scaled(1e-3, 1, 1, 1, 1), [(SEVERE, "times as far as the valve's flow")]),
    "psi as bar": (scaled(1, 14.5, 14.5, 1, 1), [(SEVERE, "psi instead of bar"), (SEVERE, "psi instead of bar")]),
    "MPa as bar": (scaled(1, 0.1, 0.1, 1, 1), [(SEVERE, "MPa instead of bar")]),
    "V as parts": (scaled(1, 1, 1, 1, 10), [(SEVERE, "command reads")]),
    "parts as %": (scaled(1, 1, 1, 0.01, 1), [(SEVERE, "0.01 times as far as the command")]),
    "zero at the end": (edited(0, slice(None), lambda v: v + 0.25), [(SEVERE, "an offset of -200 mm would fit")]),
    "command to 10.1 V": (
        edited(4, slice(None), lambda v: 1.01 * v / np.abs(v).max()),
        [(NOTE, "(10.1 V): taken as full scale")],
    ),
    "command at 10.8 V": (edited(4, slice(300, 303), 1.08), [(SEVERE, "108 %, but the rig has -100 % to 100 %")]),
    "constant": (edited(1, slice(None), 30 * BAR), [(SEVERE, "pressure_a is constant at 30 bar")]),
    "stuck": (edited(2, slice(400, 600), 51 * BAR), [(FAULT, "stuck at one value, first at 2.000 to 2.995 s")]),
    "cut off": (edited(2, slice(None), lambda v: np.minimum(v, np.median(v))), [(FAULT, "pressure_b is cut off")]),
    "lost": (edited(0, slice(7, None, 31), -0.2), [(FAULT, "position loses readings: it falls 39 times to -200 mm")]),
    "spikes": (edited(1, slice(50, None, 100), 9e8), [(NOTE, "pressure_a has single values")]),
    "NaN": (edited(3, slice(100, 110), np.nan), [(NOTE, "spool_position lacks readings, first at 0.500 to 0.545 s")]),
    "most NaN": (edited(3, slice(100, None), np.nan), [(SEVERE, "spool_position lacks readings")]),
    "commands NaN": (edited(4, slice(100, 400), np.nan), [(SEVERE, "command lacks readings")]),
    "a slow program": (blank(4), [(NOTE, "pressure_a lacks readings"), (NOTE, "pressure_b lacks readings")]),
    "a slow program, position turned": (
        lambda r: scaled(-1, 1, 1, 1, 1)(blank(4)(r)),
        [(NOTE, "lacks readings"), (NOTE, "lacks readings"), (SEVERE, "the other sign of the position")],
    ),
    "pressures in steps of 2 bar": (edited(slice(1, 3), slice(None), lambda v: 2 * BAR * np.round(0.5 * v / BAR)), []),
    "pressures of a historian": (edited(slice(1, 3), slice(None), held), []),
    "stuck in whole bar": (
        lambda r: edited(1, slice(None), lambda v: BAR * np.round(v / BAR))(edited(1, slice(400, 600), 51 * BAR)(r)),
        [(FAULT, "pressure_a is stuck at one value, first at 2.0")],
    ),
    "the set point as command": (as_set_point(1.0), [(SEVERE, "command is the set point of the position")]),
    "the set point beyond full scale": (as_set_point(100.0), [(SEVERE, "command is the set point of the position")]),
    "a pause": (
        lambda r: changed(r, time=r.time + 60.0 * (r.time > 3.0)),
        [(NOTE, "time has a gap of 60 s, first at 3.000 to 63.005 s")],
    ),
    "a day's pause, with jitter": (
        restamped(lambda t: np.sort(t + np.random.default_rng(0).uniform(-4e-3, 4e-3, len(t))) + 86400.0 * (t > 3.0)),
        [(NOTE, "ms; taken as equidistant rows"), (NOTE, "time has a gap of 8.64e+04 s")],
    ),
    "many gaps": (rows(lambda n: np.flatnonzero(np.arange(n) % 10 < 7)), [(SEVERE, "time has 119 gaps")]),
    "gap": (rows(lambda n: np.r_[0:400, 440:n]), [(NOTE, "time has a gap of 200 ms, first at 1.995 to 2.200 s")]),
    "twice": (rows(lambda n: np.r_[0:400, 399:n]), [(NOTE, "time has duplicate stamps")]),
    "backward": (restamped(lambda t: np.r_[t[:400], t[400:] - 1.0]), [(SEVERE, "runs backward 1 times, by up to")]),
    "jitter": (
        restamped(lambda t: t + np.random.default_rng(0).uniform(-3e-4, 3e-4, len(t))),
        [(NOTE, "time has stamps that jitter")],
    ),
    "great jitter": (lambda r: late(r), [(NOTE, "ms; taken as equidistant rows")]),
    "a gap in stamps that jitter": (
        lambda r: rows(lambda n: np.r_[0:500, 520:n])(late(r)),
        [(NOTE, "ms; taken as equidistant rows"), (NOTE, "time has a gap of 100 ms")],
    ),
    "a lost row behind jitter": (
        lambda r: late(rows(lambda n: np.r_[0:500, 502:n])(r)),
        [(SEVERE, "the rows are not equidistant")],
    ),
    "every second row": (rows(lambda n: slice(0, n, 2)), [(SEVERE, "the commands between the rows are unknown")]),
    "ms as s": (restamped(lambda t: 1e3 * t), [(SEVERE, "stamps in ms instead of s would fit")]),
}


@pytest.mark.parametrize("case", CASES)
def test_damage_is_found_and_nothing_else(recording, case):
    damage, wanted = CASES[case]
    found = check_recording(damage(recording), CONFIG).findings
    assert [finding.weight for finding in found] == [weight for weight, _ in wanted], [f.line() for f in found]
    for finding, (_, words) in zip(found, wanted, strict=True):
        assert words in finding.line()


@pytest.mark.parametrize("absent", [[3], [1, 2, 3]])
def test_a_wrong_sign_is_found_with_fewer_sensors(recording, absent):
    for turned, words in ((1.0, ""), (-1.0, "a move by a positive command settles it")):
        signals = recording.signals * np.array([turned, 1, 1, 1, 1])[:, None]
        signals[absent] = np.nan
        severe = check_recording(changed(recording, signals=signals), CONFIG).severe
        assert words in severe[0].line() if words else not severe


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_the_sign_of_a_load_pressure_is_checked(recording, sign):
    load = {"differential_pressure": True, "pressure_a": {"low": -1e7}, "pressure_b": {"fitted": False}}
    signals = np.full_like(recording.signals, np.nan)
    signals[[0, 1, 4]] = (
        recording.signals[0],
        sign * (recording.signals[1] - recording.signals[2]),
        recording.signals[4],
    )
    one = changed(recording, signals=signals)._replace(differential=True)
    severe = check_recording(one, task_config(CONFIG, sensors=load)).severe
    assert [("the other sign)" in finding.line()) for finding in severe] == [True] * (sign < 0)


def test_faulty_readings_are_left_out(recording):
    samples = check_recording(edited(0, slice(7, None, 31), -0.2)(recording), CONFIG).samples
    assert np.isnan(samples.signals[0, 7::31]).all()
    assert np.isfinite(np.delete(samples.signals[0], np.s_[7::31])).all()


def test_a_faster_recording_keeps_the_rows_in_which_the_controller_sampled(recording):
    # Five rows per period; the command of sample k acts from 1 ms after it, so that row 5 k still shows the one before.
    signals = np.repeat(recording.signals, 5, axis=1)
    signals[4] = np.append(signals[4, 4:], np.full(4, signals[4, -1]))
    offset = np.random.default_rng(1).normal(0.0, 3e-5, signals.shape[1])
    offset[::5] = 0.0
    signals[0] += offset  # only the right rows hold the readings unchanged
    fast = changed(recording, time=1e-3 * np.arange(signals.shape[1]), signals=signals)
    checked = check_recording(fast, CONFIG)
    assert checked.findings == []
    np.testing.assert_array_equal(checked.samples.signals[0], recording.signals[0])
    np.testing.assert_array_equal(checked.samples.signals[4], recording.signals[4])


def stepped(rows_per_second, steps, duration=1.0):
    """A fast log of a step test in open loop: the command takes each level of ``steps`` (time in s, level)."""
    time = np.arange(round(duration * rows_per_second)) / rows_per_second
    command = np.zeros(len(time))
    for begin, level in steps:
        command[time >= begin - 1e-9] = level
    noise = np.random.default_rng(0)
    signals = np.full((5, len(time)), np.nan)
    signals[0] = 0.02 * time + np.where(noise.random(len(time)) < 0.08, 0.01, 0.0)  # spikes
    signals[4] = command
    return Recording("steps", time, signals, {}, [])


def test_a_fast_log_of_a_few_commands_is_taken_on_its_own_grid():
    checked = check_recording(stepped(10_000, [(0.1003, 0.1), (0.5, 0.0), (0.6012, -0.1)]), CONFIG)
    samples = checked.samples
    assert samples.period == pytest.approx(1e-3)
    assert any("each sample the median of 10 rows" in finding.line() for finding in checked.findings)
    np.testing.assert_allclose(samples.signals[0], 0.02 * samples.time, atol=2e-5)  # without the spikes
    # Column k holds what acted since the sample before: a step at 0.5 s shows in the sample that follows it.
    assert samples.time[np.flatnonzero(np.diff(samples.signals[4])) + 1] == pytest.approx(
        [0.1013, 0.501, 0.602], abs=1e-3
    )
    assert on_grid(CONFIG, samples.period).control_period == samples.period
    assert on_grid(CONFIG, samples.period).command_latency == 0.0
    assert on_grid(CONFIG, CONFIG.control_period) is CONFIG


def test_readings_of_a_slow_sensor_between_the_samples_of_the_controller_are_kept(recording):
    """A log of 1 kHz with a pressure at every tenth row, 2 ms after a sample of the controller."""
    signals = np.repeat(recording.signals, 5, axis=1)
    signals[1, np.arange(signals.shape[1]) % 10 != 2] = np.nan
    fast = changed(recording, time=1e-3 * np.arange(signals.shape[1]), signals=signals)
    samples = check_recording(fast, CONFIG).samples
    assert samples.period == pytest.approx(1e-3)
    np.testing.assert_array_equal(samples.signals[1][np.isfinite(samples.signals[1])], recording.signals[1, ::2])


@pytest.mark.parametrize("period", [1.0 / 204.8, 7e-3])
def test_a_log_that_does_not_fit_the_control_period_has_a_grid_of_its_own(recording, period):
    """The same rows with another clock: nothing but the period changes."""
    samples = sampled(restamped(lambda t: period / CONFIG.control_period * t)(recording), CONFIG)
    assert samples.period == pytest.approx(period, rel=1e-4)
    np.testing.assert_allclose(samples.time, period * np.arange(len(recording.time)), atol=1e-3 * period)
    np.testing.assert_array_equal(samples.signals[:4], recording.signals[:4])


def test_windows_keep_gaps_as_missing_samples(recording):
    windows = cut(check_recording(rows(lambda n: np.r_[0:400, 440:n])(recording), CONFIG).samples, 300)
    np.testing.assert_allclose(windows.begin, [0.0, 1.5, 3.0, 4.5])
    assert windows.commanded.tolist() == [True, False, True, True]
    np.testing.assert_array_equal(windows.signals[0], recording.signals[:, :300])
    assert np.isnan(windows.signals[1, :, 100:140]).all()
    np.testing.assert_array_equal(windows.signals[1, :, 140:], recording.signals[:, 440:600])


def test_single_lost_commands_are_filled_in_from_the_signals_around_them(recording):
    lost = np.arange(50, 1150, 100)
    damaged = rows(lambda n: np.delete(np.arange(n), [*lost, 1000, 1001, 1002, 1003]))(recording)
    samples, findings = bridged(check_recording(damaged, CONFIG).samples)
    assert [finding.weight for finding in findings] == [NOTE]
    assert np.isin([*lost, 999, 1000], samples.place).tolist() == [True] * len(lost) + [True, False]
    error = samples.signals[4, np.searchsorted(samples.place, lost)] - recording.signals[4, lost]
    assert np.abs(error).max() < 0.5 * np.std(recording.signals[4, lost] - recording.signals[4, lost - 1])
    assert np.isnan(samples.signals[:4, np.searchsorted(samples.place, lost)]).all()
    assert cut(samples, 300).commanded.tolist() == [True, True, True, False]


@pytest.mark.parametrize("own_grid", [False, True])
def test_stamps_too_close_for_any_rig_are_a_finding(recording, own_grid):
    samples = sampled(changed(recording, time=1e-310 * recording.time), CONFIG, own_grid)
    assert not len(samples.time)
    assert [finding.weight for finding in samples.findings] == [SEVERE]


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_motion_at_one_speed_is_judged_by_its_mean(sign):
    """The little that a steady flow changes says nothing: here it runs against the changes of the speed."""
    signals = np.tile(np.array([[0.0], [40.0 * BAR], [60.0 * BAR], [0.2], [2.0]]), 1000)
    time, c = CONFIG.control_period * np.arange(1000), plant_coefficients(CONFIG.plant)
    signals[3] -= 1e-3 * np.cos(3.0 * time)
    speed = flow_into_a(signals, CONFIG).mean() / c.area_a
    signals[0] = sign * (speed * (time - 1.0) + 2e-3 * np.sin(3.0 * time))
    assert balance(signals, CONFIG).slope == pytest.approx(sign, rel=0.05)
