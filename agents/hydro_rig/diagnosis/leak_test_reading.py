"""The reading of a leak test: one fit of the simulator to the whole recording, with an unknown wear of the valve.

All windows of the recording share leak, plant and wear; each has its own start. The verdict follows the rules of
``hydro diagnose`` (:func:`hydro_rig.diagnosis.verdict.judge`).
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from hydro_agents.detection.detector import HALF_WIDTH, Cause, Reading, Why, Windows
from hydro_agents.running.statistics import Interval
from hydro_agents.running.text import number
from hydro_env import TaskConfig
from hydro_env.task.sensors import SENSORS
from hydro_rig.diagnosis.leak_test_plan import priors_of_test, worn_task
from hydro_rig.diagnosis.pipeline import Diagnosis, Read, diagnosed
from hydro_rig.estimation.estimator import WEAR, healthy_range
from hydro_rig.estimation.search import SURE
from hydro_rig.estimation.unknowns import LEAKAGE
from hydro_rig.identification.common_fit import WELL_FITTED, Common, common_fit
from hydro_rig.identification.fit import COVERAGE
from hydro_rig.identification.intervals import spread_of
from hydro_rig.recordings.columns import ColumnMap
from hydro_rig.recordings.recording import read_recording
from hydro_rig.recordings.sampling import Sampled, cut

WINDOW = 4.0  # s; the windows share all unknowns but their start
MOST_WINDOWS = 30  # of a longer recording those at its end

Quantities = dict[str, Interval]
"""By unknown its value with the 90 % interval: the leak in l/min at 100 bar, what wears in SI units."""


def read_leak_test(path: Path, config: TaskConfig, columns: ColumnMap | None = None) -> tuple[Diagnosis, Quantities]:
    """Read the recording of a leak test: verdict, and what wears; nothing of the latter without a reading.

    Args:
        path: the recording.
        config: the task of the rig, whose valve is healthy.
        columns: the signal of each column; default: the names that ``hydro record`` writes.

    Raises:
        ConfigurationError: the recording cannot be read at all.
    """
    found: Quantities = {}

    def read(windows: Windows, config: TaskConfig) -> Read:
        if len(windows) < 2:
            return Read(Reading.of(np.full(len(windows), np.nan), why=Why.FEW_WINDOWS))
        measured = np.asarray(np.isfinite(windows.signals[:, : len(SENSORS)]).any(axis=(0, 2)))
        task = worn_task(config)
        common = common_fit(windows, task, priors_of_test(task, measured))
        found.update(quantities(common))
        return Read(_reading(common, found, config))

    return diagnosed(read_recording(path, columns), config, _windows, read, WINDOW), found


def _windows(samples: Sampled) -> Windows:
    """The last windows with all commands."""
    total = int(samples.place[-1]) + 1 if len(samples.place) else 0
    count = max(round(total * samples.period / WINDOW), 1)
    windows = cut(samples, max(total // count, 2))  # to the last move
    return windows.part(np.flatnonzero(windows.commanded)[-MOST_WINDOWS:])


def quantities(common: Common) -> Quantities:
    """The leak and what wears, by unknown."""
    joint, model = common.joint, common.model
    reach = HALF_WIDTH / COVERAGE * spread_of(joint).reach
    found = {}
    for place, value, error in zip(joint.shared, joint.common, reach, strict=True):
        name = model.names[place]
        if name == LEAKAGE or name in WEAR or name.startswith("valve."):
            found[name] = Interval(*model.priors[name].value(value + error * np.array([0.0, -1.0, 1.0])).tolist())
    return found


def _reading(common: Common, found: Quantities, config: TaskConfig) -> Reading:
    """The test as the reading of a detector: every window shares the leak, and may contradict the model."""
    faults, causes = [], []
    for name, wear in WEAR.items():
        if name in found:
            value, below, above = found[name]
            low, high = healthy_range(config, name)
            if max(low - value, value - high) > SURE * (above - below) / (2.0 * HALF_WIDTH):
                faults.append(f"{wear.what} ({number(wear.factor * value)} {wear.unit})")
                causes.append(wear.cause)
    holds, leak = common.misfit < WELL_FITTED, found[LEAKAGE]
    return Reading.of(
        np.full(len(holds), leak.value / (leak.high - leak.low)),
        np.where(holds, causes[0] if causes else Cause.NONE, Cause.UNKNOWN),
        flow_lpm=leak.value,
        low_lpm=leak.low,
        high_lpm=leak.high,
        fault=" and ".join(faults),
        why=np.where(holds, Why.ANSWERED, Why.MISFIT),
    )
