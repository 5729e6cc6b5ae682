"""The one way from a recording to its verdict, for ``hydro diagnose``, ``trend`` and ``leak-test``.

The commands differ in the windows that they choose and in what reads them; all else is the same: what makes one of them
refuse makes all refuse, and a measured flow serves all.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from hydro_agents.detection.detector import Reading, Windows
from hydro_env import HydroError, TaskConfig
from hydro_env.errors import reason
from hydro_env.plant.arrays import plant_coefficients
from hydro_env.task.sensors import PRESSURE_A, PRESSURE_B
from hydro_rig.diagnosis.oil import Oil, referred, temperature_of
from hydro_rig.diagnosis.verdict import Case, Leak, Limits, Verdict, by_volume, judge
from hydro_rig.diagnosis.volume_balance import volume_leak
from hydro_rig.estimation.result import Estimate
from hydro_rig.identification.data_sheet import contradictions, worst_signal
from hydro_rig.recordings.findings import Finding, Weight
from hydro_rig.recordings.quality import Checked, check_recording
from hydro_rig.recordings.recording import Recording
from hydro_rig.recordings.sampling import Sampled, bridged, on_grid

OTHER_CLOCK = 2.0  # errors over the noise of the data sheet with which half of the windows show an unknown command


class Read(NamedTuple):
    """What was read in the windows of a recording."""

    reading: Reading = Reading.of(np.zeros(0))  # of each window
    fitted: Estimate | None = None


@dataclass(frozen=True)
class Diagnosis:
    """A recording with its verdict, and what this rests on."""

    recording: Recording
    task: TaskConfig  # that was assumed
    checked: Checked  # short gaps of the command are filled; all findings
    windows: Windows
    reading: Reading  # of each window; empty: nothing was read
    limits: Limits
    verdict: Verdict


def diagnosed(
    recording: Recording,
    config: TaskConfig,
    choose: Callable[[Sampled], Windows],
    read: Callable[[Windows, TaskConfig], Read],
    window: float,
    oil: Oil | None = None,
) -> Diagnosis:
    """Check a recording, choose windows, read them unless a finding is severe, and judge.

    Args:
        recording: the rows.
        config: the task whose rig was recorded.
        choose: the windows of the samples.
        read: reads them, with the task at their sample time.
        window: s, length of the windows, for the reasons.
        oil: judges the leak at 40 °C; ``None``: as measured.
    """
    checked = check_recording(recording, config)
    config = on_grid(config, checked.samples.period)
    samples, filled = bridged(checked.samples)
    checked = Checked(samples, [*checked.findings, *filled])
    findings = checked.findings
    balance = volume_leak(recording)
    if balance is not None:
        balance = balance.on(plant_coefficients(config.plant).area_a)
        if oil is not None:
            at_40 = referred(Leak(balance.value, balance.low, balance.high), oil, temperature_of(recording))
            balance = balance._replace(**at_40._asdict())
        what = balance.why or f"leaves {100.0 * balance.rest:.2g} % unexplained in {balance.moves} steady moves"
        findings.append(Finding("flow", what, Weight.NOTE))
    windows = choose(samples)
    result, residual = Read(), ""
    refused = bool(checked.severe)
    if not refused and len(windows):
        result = _read(windows, config, read, findings)
    reading, fitted = result
    if fitted is not None:
        findings += contradictions(fitted, config)
        residual = worst_signal(fitted, config)
        errors = np.hypot(fitted.slow, fitted.white)
        if samples.own_clock and (errors > OTHER_CLOCK).any(axis=1).mean() >= 0.5:
            what = "acts between the rows, by another clock than that of the log; record at the control period"
            findings.append(Finding("command", what, Weight.SEVERE))
    if oil is not None:
        sizes: list[Any] = [reading.flow_lpm, reading.low_lpm, reading.high_lpm]
        leak: Any = referred(Leak(*sizes), oil, temperature_of(windows))  # the oil warms up in a long recording
        reading = reading._replace(flow_lpm=leak.value, low_lpm=leak.low, high_lpm=leak.high)
    limits, blind = Limits.of(config), bool(np.isnan(recording.signals[[PRESSURE_A, PRESSURE_B]]).all())
    verdict = judge(Case(findings, reading, limits, window, residual, blind))
    # A balance has no commands: it may decide where the rows do not fit the control period, if nothing else is severe
    # on a grid of their own.
    if balance is not None and not (check_recording(recording, config, own_grid=True) if refused else checked).severe:
        verdict = by_volume(verdict, balance, limits)
    return Diagnosis(recording, config, checked, windows, reading, limits, verdict)


def _read(
    windows: Windows, config: TaskConfig, read: Callable[[Windows, TaskConfig], Read], findings: list[Finding]
) -> Read:
    """What is read in the windows; a failure is a severe finding in one line."""
    try:
        return read(windows, config)
    except (ValueError, ArithmeticError, LookupError) as error:
        what = f"cannot be read: {error if isinstance(error, HydroError) else reason(error)}"
        findings.append(Finding("windows", " ".join(what.split()), Weight.SEVERE))
        return Read()
