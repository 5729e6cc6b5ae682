"""The parts of one or more recordings: windows for the fit, and the parts that are held back, which test it."""

from collections.abc import Collection, Mapping, Sequence
from typing import NamedTuple

import numpy as np

from hydro_agents.detection.detector import Windows
from hydro_env import ConfigurationError
from hydro_env.task.sensors import COMMAND, POSITION
from hydro_env.types import Floats, Indices, Mask
from hydro_rig.recordings.findings import Finding
from hydro_rig.recordings.recording import FULL_COMMAND
from hydro_rig.recordings.sampling import Sampled, bridged, cut

WINDOW, FEWEST_WINDOWS = 2.0, 5  # s, number; recordings that are too short for five windows have shorter ones
SHORTEST_WINDOW = 0.4  # s; shorter windows give too little information, because their start is unknown
HELD_BACK_SHARE = 0.3  # of a single recording
MOST_TRAVEL = 0.5  # largest share of the travel in the part that is held back
MOST_WINDOWS = 12  # more take longer and add little: of a longer recording, each twelfth gives its liveliest
FAST = 0.5  # of the longest travel in a window: a move to a stop beyond the sensor's range, which is over soon
FEWEST_OF_EACH = 3  # windows of each recording, if there are many: one out, one back, and one that ends at rest
LONGEST_HELD_BACK = 10.0  # s, of one recording
LONGEST_WHOLE = 60.0  # s, of a recording that is held back as a whole
SAME_AMPLITUDE = 1.1  # largest ratio of the largest commands of recordings with the same amplitude
MOST_AT_FULL_COMMAND = 0.9  # share of the time; a recording with more gives no information about the valve


class Stretch(NamedTuple):
    """A part of a recording that the fit does not use."""

    recording: int  # its number, from 0
    begin: float  # s
    signals: Floats  # (5, T), in the order of SIGNALS
    boundary: Floats  # (2, T), recorded supply and tank pressure, Pa; NaN: not recorded


class Parts(NamedTuple):
    """Recordings cut in parts."""

    fitted: Windows  # for the fit
    recording: Indices  # (B,), the number of the recording of each of these windows
    amplitudes: int  # number of different largest commands among the recordings of the fit
    held_back: list[Stretch]
    reason: str  # how the held-back parts were chosen
    findings: list[list[Finding]]  # changes to the samples, by recording


def parts_of(recordings: Sequence[Sampled], sources: Sequence[str], whole: Collection[int] = ()) -> Parts:
    """Choose the parts of recordings with one sample time.

    Held back are, in this order: the recordings whose numbers the caller names (``whole``); of recordings with three or
    more amplitudes of the command, those with the middle one; of repeated recordings, the last with the same sensors;
    otherwise a stretch of each recording, the last one that holds its share of the travel.

    Raises:
        ConfigurationError: a position is missing, a command is saturated, or too few samples are without a gap.
    """
    for samples, source in zip(recordings, sources, strict=True):
        _refuse_useless(samples, source)
    length = _window_length(recordings, sources)
    filled = [bridged(samples) for samples in recordings]
    pieces = [cut(samples, length) for samples, _ in filled]
    commanded = [one.part(one.commanded) for one in pieces]
    cuts = [one.part(_shows_position(one)) for one in commanded]
    together = sources[0] if len(sources) == 1 else f"{len(sources)} recordings"
    count = sum(map(len, cuts))
    if count < FEWEST_WINDOWS - 1:
        raise ConfigurationError(
            f"{together}: only {count} windows of {length * recordings[0].period:g} s have all commands and a "
            f"position; at least {FEWEST_WINDOWS - 1} are needed"
        )
    apart, reason = _apart(cuts, whole)
    used = {}
    held_back = []
    for number, windows in enumerate(cuts):
        if number not in apart:
            held = np.zeros(len(windows), bool) if apart else _with_motion(windows)
            if held.any():
                held_back.append(_as_stretch(number, windows.part(held), LONGEST_HELD_BACK))
            if not held.all():
                used[number] = windows.part(~held)
        elif len(windows):
            held_back.append(_as_stretch(number, commanded[number], LONGEST_WHOLE))
        else:
            raise ConfigurationError(f"{sources[number]}: has no window with all commands and a position to hold back")
    if not used:
        raise ConfigurationError(f"{together}: nothing is left for the fit; hold back fewer recordings")
    most = max(MOST_WINDOWS // len(used), FEWEST_OF_EACH)
    fitted = []
    for windows in used.values():
        section = windows.end[-1] / most if len(used) == 1 and len(windows) > most else 0.0
        fitted.append(windows.part(liveliest(windows, most, section)))
    return Parts(
        fitted=Windows.joined(fitted),
        recording=np.repeat(list(used), list(map(len, fitted))),
        amplitudes=len(_by_amplitude(used)),
        held_back=held_back,
        reason=reason,
        findings=[findings for _, findings in filled],
    )


def _refuse_useless(samples: Sampled, source: str) -> None:
    if not np.isfinite(samples.signals[POSITION]).any():
        raise ConfigurationError(f"{source}: position was not recorded; without it nothing can be identified")
    full = np.mean(np.abs(samples.signals[COMMAND]) >= FULL_COMMAND)
    if full > MOST_AT_FULL_COMMAND:
        raise ConfigurationError(
            f"{source}: command is at its limit for {100 * full:.0f} % of the recording; the valve was saturated, "
            "which hides its flow, edges and dynamics: record the axis while it follows a reference"
        )


def _window_length(recordings: Sequence[Sampled], sources: Sequence[str]) -> int:
    """Samples of a window.

    Raises:
        ConfigurationError: the recordings are too short for five windows, or one of them for a single window.
    """
    period = recordings[0].period
    durations = [len(samples.time) * period for samples in recordings]
    length = round(min(WINDOW, sum(durations) / FEWEST_WINDOWS, *durations) / period)
    if length * period < SHORTEST_WINDOW:
        needed = SHORTEST_WINDOW * (FEWEST_WINDOWS if len(sources) == 1 else 1)
        shortest = int(np.argmin(durations))
        raise ConfigurationError(
            f"{sources[shortest]}: holds {durations[shortest]:.3g} s of samples; at least {needed:g} s are needed"
        )
    return length


def _apart(cuts: Sequence[Windows], whole: Collection[int]) -> tuple[set[int], str]:
    """Numbers of the recordings that are held back as a whole, and why; none if parts of each are held back."""
    if whole:
        return set(whole), "as asked for"
    known = {number: windows for number, windows in enumerate(cuts) if len(windows)}
    amplitudes = _by_amplitude(known)
    if len(amplitudes) > 2:
        return set(amplitudes[len(amplitudes) // 2]), "another amplitude of the command than those of the fit"
    alike: dict[bytes, list[int]] = {}  # numbers of the recordings by the sensors that they have
    for number, windows in known.items():
        alike.setdefault(np.isfinite(windows.signals).any(axis=(0, 2)).tobytes(), []).append(number)
    apart = {numbers[-1] for numbers in alike.values() if len(numbers) > 1}
    parts = "the last part of each recording with its share of the motion"
    return apart, "other recordings than those of the fit" if apart else parts


def _by_amplitude(cuts: Mapping[int, Windows]) -> list[list[int]]:
    """Numbers of the recordings in groups of the same largest command, the smallest first."""
    largest = {number: np.nanmax(np.abs(windows.signals[:, COMMAND])) for number, windows in cuts.items()}
    amplitudes: list[list[int]] = []
    for number in sorted(cuts, key=largest.__getitem__):
        if not amplitudes or largest[number] > SAME_AMPLITUDE * largest[amplitudes[-1][0]]:
            amplitudes.append([])
        amplitudes[-1].append(number)
    return amplitudes


def _shows_position(windows: Windows) -> Mask:
    """The windows (B,) with most readings of the position, not at rest at the end of its range, or with a fast move.

    A slow sensor has few readings in every window.
    """
    travel = _ranges(windows.signals)[:, POSITION]
    readings = np.isfinite(windows.signals[:, POSITION]).mean(axis=1)
    most = readings > 0.5 * readings.max(initial=0.0)
    return most | (travel > FAST * travel.max(initial=0.0))


def _ranges(signals: Floats) -> Floats:
    """Range of each signal in each window, (N, channels), from (N, channels, T); 0 without two readings."""
    known = np.isfinite(signals)
    low, high = (np.where(known, signals, end) for end in (np.inf, -np.inf))
    return np.maximum(high.max(axis=2) - low.min(axis=2), 0.0)


def liveliest(windows: Windows, most: int, section: float = 0.0) -> Indices:
    """Numbers of at most ``most`` windows in which the sensors' signals vary most, relative to their largest ranges.

    Windows with all commands come first. With a ``section``, s, each of these parts of a recording gives one.
    """
    ranges = _ranges(windows.signals[:, :COMMAND])
    activity = (ranges / np.maximum(ranges.max(axis=0, initial=0.0), 1e-300)).sum(axis=1)
    order = np.lexsort((-activity, ~windows.commanded))
    if section:
        _, first = np.unique(np.floor(windows.begin[order] / section + 1e-6), return_index=True)
        order = order[np.sort(first)]
    return np.sort(order[:most])


def _with_motion(windows: Windows) -> Mask:
    """The windows (B,) of a recording to hold back: the last stretch of them with its share of the travel or more.

    It has HELD_BACK_SHARE of the windows, and at most MOST_TRAVEL of the travel. Without such a stretch it is the last.
    """
    count = len(windows)
    chosen = np.zeros(count, bool)
    if count < 2:
        return chosen
    span = windows.end[0] - windows.begin[0]
    size = min(max(count - round((1.0 - HELD_BACK_SHARE) * count), 1), max(round(LONGEST_HELD_BACK / span), 1))
    travel = _ranges(windows.signals)[:, POSITION]
    for begin in range(count - size, -1, -1):
        stretch = slice(begin, begin + size)
        if windows.end[begin + size - 1] - windows.begin[begin] > (size + 0.1) * span:
            continue  # a gap
        if size / count * travel.sum() <= travel[stretch].sum() <= MOST_TRAVEL * travel.sum():
            chosen[stretch] = True
            return chosen
    chosen[count - size :] = True
    return chosen


def _as_stretch(recording: int, windows: Windows, longest: float) -> Stretch:
    """The longest stretch of windows without a gap between them, at most ``longest`` s."""
    span = windows.end[0] - windows.begin[0]
    most = max(round(longest / span), 1)
    breaks = np.flatnonzero(np.abs(windows.begin[1:] - windows.end[:-1]) > 0.1 * span) + 1
    chosen = max(np.split(np.arange(len(windows)), breaks), key=len)[:most]
    signals, boundary = windows.signals[chosen], np.full((len(chosen), 2, windows.samples), np.nan)
    if windows.boundary is not None:
        boundary = windows.boundary[chosen]
    joined = (np.concatenate(values, axis=1) for values in (signals, boundary))
    return Stretch(recording, windows.begin[chosen[0]], *joined)
