"""One reading of a recording: the verdict of ``hydro diagnose`` on its liveliest windows, with the leak at 40 °C."""

from __future__ import annotations

import re
from contextlib import suppress
from datetime import UTC, datetime
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from hydro_agents.detection.detector import Windows
from hydro_env import TaskConfig
from hydro_rig.diagnosis.diagnose import read_windows
from hydro_rig.diagnosis.oil import Oil, temperature_of
from hydro_rig.diagnosis.pipeline import diagnosed
from hydro_rig.diagnosis.verdict import Leak
from hydro_rig.estimation.progress import told_to
from hydro_rig.recordings.findings import Weight
from hydro_rig.recordings.parts import liveliest
from hydro_rig.recordings.recording import Recording, read_recording
from hydro_rig.recordings.sampling import Sampled, cut
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

    def choose(samples: Sampled) -> Windows:
        windows = cut(samples, round(WINDOW / samples.period))
        return windows.part(liveliest(windows, most, SECTION))

    with told_to(None):  # a file is one step of the progress
        found = diagnosed(recording, config, choose, partial(read_windows, threads=1), WINDOW, oil)
    verdict = found.verdict
    leak = verdict.leak or Leak(np.nan, np.nan, np.nan)
    faults = [finding.line() for finding in found.checked.findings if finding.weight is Weight.FAULT]
    return {
        "verdict": verdict.kind.value,
        "reason": "; ".join(dict.fromkeys(filter(None, [verdict.why, *faults]))),
        "temperature": temperature_of(found.windows if len(found.windows) else recording),
        "size_40": leak.value,
        "low_40": leak.low,
        "high_40": leak.high,
    }
