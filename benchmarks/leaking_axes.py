"""The challenge's opponents of equal knowledge, all trained by one command on the training split alone, and scored.

    python benchmarks/leaking_axes.py DATA [--output FOLDER] [--only NAME ...] [--split test]

DATA is the folder of ``hydro record --benchmark``. The programs of ``challenge/entries`` know no code of this project:
they are copied, trained, and run row by row by ``hydro score --code``. The project's own detectors read windows of 2 s
with the task that follows from the nameplate (track "knows the axis"); they were trained on other rigs. Finished
predictions stay. At the end stand the scores, and how well the ranking holds on halves (Kendall's tau).
"""

from __future__ import annotations

import argparse
import shutil
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from joblib import Parallel, delayed
from numpy.typing import NDArray
from scipy.stats import kendalltau

from hydro_agents.detection.detector import Cause, Detector, Reading, Windows
from hydro_agents.detection.monitor import HeadDetector
from hydro_agents.running.machine import Origin
from hydro_env import TaskConfig
from hydro_env.files import write_text
from hydro_env.types import Floats
from hydro_rig.challenge.axes import DURATION
from hydro_rig.challenge.files import PLATES, read_table
from hydro_rig.challenge.plates import read_plate, task_of
from hydro_rig.challenge.score_page import render_scores
from hydro_rig.challenge.scores import Score, bounds, labels_of, score, table_of, text_of
from hydro_rig.challenge.submitted import run_program
from hydro_rig.estimation.estimator import EstimatorDetector
from hydro_rig.estimation.two_stage import TwoStageDetector
from hydro_rig.recordings.columns import MEASURED, factor
from hydro_rig.recordings.sampling import likely_commands
from hydro_rig.recordings.simulated import WRITTEN_UNITS, heading

ENTRIES = Path(__file__).parents[1] / "challenge/entries"
WINDOW = 2.0  # s
HALVES = 100

PROGRAMS: dict[str, tuple[str, bool]] = {
    "random forest, signals only": ("forest", True),
    "random forest": ("forest", False),
    "CUSUM on an observer": ("cusum", False),
    "convolution": ("convolution", False),
    "MiniRocket": ("minirocket", False),
}
"""Folder of each program, and whether it gets the signals only."""


class Own(NamedTuple):
    """One of the project's own detectors, and how its looks become predictions."""

    make: Callable[[], Detector]
    every: float = 1.0  # s between two looks
    lasting: int = 10  # looks whose mean is the score
    wider: float = 1.0  # by which its intervals are widened
    in_lpm: bool = False  # its score is a leak; as a part of the smallest one those of all axes compare


OWN = {
    "leakage head": Own(HeadDetector.load),
    # Chosen on the validation split.
    "estimator, every 12 s": Own(lambda: EstimatorDetector({}), every=12.0, lasting=2, wider=1.5),
    "two-stage": Own(lambda: TwoStageDetector(HeadDetector.load()), wider=1.5, in_lpm=True),
}


def axes_of(data: Path, split: str) -> Iterator[tuple[TaskConfig, float, NDArray[np.int64], Floats]]:
    """Per axis the task that follows from its plate, its smallest leak, numbers and signals (N, 5, T) in SI units."""
    plates = {row["axis"]: row for row in read_table(data / PLATES).to_dict("records")}
    for axis, table in read_table(data / split).groupby("axis"):
        row: Any = plates[axis]
        task = task_of(TaskConfig(), read_plate(row))
        numbers = table["recording"].unique()
        signals = np.full((len(numbers), len(MEASURED), round(DURATION / task.control_period)), np.nan)
        for place, (_, rows) in enumerate(table.groupby("recording", sort=False)):
            samples = np.round(rows[heading("time")].to_numpy() / task.control_period).astype(int)
            for channel, name in enumerate(MEASURED):
                values = rows[heading(name)].to_numpy() * factor(name, WRITTEN_UNITS[name], name)
                signals[place, channel, samples] = values
        yield task, row["smallest_leak"], numbers, signals


def read_axis(
    own: Own,
    task: TaskConfig,
    unit: float,
    numbers: NDArray[np.int64],
    signals: Floats,
) -> pd.DataFrame:
    """The looks of a detector at windows of WINDOW, on the recordings of one axis."""
    detector, length, step = own.make(), round(WINDOW / task.control_period), round(own.every / task.control_period)
    present = np.asarray(np.isfinite(signals[:, :-1]).any(axis=1))
    scale = unit if own.in_lpm else 1.0
    last = signals.shape[2] - 1 - present[:, ::-1].argmax(axis=1)
    parts = [pd.DataFrame({"recording": numbers, "time": 0.0, "score": np.nan})]
    if reason := detector.refuses(task, length):
        print(f"{task.plant.cylinder.bore_diameter * 1e3:g} mm: {reason}", flush=True)
        return parts[0]
    for end in range(max(length, step), signals.shape[2] + 1, step):
        begin, stop = (end - length) * task.control_period, end * task.control_period
        times = np.full(len(numbers), begin), np.full(len(numbers), stop)
        reading = detector.read(Windows(_with_likely_commands(signals[:, :, end - length : end]), *times), task)
        running = last > end - length // 2
        time = np.minimum(end - 1, last) * task.control_period
        parts.append(_looks(reading, numbers, time, unit, scale)[running])
    return pd.concat(parts, ignore_index=True)


def _with_likely_commands(signals: Floats) -> Floats:
    """The windows (N, 5, T) with commands in their lost rows, from the other rows of the same window alone."""
    signals = signals.copy()
    for window in signals:
        lost = np.isnan(window[-1])
        if lost.any() and not lost.all():
            window[-1, lost] = likely_commands(window, lost)
    return signals


def _looks(reading: Reading, numbers: NDArray[np.int64], time: Floats, unit: float, scale: float) -> pd.DataFrame:
    words = [tuple(Cause)[each].word if each < Cause.UNKNOWN else None for each in reading.cause]
    leaks = reading.answers & ((reading.probability > 0.5) | (reading.low_lpm > unit))
    return pd.DataFrame(
        {
            "recording": numbers,
            "time": time,
            "score": reading.score / scale,  # evidence counts also where the detector gives no answer
            "probability": reading.probability,
            "cause": np.where(leaks, Cause.INTERNAL_LEAK.word, np.array(words, dtype=object)),
            "size": reading.flow_lpm,
            "low": reading.low_lpm,
            "high": reading.high_lpm,
        }
    )


def own_predictions(name: str, data: Path, split: str, jobs: int) -> pd.DataFrame:
    """The predictions of one of the project's own detectors; the score is the mean of the last looks."""
    own = OWN[name]
    work = (delayed(read_axis)(own, *axis) for axis in axes_of(data, split))
    table = pd.concat(Parallel(jobs)(work), ignore_index=True).sort_values(["recording", "time"], ignore_index=True)
    table["score"] = table.groupby("recording")["score"].transform(lambda s: s.rolling(own.lasting, 1).mean())
    for end in ("low", "high"):
        table[end] = (table["size"] + own.wider * (table[end] - table["size"])).clip(lower=0.0)
    return table


def program_predictions(name: str, data: Path, split: str, output: Path) -> pd.DataFrame:
    """The predictions of a program of ``challenge/entries``, trained on the training split if it learns."""
    entry, signals_only = PROGRAMS[name]
    folder = output / "programs" / name.replace(",", "").replace(" ", "_")
    if not folder.exists():
        shutil.copytree(ENTRIES / entry, folder)
    script = folder / "detect.py"
    if "--train" in script.read_text(encoding="utf-8") and not list(folder.glob("model.*")):
        only = ["--signals-only"] if signals_only else []
        subprocess.run([sys.executable, script, "--train", data, *only], check=True)
    run = run_program(folder, data, split, signals_only=signals_only)
    for remark in run.remarks:
        print(f"{name}: {remark}", flush=True)
    return run.predictions


def ranking_on_halves(scores: list[Score]) -> str:
    """Kendall's tau between the rankings of two halves of the recordings."""
    generator, taus = np.random.default_rng(0), []
    for _ in range(HALVES):
        first = generator.random(len(scores[0].outcomes.tier)) < 0.5
        ranks = [[one.outcomes.part(half).found_share for one in scores] for half in (first, ~first)]
        taus.append(kendalltau(*ranks).statistic)
    low = np.quantile(taus, 0.1)
    return f"Kendall's tau of the ranking on two halves: mean {np.mean(taus):.2f}, a tenth below {low:.2f}"


def main() -> None:
    """Train, predict, score, rank."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("data", type=Path)
    parser.add_argument("--split", default="test")
    parser.add_argument("--output", type=Path, default=Path("results/leaking_axes"))
    parser.add_argument("--only", nargs="*", default=[*PROGRAMS, *OWN])
    parser.add_argument("--jobs", type=int, default=2)
    given = parser.parse_args()
    data, labels, scores = given.data.absolute(), labels_of(given.data, given.split), []
    for name in given.only:
        file = given.output.absolute() / given.split / f"{name}.parquet"
        if not file.exists():
            file.parent.mkdir(parents=True, exist_ok=True)
            if name in OWN:
                table = own_predictions(name, data, given.split, given.jobs)
            else:
                table = program_predictions(name, data, given.split, given.output.absolute())
            table.to_parquet(file, index=False)
        scores.append(score(name, pd.read_parquet(file), labels))
        print(f"{name}: done", flush=True)
    whole = [*scores, *bounds(labels)]
    print(text_of(whole), f"\n{ranking_on_halves(scores)}" if len(scores) > 1 else "", sep="\n")
    write_text(given.output / "scores.csv", table_of(whole).to_csv(index=False))
    render_scores(whole, Origin.now(f"python benchmarks/leaking_axes.py {given.data}")).write(
        given.output / "scores.html"
    )


if __name__ == "__main__":
    main()
