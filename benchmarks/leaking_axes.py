"""This project's detectors on the benchmark of leaking axes, beside simple ones; and how well their ranking holds.

    python benchmarks/leaking_axes.py FOLDER [--split test] [--predictions FOLDER]

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

from hydro_agents.detection.detector import Cause, Detector, Windows
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

TASK = TaskConfig()
WINDOW = 2.0  # s
LASTING = 10  # looks whose mean is the score
HALVES = 100

Numbers = NDArray[np.int64]


def read_axes(folder: Path, split: str) -> tuple[Numbers, Floats]:
    """Numbers and signals (N, 5, T) of all recordings of a split, in SI units; NaN: lost, or after the end."""
    table = pd.read_parquet(folder / split)
    numbers = table["recording"].unique()
    signals = np.full((len(numbers), len(MEASURED), round(DURATION / TASK.control_period)), np.nan)
    for axis, (_, rows) in enumerate(table.groupby("recording", sort=False)):
        places = np.round(rows[heading("time")].to_numpy() / TASK.control_period).astype(int)
        for row, name in enumerate(MEASURED):
            signals[axis, row, places] = rows[heading(name)].to_numpy() * factor(name, WRITTEN_UNITS[name], name)
    return numbers, signals


def last_sample(signals: Floats) -> NDArray[np.int64]:
    """Index of the last sample of each axis, (N,)."""
    present = np.asarray(np.isfinite(signals).any(axis=1))
    return np.asarray(signals.shape[2] - 1 - present[:, ::-1].argmax(axis=1))


def looks(
    numbers: Numbers, signals: Floats, length: float, every: float, see: Callable[[Floats], pd.DataFrame]
) -> pd.DataFrame:
    """What is seen in windows of a length (s; 0: all since the start) that end every so many seconds, a row per axis.

    An axis that ended before is not looked at, one that failed before the first look has an empty row.
    """
    step, whole = round(every / TASK.control_period), round(length / TASK.control_period)
    last, parts = last_sample(signals), []
    for end in range(max(whole, step), signals.shape[2] + 1, step):
        running = last > end - (whole // 2 or step)
        if running.any():
            table = see(signals[running, :, end - whole if whole else 0 : end])
            time = np.minimum(end, last[running]) * TASK.control_period
            parts.append(table.assign(recording=numbers[running], time=time))
    missing = numbers[~np.isin(numbers, pd.concat(parts)["recording"])] if whole else numbers[:0]
    parts.append(pd.DataFrame({"recording": missing, "time": 0.0, "score": np.nan}))
    return pd.concat(parts, ignore_index=True)


def difference_of_pressures(signals: Floats) -> pd.DataFrame:
    """The simplest detector: a leak lowers the difference of the pressures for the same opening of the valve."""
    a, b, spool = (signals[:, MEASURED.index(name)] for name in ("pressure_a", "pressure_b", "spool_position"))
    with np.errstate(all="ignore"):
        return pd.DataFrame({"score": -np.log(np.nanmedian(np.abs(a - b) / (np.abs(spool) + 0.01), axis=1))})


def read_by(detector: Detector, numbers: Numbers, signals: Floats, every: float) -> pd.DataFrame:
    """The looks of a detector; the score is the mean of the last looks that have an answer."""

    def see(window: Floats) -> pd.DataFrame:
        reading = detector.read(Windows.of(window), TASK)
        words = [tuple(Cause)[each].word if each < Cause.UNKNOWN else None for each in reading.cause]
        leaks = reading.answers & (reading.probability > 0.5)
        return pd.DataFrame(
            {
                "score": np.where(reading.answers, reading.score, np.nan),
                "probability": reading.probability,
                "cause": np.where(leaks, Cause.INTERNAL_LEAK.word, np.array(words, dtype=object)),
                "size": reading.flow_lpm,
                "low": reading.low_lpm,
                "high": reading.high_lpm,
            }
        )

    table = looks(numbers, signals, WINDOW, every, see).sort_values(["recording", "time"], ignore_index=True)
    table["score"] = table.groupby("recording")["score"].transform(lambda s: s.rolling(LASTING, 1).mean())
    return table


OWN: dict[str, Callable[[Numbers, Floats], pd.DataFrame]] = {
    "difference of pressures": lambda n, s: looks(n, s, 0.0, 1.0, difference_of_pressures),
    "leakage head": lambda n, s: read_by(HeadDetector(LeakageHead.load(pretrained_folder() / HEAD_FILE)), n, s, 1.0),
    "estimator, every 20 s": lambda n, s: read_by(EstimatorDetector({}), n, s, 20.0),
}

OUTSIDE = {"random forest": [], "logistic regression": ["--linear"]}


def main() -> None:
    """Predict, score, rank."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--split", default="test")
    parser.add_argument("--predictions", type=Path, default=Path("results/leaking_axes"))
    given = parser.parse_args()
    given.predictions.mkdir(parents=True, exist_ok=True)
    labels = labels_of(given.folder, given.split)
    numbers, signals = read_axes(given.folder, given.split)
    scores = []
    for name in (*OWN, *OUTSIDE):
        file = given.predictions / f"{name}.parquet"
        if not file.exists() and name in OWN:
            OWN[name](numbers, signals).to_parquet(file, index=False)
        elif not file.exists():
            script = str(Path(__file__).parent / "outsider.py")
            options = ["--split", given.split, "--output", str(file), *OUTSIDE[name]]
            subprocess.run([sys.executable, script, str(given.folder), *options], check=True)
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
