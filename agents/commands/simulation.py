"""``hydro simulate``: one open-loop run of a rig as CSV and picture."""

from __future__ import annotations

import csv
import io
import math
from pathlib import Path

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from numpy.typing import NDArray

from agents.running.folders import prepare_folder
from hydro_env import ConfigurationError, PlantParameters, Trajectory, equilibrium, resistance_from_flow, simulate
from hydro_env.files import write_whole
from hydro_env.plant.analysis import leak_at_test_pressure
from hydro_env.plant.simulate import TRAJECTORY_NAMES, TRAJECTORY_UNITS
from hydro_env.plant.workable import refuse_unworkable
from hydro_env.task.configuration import LEAKAGE_LIMIT
from hydro_env.units import LITRE_PER_MINUTE

CSV_FILE = "trajectory.csv"
PICTURE_FILE = "trajectory.png"
RIG_FILE = "rig.yaml"
MOST_SAMPLES = 1_000_000


def input_voltage(signal: str, voltage: float, samples: int, sample_time: float, holding: float) -> NDArray[np.float64]:
    """A built-in input in V, (samples,): about the voltage that holds the start.

    ``step``: constant after 10 % of the time. ``stop``: constant, and the holding voltage for the last 60 %.
    ``sine``: 1 Hz. ``sweep``: from 0.5 to 50 Hz, logarithmically.
    """
    time = sample_time * np.arange(samples)
    duration = samples * sample_time
    if signal == "step":
        shape = np.where(time >= 0.1 * duration, 1.0, 0.0)
    elif signal == "stop":
        shape = np.where((time >= 0.05 * duration) & (time < 0.4 * duration), 1.0, 0.0)
    elif signal == "sine":
        shape = np.sin(2 * math.pi * time)
    else:
        low, high = 0.5, 50.0
        rate = math.log(high / low) / duration
        shape = np.sin(2 * math.pi * low * (np.exp(rate * time) - 1.0) / rate)
    return np.clip(holding + voltage * shape, -10.0, 10.0)


def read_voltage(path: Path) -> NDArray[np.float64]:
    """Voltages of a CSV file, last column, one row per sample; a line of headings may come first.

    Raises:
        ConfigurationError: unreadable, empty, or not numbers.
    """
    try:
        rows = [row for row in csv.reader(path.read_text(encoding="utf-8").splitlines()) if row]
    except (OSError, UnicodeDecodeError) as error:
        raise ConfigurationError(f"{path}: cannot be read: {getattr(error, 'strerror', None) or 'no text'}") from None
    values = []
    for number, row in enumerate(rows):
        if any(";" in cell for cell in row):
            raise ConfigurationError(f"{path}: line {number + 1}: separate columns by commas, decimals by points")
        try:
            value = float(row[-1])
            if not abs(value) <= 10.0:
                raise ConfigurationError(f"{path}: line {number + 1}: {value:g} V: must be within -10 to 10")
            values.append(value)
        except ConfigurationError:
            raise
        except ValueError:
            if number > 0:
                raise ConfigurationError(f"{path}: line {number + 1}: {row[-1]!r} is not a number") from None
    if not values:
        raise ConfigurationError(f"{path}: holds no voltages")
    return np.array(values)


def simulate_to_folder(
    folder: Path,
    rig: Path | None,
    signal: str,
    voltage: float,
    input_file: Path | None,
    duration: float,
    sample_time: float,
    leakage: float | None,
    position: float,
    overwrite: bool,
) -> list[Path]:
    """Run and write ``trajectory.csv``, ``trajectory.png`` and ``rig.yaml``; see ``hydro simulate --help``.

    Raises:
        ConfigurationError: an argument is impossible, or the folder cannot be used.
    """
    parameters = PlantParameters.from_yaml(rig) if rig is not None else PlantParameters()
    if leakage is not None:
        if not 0.0 <= leakage <= LEAKAGE_LIMIT:
            raise ConfigurationError(f"--leakage = {leakage:g} l/min: must be within 0 to {LEAKAGE_LIMIT:g}")
        parameters = parameters.replace(leakage={"internal_resistance": resistance_from_flow(leakage)})
    if not abs(voltage) <= 10.0:
        raise ConfigurationError(f"--voltage = {voltage:g} V: must be within -10 to 10")
    if not (sample_time > 0.0 and sample_time <= duration and duration / sample_time <= MOST_SAMPLES):
        raise ConfigurationError(
            f"--duration = {duration:g} s with --sample-time = {sample_time:g} s: needs 1 to {MOST_SAMPLES:,} samples"
        )
    refuse_unworkable(parameters, str(rig) if rig is not None else "rig")
    _, holding = equilibrium(parameters, position)
    if input_file is not None:
        inputs = read_voltage(input_file)
    else:
        inputs = input_voltage(signal, voltage, max(round(duration / sample_time), 1), sample_time, holding)
    run = simulate(parameters, inputs, sample_time, {"position": position})
    if rig is not None and rig.resolve() == (folder / RIG_FILE).resolve():
        raise ConfigurationError(f"{rig}: would be replaced by the results; take another --output")
    prepare_folder(folder, False, overwrite, CSV_FILE, PICTURE_FILE, RIG_FILE)
    files = [folder / CSV_FILE, folder / PICTURE_FILE, folder / RIG_FILE]
    write_whole(files[0], trajectory_csv(run).encode())
    write_whole(files[1], trajectory_picture(run))
    parameters.to_yaml(files[2])
    return files


def trajectory_csv(run: Trajectory) -> str:
    """All quantities in SI; the first line names each with its unit."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow([f"{name} [{TRAJECTORY_UNITS[name]}]" for name in TRAJECTORY_NAMES])
    for row in np.column_stack([run[name] for name in TRAJECTORY_NAMES]):
        writer.writerow([f"{value:.9g}" for value in row])
    return text.getvalue()


def trajectory_picture(run: Trajectory) -> bytes:
    """A PNG of :func:`trajectory_figure`."""
    buffer = io.BytesIO()
    trajectory_figure(run).savefig(buffer, format="png", dpi=110)
    return buffer.getvalue()


def trajectory_figure(run: Trajectory) -> Figure:
    """Command and spool, position, pressures, flows, acceleration over time."""
    figure = Figure(figsize=(9, 11), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots(5, 1, sharex=True)
    flow = 1.0 / LITRE_PER_MINUTE
    panels = [
        ("valve, %", [("command", 10 * run.voltage), ("spool", 100 * run.spool_position)]),
        ("position, mm", [("position", 1e3 * run.position)]),
        (
            "pressure, bar",
            [
                (label, run[name] / 1e5)
                for label, name in (
                    ("a (bore)", "pressure_a"),
                    ("b (rod)", "pressure_b"),
                    ("supply", "supply_pressure"),
                )
            ],
        ),
        (
            "flow, l/min",
            [("into a", flow * run.flow_a), ("out of b", flow * run.flow_b), ("leakage a→b", flow * run.leakage_flow)],
        ),
        ("acceleration, m/s²", [("acceleration", run.acceleration)]),
    ]
    for axis, (label, lines) in zip(axes, panels, strict=True):
        for name, values in lines:
            axis.plot(run.time, values, label=name, linewidth=1.2)
        axis.set_ylabel(label)
        axis.grid(alpha=0.3)
        if len(lines) > 1:
            # Above the panel: inside, it would lie over one of the lines.
            axis.legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), fontsize=8, ncols=len(lines), frameon=False)
    axes[-1].set_xlabel("time, s")
    figure.suptitle(f"internal leakage {leak_at_test_pressure(run.parameters):.3g} l/min at 100 bar", fontsize=10)
    return figure
