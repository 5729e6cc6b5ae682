"""One reading of a recording: the verdict of ``hydro diagnose`` on its liveliest windows, with the leak at 40 °C."""

from __future__ import annotations

import re
from contextlib import suppress
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np

from hydro_agents.detection.detector import Windows
from hydro_env import TaskConfig
from hydro_rig.diagnosis.diagnose import read_windows
from hydro_rig.diagnosis.oil import Oil, referred, temperature_of
from hydro_rig.diagnosis.pipeline import Read, flow_blocks, judged
from hydro_rig.diagnosis.verdict import BALANCE, Kind, Leak, combined
from hydro_rig.diagnosis.volume_balance import leak_of_blocks
from hydro_rig.estimation.progress import told_to
from hydro_rig.recordings.findings import Weight
from hydro_rig.recordings.parts import liveliest
from hydro_rig.recordings.quality import check_recording
from hydro_rig.recordings.recording import Recording, read_recording
from hydro_rig.recordings.sampling import bridged, cut, on_grid
from hydro_rig.watching.fleet import Axis

MOST_WINDOWS = 12  # of a reading; more take longer and add little
WINDOW = 2.0  # s
SECTION = 300.0  # s of a recording, which gives one of them
FIRST_DATE, LAST_DATE = 1e9, 4e9  # s since 1970 that a stamp is taken for: the years 2001 to 2096
_DATE = re.compile(r"(20\d\d)[-_.]?(\d\d)[-_.]?(\d\d)(?:[T_ -]?(\d\d)[-_:.]?(\d\d)(?:[-_:.]?(\d\d))?)?(?!\d)")


def row_of_file(path: Path, axis: Axis) -> dict[str, Any]:
    """The row of a file: its first and last stamp (s since 1970), and what :func:`row_of` reads.

    Raises:
        ConfigurationError: the file cannot be read, or holds no rows.
    """
    rows = read_recording(path, axis.columns)
    clock = 0.0 if FIRST_DATE <= rows.begin <= LAST_DATE else _began(path) - rows.begin
    last = rows.begin + float(rows.time[-1])
    return {"time": clock + rows.begin, "until": clock + last, **row_of(rows, axis.task, axis.oil)}


def _began(path: Path) -> float:
    """s since 1970 by the name of a file, or by its age."""
    found = _DATE.search(path.name)
    if found is not None:
        with suppress(ValueError):  # the 45th of a month
            return datetime(*(int(part or 0) for part in found.groups()), tzinfo=UTC).timestamp()  # type: ignore[arg-type,misc]
    return path.stat().st_mtime


def row_of(recording: Recording, config: TaskConfig, oil: Oil, most: int = MOST_WINDOWS) -> dict[str, Any]:
    """Verdict, leak at 40 °C and oil temperature of a recording, from its liveliest windows and a measured flow."""
    row: dict[str, Any] = {"verdict": Kind.UNKNOWN.value, "temperature": np.nan, **_sizes(Leak(np.nan, np.nan, np.nan))}
    checked = check_recording(recording, config)
    config = on_grid(config, checked.samples.period)
    windows = cut(bridged(checked.samples)[0], round(WINDOW / config.control_period))
    chosen = windows.part(liveliest(windows, most, SECTION))
    row["temperature"] = temperature_of(chosen.auxiliary_signal("oil_temperature"))
    balance = leak_of_blocks(flow_blocks(recording))
    if balance is not None:
        at_40 = referred(Leak(balance.value, balance.low, balance.high), oil, row["temperature"])
        balance = balance._replace(**at_40._asdict())

    def read(windows: Windows) -> Read:
        if not len(windows):
            return Read()
        with told_to(None):  # a file is one step of the progress
            measured, fitted = read_windows(windows, config, threads=1)
        leaks: list[Any] = [measured.flow_lpm, measured.low_lpm, measured.high_lpm]
        at_40 = referred(Leak(*leaks), oil, row["temperature"])
        sizes: dict[str, Any] = {"flow_lpm": at_40.value, "low_lpm": at_40.low, "high_lpm": at_40.high}
        return Read(measured._replace(**sizes), fitted=fitted)

    found = judged(
        checked, config, choose=lambda _: chosen, read=read, recording=recording, balance=balance, window=WINDOW
    )
    verdict = found.verdict
    if verdict.detector == BALANCE and verdict.leak is not None:
        row |= _sizes(verdict.leak)
    elif found.read.estimator is not None:
        row |= _sizes(combined(found.read.estimator)[0])
    reasons = [verdict.why]
    for finding in found.checked.findings:
        if finding.weight is Weight.FAULT:
            reasons.append(finding.line())
    return row | {"verdict": verdict.kind.value, "reason": "; ".join(dict.fromkeys(filter(None, reasons)))}


def _sizes(leak: Leak) -> dict[str, float]:
    return {"size_40": leak.value, "low_40": leak.low, "high_40": leak.high}
