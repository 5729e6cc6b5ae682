"""The one way from a recording to its verdict, for ``hydro diagnose``, ``trend`` and ``leak-test``.

The commands differ in the windows that they choose and in what reads them; all else is the same: what makes one of them
refuse makes all refuse, and a measured flow serves all.
"""

from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pandas as pd

from hydro_agents.detection.detector import Cause, Reading, Why, Windows
from hydro_agents.running.text import number
from hydro_env import HydroError, TaskConfig
from hydro_env.errors import reason
from hydro_rig.diagnosis.oil import Oil, referred, temperature_of
from hydro_rig.diagnosis.verdict import EXIT_CODES, Case, Leak, Limits, Verdict, judge
from hydro_rig.diagnosis.volume_balance import by_volume, volume_leak
from hydro_rig.estimation.estimator import EstimatorDetector
from hydro_rig.estimation.result import Estimate, join
from hydro_rig.estimation.solver import tell
from hydro_rig.identification.data_sheet import contradictions, worst_signal
from hydro_rig.recordings.columns import ColumnMap
from hydro_rig.recordings.findings import Finding, Weight, lines_of
from hydro_rig.recordings.parts import liveliest
from hydro_rig.recordings.quality import Checked, check_recording
from hydro_rig.recordings.recording import Recording, read_recording
from hydro_rig.recordings.sampling import Sampled, bridged, cut, on_grid

OTHER_CLOCK = 2.0  # errors over the noise of the data sheet with which half of the windows show an unknown command
FIRST_WINDOWS = 2  # liveliest windows, which show whether the model describes the rig at all
MOST_WINDOWS = 60  # of a recording; more take longer and add little


Read = tuple[Reading, Estimate | None]  # of each window


class Diagnosis(NamedTuple):
    """A recording with its verdict, and what this rests on."""

    recording: Recording
    task: TaskConfig  # that was assumed
    checked: Checked  # short gaps of the command are filled; all findings
    windows: Windows
    reading: Reading  # of each window; empty: nothing was read
    limits: Limits
    verdict: Verdict

    @property
    def temperature(self) -> float:
        """Mean temperature of the oil in the windows, or of the recording without windows, °C; NaN: not recorded."""
        return temperature_of(self.windows if len(self.windows) else self.recording)


def diagnosed(
    recording: Recording,
    config: TaskConfig,
    choose: Callable[[Sampled], Windows],
    read: Callable[[Windows, TaskConfig], Read],
    oil: Oil | None = None,
) -> Diagnosis:
    """Check a recording, choose windows, read them unless a finding is severe, and judge.

    Windows are read with the task at their sample time. With an oil the leak is judged at 40 °C, otherwise as measured.
    """
    checked = check_recording(recording, config)
    config = on_grid(config, checked.samples.period)
    samples, filled = bridged(checked.samples)
    checked = Checked(samples, [*checked.findings, *filled])
    findings = checked.findings
    windows = choose(samples)
    reading, fitted, residual = Reading.of(np.zeros(0)), None, ""
    refused = checked.severe
    if not refused and len(windows):
        try:
            reading, fitted = read(windows, config)
        except (ValueError, ArithmeticError, LookupError) as error:
            what = f"cannot be read: {error if isinstance(error, HydroError) else reason(error)}"
            findings.append(Finding("windows", " ".join(what.split()), Weight.SEVERE))
    if fitted is not None:
        findings += contradictions(fitted, config)
        residual = worst_signal(fitted, config)
        errors = np.hypot(fitted.slow, fitted.white)
        if samples.own_clock and (errors > OTHER_CLOCK).any(axis=1).mean() >= 0.5:
            what = "acts between the rows, by another clock than that of the log; record at the control period"
            findings.append(Finding("command", what, Weight.SEVERE))
    if oil:
        leak: Any = referred(Leak(*reading.sizes), oil, temperature_of(windows))  # the oil warms up in a long recording
        reading = reading._replace(flow_lpm=leak.value, low_lpm=leak.low, high_lpm=leak.high)
    limits = Limits.of(config)
    verdict = judge(Case(findings, reading, limits, residual, not recording.has_pressure))
    # A balance has no commands: it may decide where the rows do not fit the control period, if nothing else is severe
    # on a grid of their own.
    balance = volume_leak(recording, config)
    if balance and not (check_recording(recording, config, own_grid=True) if refused else checked).severe:
        if oil:
            balance = balance._replace(leak=referred(balance.leak, oil, temperature_of(recording)))
        what = balance.why or f"leaves {100.0 * balance.rest:.2g} % unexplained in {balance.moves} steady moves"
        findings.append(Finding("flow", what))
        verdict = by_volume(verdict, balance, limits)
    return Diagnosis(recording, config, checked, windows, reading, limits, verdict)


def diagnose(
    path: Path, config: TaskConfig, columns: ColumnMap | None = None, window: float = 2.0, most: int = MOST_WINDOWS
) -> Diagnosis:
    """Read a recording, check it, let the estimator read it, and judge; the task's rig was recorded.

    Path and columns as of :func:`~hydro_rig.recordings.recording.read_recording`. ``window``: s; the ``most`` windows
    of a longer recording are a sample (:func:`spread`).

    Raises:
        ConfigurationError: the recording cannot be read at all.

    Example:
        >>> from pathlib import Path
        >>> from hydro_agents.learning.loading import shipped
        >>> from hydro_rig.recordings.simulated import record_axis
        >>> from hydro_rig.diagnosis.diagnose import diagnose
        >>> from hydro_env import TaskConfig
        >>> task = TaskConfig(episode_duration=2.0)
        >>> recorded = record_axis(Path("axis.csv"), task, shipped("pid", task), 1, 1.0, "multi_sine")
        >>> verdict = diagnose(Path("axis.csv"), task).verdict
        >>> verdict.kind.value, round(verdict.leak.value, 1)
        ('internal leak', 1.0)
    """
    left_out = []

    def choose(samples: Sampled) -> Windows:
        windows = cut(samples, max(round(window / samples.period), 2))
        chosen = spread(windows, most)
        if len(chosen) < len(windows):
            what = f"{len(chosen)} of {len(windows)} are read, spread over the recording (--windows)"
            left_out.append(Finding("windows", what))
        tell(f"windows of {len(samples.time)} samples at {1.0 / samples.period:.4g} Hz", len(chosen), len(windows))
        return chosen

    found = diagnosed(read_recording(path, columns), config, choose, read_windows)
    found.checked.findings.extend(left_out)
    return found


def spread(windows: Windows, most: int) -> Windows:
    """Of each of ``most`` sections of a recording, the window that moves most; few are all kept."""
    if len(windows) <= most:
        return windows
    return windows.part(liveliest(windows, most, (windows.end[-1] - windows.begin[0]) / most))


def read_windows(windows: Windows, config: TaskConfig, threads: int | None = None) -> Read:
    """Read all windows with the estimator; if the model explains none of the liveliest, the others are not tried."""
    commanded = np.flatnonzero(windows.commanded)
    first = commanded[liveliest(windows.part(commanded), FIRST_WINDOWS)]
    others = np.setdiff1d(np.arange(len(windows)), first)
    detector = EstimatorDetector(threads=threads)
    if not len(first):
        return detector.read_and_fit(windows, config)
    tell("estimator", 0, len(commanded))
    reading, fitted = EstimatorDetector(threads=threads, restarts=1).read_and_fit(windows.part(first), config)
    tell("estimator", len(first), len(commanded))
    reading = Reading.of(np.full(len(windows), np.nan), Cause.UNKNOWN, why=Why.NOT_READ).replaced(first, reading)
    if len(others) and fitted is not None and fitted.holds.any():
        usual = Counter(parts for parts in fitted.parts if parts).most_common(1)
        rest, more = detector.read_and_fit(windows.part(others), config, usual[0][0] if usual else ())
        tell("estimator", len(commanded), len(commanded))
        reading = reading.replaced(others, rest)
        if more is not None:
            fitted = join([fitted, more])
    return reading, fitted


def leak_table(diagnosis: Diagnosis) -> pd.DataFrame:
    """The reading of each window, one row each; leaks in l/min at 100 bar."""
    windows, reading = diagnosis.windows, diagnosis.reading
    table = pd.DataFrame({"begin_s": windows.begin, "end_s": windows.end}).round(6)
    table[["leak", "low", "high"]] = np.maximum(reading.sizes, 0.0).round(5).T
    return table.assign(counts=reading.answers, fault=reading.fault, remark=reading.remarks)


def in_json(diagnosis: Diagnosis) -> dict[str, Any]:
    """Verdict and findings for another program; leaks in l/min at 100 bar, ``None``: unknown."""
    verdict = diagnosis.verdict
    return {
        "recording": diagnosis.recording.source,
        "verdict": verdict.kind.value,
        "exit_code": EXIT_CODES[verdict.kind],
        "reason": verdict.why,
        "leak": verdict.leak and verdict.leak.positive._asdict(),
        "windows": len(diagnosis.windows),
        "findings": lines_of(diagnosis.checked.findings),
    }


class Change(NamedTuple):
    """What became of the leak."""

    fall: Leak | None  # l/min at 100 bar and 40 °C, with its 90 % interval; None: a recording gives no leak
    line: str


def change_of(before: Diagnosis, after: Diagnosis, oil: Oil) -> Change:
    """The leak of one recording minus that of a later one; their errors count as independent."""
    sizes = []
    for when, one in (("before", before), ("after", after)):
        if not one.verdict.leak:
            return Change(None, f"cannot tell what has changed: {when}: {one.verdict.why}")
        sizes.append(referred(one.verdict.leak, oil, one.temperature))
    old, new = sizes
    fall = float(old.value - new.value)
    low = fall - float(np.hypot(old.value - old.low, new.high - new.value))
    high = fall + float(np.hypot(old.high - old.value, new.value - new.low))
    what = "cannot tell whether the leak has changed"
    if low > 0.0:
        what = "the leak has fallen"
    elif high < 0.0:
        what = "the leak has grown"
    ends = ", ".join(number(size, digits=2) for size in (low, high))
    line = f"{what}: before minus after {number(fall, digits=2)} [{ends}] l/min at 100 bar and 40 °C"
    return Change(Leak(fall, low, high), line)
