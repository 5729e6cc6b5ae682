"""Resamples a recording at the control period of the rig: it checks time stamps, selects rows, and keeps gaps.

A log whose rows do not fit the control period, or whose commands keep no fixed place in it, such as a step test in open
loop, is taken on its own grid instead: its rows, or of a fast log about one sample per millisecond.
"""

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
import pandas as pd

from hydro_agents.detection.detector import Windows
from hydro_env import TaskConfig
from hydro_env.task.sensors import COMMAND
from hydro_env.types import Floats, Indices, Mask
from hydro_rig.recordings.findings import Finding, Findings, Weight, finding_of, runs_of, severe_if, severe_of
from hydro_rig.recordings.recording import Recording
from hydro_rig.recordings.stamps import SHORTEST_DISTANCE, SLOWEST, other_sampling, row_distance, whole_fraction

JITTER = (0.05, 0.4)
"""Jitter of time stamps, as a fraction of the row distance: limit for a note, and limit beyond which stamps do not tell
the place of a row."""

GAP = 4.0  # distance of rows with stamps that jitter, in usual ones, beyond which rows are missing between them

TOGETHER, APART = 100, 0.5
"""Rows are equidistant if the median of the stamps of so many of them leaves a steady clock by less than this share of
the row distance."""

MOST_LOST_ROWS = 0.2  # largest share of rows that may be missing in gaps, or duplicate
PAUSE = 1.0  # s; a longer gap is a pause of the recording, which leaves the rows before and after it
FOLLOWING = 0.1  # share of a stamp's deviation by which the clock is corrected: a slightly wrong one loses no row
LONGEST_FILL = 3  # largest number of successive missing commands that are filled in
HOLD_SHARE = 0.8  # smallest share of command changes at the same row within the control period
OWN_PERIOD = 1e-3  # s, approximate distance of the samples on a log's own grid; from a faster log, medians of its rows


class Sampled(NamedTuple):
    """A recording at the control period; T samples."""

    place: Indices  # (T,), number of the control period since the first sample, rising; a gap skips numbers
    time: Floats  # (T,), s
    signals: Floats  # (5, T), SI, in the order of SIGNALS: column k holds u_{k-1}
    period: float  # s
    units: dict[str, str]  # by signal, as in the file
    findings: Findings
    auxiliary: Mapping[str, Floats] = {}  # the recorded ones of AUXILIARY by name, each (T,), SI
    own_clock: bool = False  # whether the samples may lie between those of the controller


EQUIDISTANT = " ('equidistant: true' for the time in the map takes the rows as equidistant)"

_Grid = tuple[Indices, Floats, Floats, float, bool]
"""Rows of a recording as samples: place and time (T,), values (channels, T), period in s; whether by a clock that may
not be that of the controller."""


def sampled(recording: Recording, config: TaskConfig, own_grid: bool = False) -> Sampled:
    """The samples of a recording, one per control period of the task, or on the log's own grid (:func:`on_grid`).

    From n rows per control period, the last row before the command changes is the sample; the command of the previous
    period still acts there. After a severe finding the samples are empty. ``own_grid``: also of a log that fits the
    control period.
    """
    findings: Findings = []
    place, time, values, period, own_clock = _grid_of(recording, config, own_grid, findings)
    signals, others = np.split(values, [len(recording.signals)])
    auxiliary = dict(zip(recording.auxiliary, others, strict=True))
    return Sampled(place, time, signals, period, recording.units, findings, auxiliary, own_clock)


def _grid_of(recording: Recording, config: TaskConfig, own_grid: bool, findings: Findings) -> _Grid:
    """The samples of the rows; none after a severe finding."""
    time, rows = recording.time, np.vstack([recording.signals, *recording.auxiliary.values()])
    period = config.control_period
    nothing = np.zeros(0, np.int64), time[:0], rows[:, :0], period, False
    time, rows = _in_order(time, rows, findings)
    if severe_of(findings):
        return nothing
    distance = row_distance(time, period)
    per_period = whole_fraction(distance, period)
    own = own_grid or (not per_period and distance < SLOWEST * period)
    if distance < SHORTEST_DISTANCE or not (own or per_period):
        findings.append(other_sampling(distance, period, recording.units.get("time", "s")))
        return nothing
    place, jitter = _places(time, distance)
    if jitter > JITTER[0] * distance:
        usual = f"{1e3 * jitter:.2g} ms (95 %) around one row every {1e3 * distance:.4g} ms"
        findings.append(Finding("time", f"has stamps that jitter by up to {usual}"))
    if jitter > JITTER[1] * distance:
        time, kept = _steady(time, distance, findings)
        rows = rows[:, kept]
        if severe_of(findings):
            return nothing
        distance = time[1] - time[0]
        place, _ = _places(time, distance)
    _add_gaps(place, time, distance, findings)
    if severe_of(findings):
        return nothing
    phase = None if own else _phase(place, rows[COMMAND], per_period, distance, config)
    chosen = place % max(per_period, 1) == phase
    # A slow sensor may have its readings in other rows than the controller its samples.
    known = np.isfinite(rows)
    if phase is None or (known[:, chosen].mean(axis=1) < 0.5 * known.mean(axis=1)).any():
        return _own_grid(time, rows, place, distance, findings)
    index = (place[chosen] - place[chosen][:1]) // per_period
    return index, time[chosen], rows[:, chosen], period, False


def _in_order(time: Floats, rows: Floats, findings: Findings) -> tuple[Floats, Floats]:
    """Stamps (n,) and rows (channels, n), of duplicate stamps the first; severe: stamps that run backward, or one."""
    steps = np.diff(time, prepend=-np.inf)
    if (back := steps < 0.0).any():
        worst = f"runs backward {int(back.sum())} times, by up to {-steps.min():.3g} s{EQUIDISTANT}"
        findings.append(finding_of(back, time, "time", worst, Weight.SEVERE))
    elif (twice := steps == 0.0).any():
        what = f"has duplicate stamps; the first row counts{EQUIDISTANT}"
        findings.append(finding_of(twice, time, "time", what, severe_if(twice.mean() > MOST_LOST_ROWS)))
        time, rows = time[~twice], rows[:, ~twice]
    if len(time) < 2:
        findings.append(Finding("time", "has one stamp alone", Weight.SEVERE))
    return time, rows


def _steady(time: Floats, distance: float, findings: Findings) -> tuple[Floats, Indices]:
    """Stamps (n,) of equidistant rows in place of stamps that jitter, and the rows that are kept.

    Short pieces between gaps are left out. Severe: the rows are not equidistant.
    """
    pieces = np.split(np.arange(len(time)), np.flatnonzero(np.diff(time) > GAP * distance) + 1)
    kept = [piece for piece in pieces if len(piece) > TOGETHER]
    equal = bool(kept)
    steady = time.copy()
    for piece in kept:
        steady[piece] = np.polyval(np.polyfit(piece, time[piece], 1), piece)
        off = time[piece] - steady[piece]
        late = [float(np.median(part)) for part in np.array_split(off, len(piece) // TOGETHER + 1)]
        equal &= np.ptp(late) < APART * distance
    what = findings.pop().what
    if equal:
        findings.append(Finding("time", f"{what}; taken as equidistant rows"))
    else:
        what += ", and the rows are not equidistant: nobody knows when the commands acted"
        findings.append(Finding("time", what, Weight.SEVERE))
    chosen = np.concatenate([*kept, np.empty(0, np.int64)])
    return steady[chosen], chosen


def _own_grid(time: Floats, values: Floats, place: Indices, distance: float, findings: Findings) -> _Grid:
    """The samples of a log on its own grid of about OWN_PERIOD.

    From a faster log, readings are medians of the rows around each sample, which leave out spikes. As many commands as
    possible change at a sample: in column k stands the one that acted since the sample before.
    """
    rows = max(round(OWN_PERIOD / distance), 1)
    period = float(f"{rows * distance:.6g}")
    changed = place[1:][np.abs(np.diff(values[COMMAND])) > 0.0]
    first = np.bincount(changed % rows, minlength=rows).argmax()
    samples = pd.DataFrame(values.T).groupby((place - first + rows // 2) // rows).median()
    number = samples.index.to_numpy()
    acting = pd.Series(values[COMMAND]).groupby((place - first) // rows + 1).median()
    samples[COMMAND] = acting.reindex(number)
    if len(number) > 1 and number[1] == number[0] + 1 and np.isnan(samples[COMMAND].iloc[0]):
        samples.iloc[0, COMMAND] = values[COMMAND, 0]  # what acted before the first row
    what = f"has one row every {1e3 * distance:.4g} ms and no fixed place for command and readings in the control "
    what += "period; taken on its own grid"
    what += f", each sample the median of {rows} rows" if rows > 1 else ""
    findings.append(Finding("time", what))
    number = number - number[0]
    return number, time[0] + number * period, samples.to_numpy().T.copy(), period, True


def on_grid(config: TaskConfig, period: float) -> TaskConfig:
    """The task with the sample time of a log on its own grid, in which a command acts when it is logged."""
    if period == config.control_period:
        return config
    return config.changed(control_period=period, command_latency=0.0, command_latency_range=None)


def bridged(samples: Sampled) -> tuple[Sampled, Findings]:
    """The samples with up to LONGEST_FILL missing commands in a row filled in, and a finding about them.

    Lost rows come back with this command alone; readings stay missing. A command comes from the signals
    around it: the linear combination that fits the other commands of the recording best.
    """
    jumps = np.diff(samples.place)
    short = np.flatnonzero((jumps > 1) & (jumps <= LONGEST_FILL + 1))
    lost = [samples.place[k] + np.arange(1, jumps[k]) for k in short]
    place = np.sort(np.concatenate([samples.place, *lost]))
    at = np.searchsorted(place, samples.place)

    signals = _spread(samples.signals, at, len(place))
    filled = np.zeros(len(place), bool)
    for begin, end in zip(*runs_of(np.isnan(signals[COMMAND])), strict=True):
        inside = begin > 0 and end < len(place) and end - begin <= LONGEST_FILL
        filled[begin:end] = inside and place[end] - place[begin - 1] == end - begin + 1
    if not filled.any():
        return samples, []
    signals[COMMAND, filled] = likely_commands(signals, filled)
    time = np.interp(place, samples.place, samples.time)
    what = f"lacks samples; up to {LONGEST_FILL} in a row are filled in from those around them"
    auxiliary = {name: _spread(values, at, len(place)) for name, values in samples.auxiliary.items()}
    samples = samples._replace(place=place, time=time, signals=signals, auxiliary=auxiliary)
    return samples, [finding_of(filled, time, "command", what)]


def _spread(values: Floats, at: Indices, count: int) -> Floats:
    """The values (…, n) at their places (n,) among ``count``; NaN elsewhere."""
    whole = np.full((*values.shape[:-1], count), np.nan)
    whole[..., at] = values
    return whole


def likely_commands(signals: Floats, filled: Mask) -> Floats:
    """The commands at ``filled`` (T,), from the signals (5, T) in the three rows before and after.

    They are the linear combination that fits the sure commands best; missing signals are interpolated.
    """
    places, sure = np.arange(signals.shape[1]), np.isfinite(signals[COMMAND])
    columns = [np.ones(len(places))]
    for values in signals:
        known = np.isfinite(values)
        if known.any():
            whole = np.interp(places, places[known], values[known])
            scale = whole.std() or 1.0
            columns += [np.roll((whole - whole.mean()) / scale, by) for by in (-3, -2, -1, 1, 2, 3)]
    around = np.column_stack(columns)
    weights, *_ = np.linalg.lstsq(around[sure], signals[COMMAND, sure], rcond=None)
    return np.clip(around[filled] @ weights, -1.0, 1.0)


def cut(samples: Sampled, length: int) -> Windows:
    """Windows of ``length`` samples; a shorter remainder and windows without any sample are left out."""
    window, place = samples.place // length, samples.place % length
    chosen = np.unique(window)
    if len(samples.place):
        chosen = chosen[(chosen + 1) * length <= samples.place[-1] + 1]
    inside = np.isin(window, chosen)
    at = length * np.searchsorted(chosen, window[inside]) + place[inside]

    def cut_out(values: Floats) -> Floats:
        return _spread(values[inside], at, length * len(chosen)).reshape(len(chosen), length)

    signals = np.stack([cut_out(values) for values in samples.signals], axis=1)
    auxiliary = {name: cut_out(values) for name, values in samples.auxiliary.items()}
    begin = np.asarray(chosen * length * samples.period, float)
    return Windows(signals, begin, begin + length * samples.period, auxiliary)


def _places(time: Floats, distance: float) -> tuple[Indices, float]:
    """Number of row distances since the first row, (n,), and the jitter of the stamps in s, 95 % quantile."""
    place, off = np.zeros(len(time), np.int64), np.zeros(len(time))
    clock, count = float(time[0]), 0
    for row, stamp in enumerate(time[1:].tolist(), 1):
        jump = max(round((stamp - clock) / distance), 1)
        count += jump
        place[row] = count
        error = stamp - clock - jump * distance
        off[row] = abs(error)
        clock = stamp - (1.0 - FOLLOWING) * error
    return place, np.quantile(off, 0.95)


def _add_gaps(place: Indices, time: Floats, distance: float, findings: Findings) -> None:
    """Append a finding about missing rows; those of a pause cost a window, and those of many gaps every window."""
    missing = np.diff(place, prepend=-1) - 1
    gaps = np.flatnonzero(missing > 0)
    if len(gaps):
        lost = missing[missing * distance < PAUSE].sum()
        seconds = distance * missing.max()
        longest = f"{seconds:.4g} s" if seconds >= PAUSE else f"{1e3 * seconds:.3g} ms"
        what = f"has {len(gaps)} gaps, the longest of {longest}" if len(gaps) > 1 else f"has a gap of {longest}"
        begin, end = time[gaps[0] - 1], time[gaps[0]]
        share, many = missing.sum() / (place[-1] + 1), lost > MOST_LOST_ROWS * (lost + len(place))
        findings.append(Finding("time", what, severe_if(many), begin, end, share))


def _phase(place: Indices, command: Floats, rows: int, distance: float, config: TaskConfig) -> int | None:
    """Index of the sample among the ``rows`` of a control period, from the rows in which the command changes.

    ``None``: they change at no fixed place in it.
    """
    known = np.isfinite(command)
    changed = (np.diff(command) != 0.0) & (np.diff(place) == 1) & known[1:] & known[:-1]
    changed = np.append(False, changed)
    if rows == 1 or not changed.any():  # a constant command: any row is suitable
        return 0
    counts = np.bincount(place[changed] % rows, minlength=rows)
    if counts.max() < HOLD_SHARE * changed.sum():
        return None
    back = max(round(config.command_latency / distance), 1)
    return int((counts.argmax() - back) % rows)
