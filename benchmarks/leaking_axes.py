"""This project's detectors on the benchmark of leaking axes, beside simple ones; and how well their ranking holds.

    python benchmarks/leaking_axes.py FOLDER [--split test] [--predictions FOLDER] [--only head estimator …]

FOLDER is the one of ``hydro record --benchmark``. Every detector writes its predictions as anyone would; finished ones
stay. The ranking is repeated on random halves of the recordings (Kendall's tau). ``outsider.py`` is the
detector of somebody who does not know this project.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy.stats import kendalltau

from hydro_agents.detection.detector import Cause, Detector, Reading, Windows
from hydro_agents.detection.head import LeakageHead
from hydro_agents.detection.monitor import HEAD_FILE, HeadDetector
from hydro_agents.running.folders import pretrained_folder
from hydro_env import TaskConfig
from hydro_env.types import Floats
from hydro_rig.challenge.axes import DURATION
from hydro_rig.challenge.scores import labels_of, score, text_of
from hydro_rig.estimation.estimator import EstimatorDetector
from hydro_rig.recordings.columns import MEASURED, factor
from hydro_rig.recordings.simulated import WRITTEN_UNITS, heading

WINDOW = 2.0  # s
LASTING = 10  # looks whose mean is the score
HALVES = 100


def read_axes(folder: Path, split: str, task: TaskConfig) -> tuple[NDArray[np.int64], Floats]:
    """Numbers and signals (N, 5, T) of all recordings of a split, in SI units; NaN: lost, or after the end."""
    table = pd.read_parquet(folder / split)
    numbers = table["recording"].unique()
    signals = np.full((len(numbers), len(MEASURED), round(DURATION / task.control_period)), np.nan)
    for axis, (_, rows) in enumerate(table.groupby("recording", sort=False)):
        places = np.round(rows[heading("time")].to_numpy() / task.control_period).astype(int)
        for row, name in enumerate(MEASURED):
            signals[axis, row, places] = rows[heading(name)].to_numpy() * factor(name, WRITTEN_UNITS[name], name)
    return numbers, signals


def read_by(
    detector: Detector, numbers: NDArray[np.int64], signals: Floats, task: TaskConfig, every: float
) -> pd.DataFrame:
    """The looks of a detector at windows of WINDOW that end every ``every`` seconds."""
    length, parts = round(WINDOW / task.control_period), []
    last = last_sample(signals)
    step = round(every / task.control_period)
    for end in range(max(length, step), signals.shape[2] + 1, step):
        running = last > end - length // 2
        if running.any():
            reading = detector.read(Windows.of(signals[running, :, end - length : end]), task)
            time = np.minimum(end, last[running]) * task.control_period
            parts.append(_table(reading, numbers[running], time))
    missing = numbers[~np.isin(numbers, pd.concat(parts)["recording"])]  # axes that failed before
    parts.append(pd.DataFrame({"recording": missing, "time": 0.0, "score": np.nan}))
    return pd.concat(parts, ignore_index=True)


def last_sample(signals: Floats) -> NDArray[np.int64]:
    """Index of the last sample of each axis, (N,)."""
    present = np.asarray(np.isfinite(signals).any(axis=1))
    return np.asarray(signals.shape[2] - 1 - present[:, ::-1].argmax(axis=1))


def _table(reading: Reading, numbers: NDArray[np.int64], time: Floats) -> pd.DataFrame:
    words = [tuple(Cause)[each].word if each < Cause.UNKNOWN else None for each in reading.cause]
    leaks = reading.answers & (reading.probability > 0.5)
    return pd.DataFrame(
        {
            "recording": numbers,
            "time": time,
            "score": np.where(reading.answers, reading.score, np.nan),
            "probability": reading.probability,
            "cause": np.where(leaks, Cause.INTERNAL_LEAK.word, np.array(words, dtype=object)),
            "size": reading.flow_lpm,
            "low": reading.low_lpm,
            "high": reading.high_lpm,
        }
    )


def lasting(table: pd.DataFrame) -> pd.DataFrame:
    """The table with the mean score of the last looks that have an answer."""
    table = table.sort_values(["recording", "time"], ignore_index=True)
    table["score"] = table.groupby("recording")["score"].transform(lambda s: s.rolling(LASTING, 1).mean())
    return table


def difference_of_pressures(numbers: NDArray[np.int64], signals: Floats, task: TaskConfig) -> pd.DataFrame:
    """The simplest detector: a leak lowers the difference of the pressures for the same opening of the valve."""
    a, b, spool = (signals[:, MEASURED.index(name)] for name in ("pressure_a", "pressure_b", "spool_position"))
    drop = np.abs(a - b) / (np.abs(spool) + 0.01)
    last, step, parts = last_sample(signals), round(1.0 / task.control_period), []
    for end in range(step, signals.shape[2] + 1, step):
        chosen = last > end - step
        with np.errstate(all="ignore"):
            value = -np.log(np.nanmedian(drop[chosen, :end], axis=1))
        time = np.minimum(end, last[chosen]) * task.control_period
        parts.append(pd.DataFrame({"recording": numbers[chosen], "time": time, "score": value}))
    return pd.concat(parts, ignore_index=True)


Predict = Callable[[NDArray[np.int64], Floats, TaskConfig], pd.DataFrame]

OWN: dict[str, Predict] = {
    "difference of pressures": difference_of_pressures,
    "leakage head": lambda n, s, task: lasting(
        read_by(HeadDetector(LeakageHead.load(pretrained_folder() / HEAD_FILE)), n, s, task, 1.0)
    ),
    "estimator, every 20 s": lambda n, s, task: lasting(read_by(EstimatorDetector({}), n, s, task, 20.0)),
}

OUTSIDE = {"random forest": [], "logistic regression": ["--linear"]}


def main() -> None:
    """Predict, score, rank."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--split", default="test")
    parser.add_argument("--predictions", type=Path, default=Path("results/leaking_axes"))
    parser.add_argument("--only", nargs="*", default=[*OWN, *OUTSIDE])
    arguments = parser.parse_args()
    arguments.predictions.mkdir(parents=True, exist_ok=True)
    task = TaskConfig()
    labels = labels_of(arguments.folder, arguments.split)
    numbers, signals = read_axes(arguments.folder, arguments.split, task)
    scores = []
    for name in arguments.only:
        file = arguments.predictions / f"{name}.parquet"
        if not file.exists() and name in OWN:
            OWN[name](numbers, signals, task).to_parquet(file, index=False)
        elif not file.exists():
            script = str(Path(__file__).parent / "outsider.py")
            options = ["--split", arguments.split, "--output", str(file), *OUTSIDE[name]]
            subprocess.run([sys.executable, script, str(arguments.folder), *options], check=True)
        scores.append(score(name, pd.read_parquet(file), labels))
        print(f"{name}: done", flush=True)
    print(text_of(scores))
    generator = np.random.default_rng(0)
    taus = []
    for _ in range(HALVES):
        first = generator.random(len(labels)) < 0.5
        ranks = [[one.outcomes.part(half).found_share for one in scores] for half in (first, ~first)]
        taus.append(kendalltau(*ranks).statistic)
    low = np.quantile(taus, 0.1)
    print(f"\nKendall's tau of the ranking on two halves: mean {np.mean(taus):.2f}, a tenth below {low:.2f}")


if __name__ == "__main__":
    main()
