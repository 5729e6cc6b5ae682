"""The project's own detectors in the challenge: predictions for ``python -m challenge.score``.

    python -m benchmarks.leaking_axes DATA [--split test] [--output FOLDER]

DATA is the folder of ``python -m challenge.recordings``. The detectors read windows of 2 s with the task that follows
from the nameplate; they were trained on other rigs. Finished predictions stay.
"""

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pandas as pd
from joblib import Parallel, delayed

from benchmarks import command_line
from challenge.axes import read_task
from challenge.recordings import DURATION
from hydro_agents.detection.detector import Detector, Windows
from hydro_agents.detection.monitor import HeadDetector
from hydro_env import TaskConfig
from hydro_env.types import Floats, Indices
from hydro_rig.estimation.estimator import EstimatorDetector
from hydro_rig.estimation.two_stage import TwoStageDetector
from hydro_rig.recordings.columns import MEASURED, factor
from hydro_rig.recordings.sampling import likely_commands
from hydro_rig.recordings.simulated import WRITTEN_UNITS, heading

WINDOW = 2.0  # s


class Own(NamedTuple):
    """One of the project's own detectors, and how its looks become predictions."""

    make: Callable[[], Detector]
    every: float = 1.0  # s between two looks
    lasting: int = 10  # looks whose mean is the score
    wider: float = 1.0  # by which its intervals are widened
    in_lpm: bool = False  # its score is a leak; as a part of the smallest one those of all axes compare


OWN = {
    "leakage_head": Own(HeadDetector.load),
    # Chosen on the validation split.
    "estimator": Own(lambda: EstimatorDetector(), every=12.0, lasting=2, wider=1.5),
    "two_stage": Own(lambda: TwoStageDetector(HeadDetector.load()), wider=1.5, in_lpm=True),
}


class AxisOfData(NamedTuple):
    """The recordings of one axis."""

    task: TaskConfig
    smallest_leak: float  # l/min at 100 bar
    numbers: Indices  # (N,), of the recordings
    signals: Floats  # (N, 5, T), SI units


def axes_of(data: Path, split: str) -> Iterator[AxisOfData]:
    """The recordings of a split, axis by axis."""
    plates = pd.read_parquet(data / "axes.parquet").set_index("axis")
    for axis, table in pd.read_parquet(data / split).groupby("axis"):
        plate = plates.loc[axis]
        task = read_task(plate["task"])
        numbers = table["recording"].unique()
        signals = np.full((len(numbers), len(MEASURED), round(DURATION / task.control_period)), np.nan)
        for place, (_, rows) in enumerate(table.groupby("recording", sort=False)):
            samples = np.round(rows[heading("time")].to_numpy() / task.control_period).astype(int)
            for channel, name in enumerate(MEASURED):
                signals[place, channel, samples] = rows[heading(name)] * factor(name, WRITTEN_UNITS[name], name)
        yield AxisOfData(task, plate["smallest_leak"], numbers, signals)


def read_axis(own: Own, axis: AxisOfData) -> pd.DataFrame:
    """The looks of a detector at windows of WINDOW, on the recordings of one axis."""
    task, signals, detector = axis.task, axis.signals, own.make()
    length, step = round(WINDOW / task.control_period), round(own.every / task.control_period)
    present = np.asarray(np.isfinite(signals[:, :-1]).any(axis=1))
    last = signals.shape[2] - 1 - present[:, ::-1].argmax(axis=1)
    parts = [pd.DataFrame({"recording": axis.numbers, "time": 0.0, "score": np.nan})]
    if reason := detector.refuses(task, length):
        print(f"{task.plant.cylinder.bore_diameter * 1e3:g} mm: {reason}", flush=True)
        return parts[0]
    for end in range(max(length, step), signals.shape[2] + 1, step):
        begins = np.full(len(signals), (end - length) * task.control_period)
        windows = with_likely_commands(signals[:, :, end - length : end])
        reading = detector.read(Windows(windows, begins, begins + length * task.control_period), task)
        looks = {"recording": axis.numbers, "time": np.minimum(end - 1, last) * task.control_period}
        # Evidence counts also where the detector gives no answer.
        looks["score"] = reading.score / axis.smallest_leak if own.in_lpm else reading.score
        looks |= {"size": reading.flow_lpm, "low": reading.low_lpm, "high": reading.high_lpm}
        parts.append(pd.DataFrame(looks)[last > end - length // 2])
    return pd.concat(parts, ignore_index=True)


def with_likely_commands(signals: Floats) -> Floats:
    """The windows (N, 5, T) with commands in their lost rows, from the other rows of the same window alone."""
    signals = signals.copy()
    for window in signals:
        lost = np.isnan(window[-1])
        if lost.any() and not lost.all():
            window[-1, lost] = likely_commands(window, lost)
    return signals


def predictions(own: Own, data: Path, split: str, jobs: int) -> pd.DataFrame:
    """The predictions of a detector; the score is the mean of the last looks."""
    parts = Parallel(jobs)(delayed(read_axis)(own, axis) for axis in axes_of(data, split))
    table = pd.concat(parts, ignore_index=True).sort_values(["recording", "time"], ignore_index=True)
    table["score"] = table.groupby("recording")["score"].transform(lambda s: s.rolling(own.lasting, 1).mean())
    for end in ("low", "high"):
        table[end] = (table["size"] + own.wider * (table[end] - table["size"])).clip(lower=0.0)
    return table


def main() -> None:
    """Write the predictions of every detector."""
    given = command_line(__doc__, "data", split="test", output=Path("results/leaking_axes"), jobs=2)
    given.output.mkdir(parents=True, exist_ok=True)
    for name, own in OWN.items():
        file = given.output / f"{name}.parquet"
        if not file.exists():
            predictions(own, given.data, given.split, given.jobs).to_parquet(file, index=False)
            print(f"{file}: written", flush=True)


if __name__ == "__main__":
    main()
