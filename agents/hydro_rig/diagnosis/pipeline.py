"""The one way from a checked recording to its verdict, for ``hydro diagnose``, ``trend`` and ``leak-test``.

The commands differ in the windows that they choose and in what reads them; all else is the same: what makes one of them
refuse makes all refuse, and a measured flow serves all.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from hydro_agents.detection.detector import Reading, Windows
from hydro_env import HydroError, TaskConfig
from hydro_env.errors import reason
from hydro_env.plant.arrays import plant_coefficients
from hydro_env.task.sensors import POSITION, PRESSURE_A, PRESSURE_B
from hydro_rig.diagnosis.verdict import Case, Limits, Verdict, by_volume, judge
from hydro_rig.diagnosis.volume_balance import BLOCK, Blocks, VolumeLeak, blocks_of
from hydro_rig.estimation.result import Estimate
from hydro_rig.identification.data_sheet import contradictions, worst_signal
from hydro_rig.recordings.findings import Finding, Weight
from hydro_rig.recordings.quality import Checked, check_recording
from hydro_rig.recordings.recording import Recording
from hydro_rig.recordings.sampling import Sampled, bridged

OTHER_CLOCK = 2.0  # errors over the noise of the data sheet with which half of the windows show an unknown command
LONGEST_STEP = 3.0  # of the usual distance of rows: a longer one ends a part of a recording, as one beyond BLOCK


class Read(NamedTuple):
    """What was read in the windows of a recording."""

    estimator: Reading | None = None  # or the common fit of a leak test
    companion: Reading | None = None  # the detector beside the estimator
    fitted: Estimate | None = None
    findings: Sequence[Finding] = ()


@dataclass(frozen=True)
class Judged:
    """A recording with its verdict."""

    task: TaskConfig  # that was assumed
    checked: Checked  # short gaps of the command are filled; all findings
    windows: Windows
    read: Read
    limits: Limits
    verdict: Verdict


def judged(
    checked: Checked,
    config: TaskConfig,
    choose: Callable[[Sampled], Windows],
    read: Callable[[Windows], Read],
    recording: Recording,
    balance: VolumeLeak | None,
    window: float,
    companion: str = "",
) -> Judged:
    """Fill gaps, choose windows, read them unless a finding is severe, and judge.

    Args:
        checked: the samples and what was found about them.
        config: the task whose rig was recorded.
        choose: the windows of the samples.
        read: reads them.
        recording: the rows, for the balance.
        balance: the leak from a measured flow; ``None``: no flow was recorded.
        window: s, length of the windows, for the reasons.
        companion: name of the detector beside the estimator.
    """
    limits = Limits.of(config)
    samples, filled = bridged(checked.samples)
    checked = Checked(samples, [*checked.findings, *filled])
    if balance is not None:
        balance = balance.on(plant_coefficients(config.plant).area_a)
        what = balance.why or f"leaves {100.0 * balance.rest:.2g} % unexplained in {balance.moves} steady moves"
        checked.findings.append(Finding("flow", what, Weight.NOTE))
    windows = choose(samples)
    result, residual = Read(), ""
    refused = bool(checked.severe)
    if not refused:
        result = _read(windows, read)
        checked.findings.extend(result.findings)
    if result.fitted is not None:
        checked.findings.extend(contradictions(result.fitted, config))
        residual = worst_signal(result.fitted, config)
        errors = np.hypot(result.fitted.slow, result.fitted.white)
        if samples.own_clock and (errors > OTHER_CLOCK).any(axis=1).mean() >= 0.5:
            what = "acts between the rows, by another clock than that of the log; record at the control period"
            checked.findings.append(Finding("command", what, Weight.SEVERE))
    nothing = Reading.of(np.zeros(0))
    readings = result.estimator or nothing, result.companion or nothing
    verdict = judge(Case(checked.findings, *readings, limits, window, residual, companion))
    # A balance has no commands: it may decide where the rows do not fit the control period, if nothing else is severe
    # on a grid of their own.
    if balance is not None and not (check_recording(recording, config, own_grid=True) if refused else checked).severe:
        verdict = by_volume(verdict, balance, limits)
    return Judged(config, checked, windows, result, limits, verdict)


def _read(windows: Windows, read: Callable[[Windows], Read]) -> Read:
    """What is read in the windows; a failure is a severe finding in one line."""
    try:
        return read(windows)
    except (ValueError, ArithmeticError, LookupError) as error:
        what = f"cannot be read: {error if isinstance(error, HydroError) else reason(error)}"
        return Read(findings=[Finding("windows", " ".join(what.split()), Weight.SEVERE)])


def flow_blocks(recording: Recording) -> Iterator[Blocks]:
    """The blocks of a balance of volumes; none without a flow, the position or one of the pressures."""
    if "flow" not in recording.auxiliary or len(recording.time) < 2:
        return
    motion = recording.signals[[POSITION, PRESSURE_A, PRESSURE_B]]
    signals = np.vstack([motion, recording.auxiliary["flow"]])
    steps = np.diff(recording.time)
    step = float(np.median(steps))
    if not np.isfinite(signals).any(axis=1).all() or step <= 0.0:
        return
    ends = np.flatnonzero((steps < 0.0) | (steps > max(BLOCK, LONGEST_STEP * step))) + 1
    for part in np.split(np.arange(len(recording.time)), ends):
        stamps = recording.time[part]
        time = np.arange(stamps[0], stamps[-1], step)
        # A missing reading stays NaN.
        position, pressure_a, pressure_b, flow = (np.interp(time, stamps, values[part]) for values in signals)
        if len(time) > 1:
            yield blocks_of(position, pressure_a, pressure_b, flow, step)
