"""A servo-hydraulic shake table under earthquakes that the fit never saw, beside black boxes (docs/leakage.md).

Run: python benchmarks/shake_table.py DATASET [--every 8] [--position-alone]

DATASET holds the folders ``train`` and ``test`` of github.com/SJ-Chuang/TD3-Shake-Table-System. Each forecast lasts 2 s
and begins at a measured state; the 2 s before it show how far the valve's null has wandered, to every competitor.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from pathlib import Path

import numpy as np

from hydro_agents.running.console import ProgressDisplay
from hydro_agents.running.text import markdown
from hydro_env.task.configuration import task_config
from hydro_env.task.rig import read_rig
from hydro_env.task.sensors import COMMAND, POSITION, PRESSURE_A
from hydro_env.types import Floats
from hydro_rig.identification.held_back import FORECAST_EVERY, FORECAST_FROM, HORIZONS
from hydro_rig.identification.identify import Identification, identify
from hydro_rig.recordings.columns import ColumnMap

RIG = Path(__file__).with_suffix(".yaml")
COLUMNS = ColumnMap.model_validate(
    {
        "time": {"column": "Time", "unit": "s"},
        "command": {"column": "Voltage command", "unit": "V"},
        "position": {"column": "Table disp", "unit": "mm"},
        "load_pressure": {"column": "Delta P", "unit": "MPa"},  # assumed: neither unit nor sign is published
    }
)
OVER = 2.0  # s
LAG, PAST, COMMANDS = 2, 4, 8  # rows; terms of the autoregressive model
MEMORY, MEAN = 600, 4  # rows: length and step of the regression of the load pressure

Forecaster = Callable[[Floats, Floats, int], Floats]  # command, speed, first row → speed from there on


def speed_of(position: Floats, period: float) -> Floats:
    """Speed in m/s by central differences, (T,)."""
    speed: Floats = np.asarray(np.gradient(position, period), np.float64)
    return speed


def regression(matrix: Floats, target: Floats) -> Floats:
    """Least squares."""
    found: Floats = np.asarray(np.linalg.lstsq(matrix, target, rcond=None)[0])
    return found


def static_gains(training: list[tuple[Floats, Floats]], directions: int) -> Forecaster:
    """Speed in proportion to the command some rows before, with one gain, or one for each of two directions."""

    def columns(command: Floats) -> Floats:
        return np.column_stack([np.ones_like(command), command, np.abs(command)])[:, : directions + 1]

    matrix = columns(np.concatenate([u[:-LAG] for u, _ in training]))
    weights = regression(matrix, np.concatenate([v[LAG:] for _, v in training]))

    def forecast(command: Floats, speed: Floats, first: int) -> Floats:
        ahead: Floats = columns(command[first - LAG : len(command) - LAG]) @ weights
        return ahead

    return forecast


def autoregression(training: list[tuple[Floats, Floats]]) -> Forecaster:
    """Speed from the last speeds and commands (ARX), simulated."""
    most = max(PAST, COMMANDS)

    def columns(u: Floats, v: Floats) -> Floats:
        past = [v[most - k : len(v) - k] for k in range(1, PAST + 1)]
        return np.column_stack([*past, *(u[most - k : len(u) - k] for k in range(COMMANDS)), np.ones(len(v) - most)])

    matrix = np.concatenate([columns(u, v) for u, v in training])
    weights = regression(matrix, np.concatenate([v[most:] for _, v in training]))

    def forecast(command: Floats, speed: Floats, first: int) -> Floats:
        known = [*speed[first - PAST : first]]
        for row in range(first, len(command)):
            recent = [*known[: -PAST - 1 : -1], *command[row - COMMANDS + 1 : row + 1][::-1], 1.0]
            known.append(float(weights @ recent))
        return np.array(known[PAST:])

    return forecast


def remembered(signals: Floats) -> Floats:
    """Means of the commands of MEMORY rows before each row, direction of the last one, and 1: (T, columns)."""
    command = signals[COMMAND]
    means = np.convolve(np.pad(command, (MEMORY, 0), "edge"), np.ones(MEAN) / MEAN)
    lags = [means[MEMORY - lag : len(command) + MEMORY - lag] for lag in range(0, MEMORY, MEAN)]
    return np.column_stack([*lags, np.sign(means[MEMORY - LAG : len(command) + MEMORY - LAG]), np.ones_like(command)])


def load_pressure(signals: Floats) -> Floats:
    """Of a run, (T,), Pa."""
    pressure: Floats = signals[PRESSURE_A]
    return pressure


def pieces(values: Floats, length: int) -> Floats:
    """Successive pieces (N, length)."""
    cut: Floats = values[: len(values) // length * length].reshape(-1, length)
    return cut


def forecasts(forecaster: Forecaster, command: Floats, position: Floats, period: float) -> tuple[Floats, Floats]:
    """Measured and forecast positions (N, T) from the places at which ``hydro identify`` begins its own."""
    lead, every, length = (round(time / period) for time in (FORECAST_FROM, FORECAST_EVERY, OVER))
    last = len(position) - lead - round(HORIZONS[0] / period)
    speed, measured, found = speed_of(position, period), [], []
    for start in range(0, last, every):
        begin, end = start + lead, start + lead + length
        if end > len(position):
            break
        begun = max(start, COMMANDS)
        before = forecaster(command[:begin], speed, begun)
        drift = (speed[begun:begin] - before).mean()
        ahead = forecaster(command[:end], speed, begin) + drift
        measured.append(position[begin:end])
        found.append(position[begin] + period * np.concatenate([[0.0], np.cumsum(ahead[:-1])]))
    return np.array(measured), np.array(found)


def share(measured: Floats, found: Floats) -> float:
    """Share of the variance about the mean of each forecast."""
    away = measured - measured.mean(axis=1, keepdims=True)
    return float(1.0 - ((measured - found) ** 2).sum() / (away**2).sum())


def shares(measured: Floats, found: Floats, period: float) -> tuple[float, float]:
    """Shares of position and speed, over 50 ms."""
    step = round(0.05 / period)
    return share(measured, found), share(*(each[:, step:] - each[:, :-step] for each in (measured, found)))


def judged(found: Identification) -> dict[str, Floats]:
    """Shares (runs, 3) of position, speed and load pressure, for each competitor; NaN: it tells nothing about it."""
    period, apart = found.config.control_period, {part.recording for part in found.held_back}
    used = [one.samples.signals for number, one in enumerate(found.checked) if number not in apart]
    training = [(signals[COMMAND], speed_of(signals[POSITION], period)) for signals in used]
    length = round(OVER / period)
    rows: dict[str, list[tuple[float, ...]]] = {"identified plant": []}
    for part in found.held_back:
        both = part.forecasts[:, :, POSITION, :length]
        whole = both[:, np.isfinite(both[0]).all(axis=1)]
        pressure = part.forecasts[:, np.isfinite(both[0]).all(axis=1), PRESSURE_A, :length]
        rows["identified plant"].append((*shares(whole[0], whole[1], period), share(pressure[0], pressure[1])))
    black_boxes = {
        "gain, lag and null": static_gains(training, 1),
        "the same with a gain for each direction": static_gains(training, 2),
        "autoregression (ARX)": autoregression(training),
    }
    for name, forecaster in black_boxes.items():
        rows[name] = [
            (*shares(*forecasts(forecaster, signals[COMMAND], signals[POSITION], period), period), np.nan)
            for signals in (stretch.signals for stretch in found.parts.held_back)
        ]
    if np.isfinite(used[0][PRESSURE_A]).all():
        matrix, target = (np.concatenate([of(signals) for signals in used]) for of in (remembered, load_pressure))
        weights = regression(matrix, target)
        rows["regression of the last 3 s of the command"] = [
            (np.nan, np.nan, share(pieces(load_pressure(one), length), pieces(remembered(one) @ weights, length)))
            for one in (stretch.signals for stretch in found.parts.held_back)
        ]
    return {name: np.array(values) for name, values in rows.items()}


def main() -> None:
    """Identify the table from some of the training runs, and print how well the test runs are predicted."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("dataset", type=Path)
    parser.add_argument("--position-alone", action="store_true", help="leave the load pressure out")
    parser.add_argument("--every", type=int, default=8, help="one of how many training runs is used")
    arguments = parser.parse_args()
    paths = sorted((arguments.dataset / "train").glob("*.csv"))[:: arguments.every]
    test = sorted((arguments.dataset / "test").glob("*.csv"))
    columns = COLUMNS.model_copy(update={"load_pressure": None}) if arguments.position_alone else COLUMNS
    with ProgressDisplay() as display:
        files = [*paths, *test]
        maps = [columns] * len(files)
        found = identify(files, task_config(rig=RIG), read_rig(RIG), maps, display.update, [str(one) for one in test])
    print(f"\n{found.verdict()}\n")
    results = judged(found)
    plant = results["identified plant"]
    table = []
    for name, values in results.items():
        beaten = int((plant[:, 0] > values[:, 0]).sum())
        ahead = "–" if values is plant or np.isnan(values[:, 0]).any() else f"{beaten} of {len(values)}"
        cells = [
            "–" if np.isnan(column).all() else f"{np.median(column):.4f} ({column.min():.4f})" for column in values.T
        ]
        refused = int((values[:, 0] < 0.9).sum())
        table.append([name, *cells, str(refused), ahead])
    header = [
        "model",
        "position over 2 s: median (worst)",
        "speed: median (worst)",
        "load pressure",
        "below 0.9",
        "plant is better on",
    ]
    print(markdown(header, table))


if __name__ == "__main__":
    main()
