"""The parts of recordings: windows for the fit, and what is held back."""

import numpy as np
import pytest
from refusal import refused

from hydro_env.task.sensors import COMMAND, POSITION
from hydro_rig.recordings.parts import liveliest, parts_of
from hydro_rig.recordings.sampling import Sampled, cut

PERIOD = 0.005


def samples_of(count, place=None):
    """A recording of ``count`` samples that moves in its second half."""
    time = PERIOD * np.arange(count)
    signals = np.zeros((5, count))
    signals[POSITION] = np.where(time > 0.5 * time[-1], 0.01 * np.sin(9.0 * time), 0.0)
    signals[COMMAND] = np.linspace(-0.5, 0.5, count)
    place = np.arange(count) if place is None else place
    return Sampled(place, PERIOD * place, signals, PERIOD, {}, [])


def parts_alone(samples):
    return parts_of([samples], ["a.csv"])


def test_the_last_part_with_its_share_of_the_motion_is_held_back():
    parts = parts_alone(samples_of(4000))  # it moves from 10 s to 20 s
    (part,) = parts.held_back
    assert part.begin == 8.0  # two of five moving windows; the last three windows would have most of the motion
    np.testing.assert_array_equal(part.signals, samples_of(4000).signals[:, 1600:2800])
    assert parts.fitted.begin.tolist() == [0.0, 2.0, 4.0, 6.0, 14.0, 16.0, 18.0]
    assert parts.findings == [[]]


def test_an_axis_that_always_moves_is_held_back_from_the_end():
    samples = samples_of(4000)
    samples.signals[POSITION] = 0.01 * np.sin(9.0 * samples.time)
    assert parts_alone(samples).held_back[0].begin == 14.0


def test_of_a_long_recording_each_section_gives_its_liveliest_window():
    parts = parts_alone(samples_of(40_000))
    assert len(parts.fitted.begin) == 12
    assert (np.diff(parts.fitted.begin) > 0.0).all()
    # The axis moves from 100 s on: the section that holds this moment gives a window behind it.
    assert not ((parts.fitted.begin >= 94.0) & (parts.fitted.begin < 98.0)).any()
    assert parts.held_back[0].signals.shape[1] == 2000


def test_a_fast_move_to_a_stop_beyond_the_sensor_is_used_and_a_rest_there_is_not():
    samples = samples_of(4000)
    samples.signals[POSITION, 2400:3200] = np.nan
    samples.signals[POSITION, 2400:2500] = np.linspace(-0.01, 0.01, 100)
    parts = parts_of([samples, samples_of(4000)], ["a.csv", "b.csv"], [1])
    assert [begin in parts.fitted.begin for begin in (12.0, 14.0)] == [True, False]


def levels(amplitudes, sensors):
    """Recordings with these largest commands; each has only the named one of the two pressures."""
    recordings = []
    for amplitude, pressure in zip(amplitudes, sensors, strict=True):
        samples = samples_of(1600)
        samples.signals[COMMAND] *= amplitude / 0.5
        samples.signals[3 - pressure] = np.nan
        recordings.append(samples)
    return recordings


@pytest.mark.parametrize(
    ("amplitudes", "sensors", "apart", "reason"),
    [
        ([0.1, 0.2, 0.3], [1, 1, 1], [1], "another amplitude"),
        ([0.1, 0.1, 0.2, 0.2, 0.3, 0.3], [1, 2] * 3, [2, 3], "another amplitude"),
        ([0.1, 0.1, 0.2, 0.2], [1, 2, 1, 2], [2, 3], "other recordings"),
        ([0.1, 0.1], [1, 2], [], "share of the motion"),
    ],
)
def test_whole_recordings_are_held_back_by_amplitude_and_sensors(amplitudes, sensors, apart, reason):
    recordings = levels(amplitudes, sensors)
    names = [f"{k}.csv" for k in range(len(recordings))]
    parts = parts_of(recordings, names)
    assert reason in parts.reason
    assert parts.amplitudes == len({amplitudes[number] for number in parts.recording})
    if apart:
        assert [part.recording for part in parts.held_back] == apart
        assert not set(apart) & set(parts.recording.tolist())
        assert parts.held_back[0].signals.shape[1] == 1600  # whole
    else:
        assert [part.recording for part in parts.held_back] == [0, 1]
    asked = parts_of(recordings, names, {0})
    assert [part.recording for part in asked.held_back] == [0]
    assert 0 not in asked.recording


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
    with refused(words):
        parts_alone(samples)


def test_a_recording_of_a_second_is_refused():
    with refused("holds 1 s of samples; at least 2 s are needed"):
        parts_alone(samples_of(200))


@pytest.mark.parametrize("lost", [False, True])
def test_of_each_five_minutes_the_window_with_the_most_motion_is_kept(lost):
    """An axis moves for 20 s in each minute, most at 310 s; where commands are lost, another window counts."""
    samples = samples_of(124_000)
    busy = (samples.time % 60.0 < 20.0) * (1.0 + (np.abs(samples.time - 310.0) < 5.0))
    samples.signals[POSITION] = 0.02 * busy * np.sin(4.0 * samples.time)
    if lost:
        samples.signals[COMMAND, (np.abs(samples.time - 310.0) < 10.0) & (samples.time % 2.0 < 0.1)] = np.nan
    windows = cut(samples, 400)
    found = windows.part(liveliest(windows, 12, 300.0))
    assert len(found) == 3  # of 0 to 300 s, to 600 s, and to 620 s
    assert found.commanded.all()
    assert (304.0 <= found.begin[1] <= 314.0) == (not lost)
    assert found.begin[1] % 60.0 < 20.0
    assert len(liveliest(windows, 2, 300.0)) == 2
