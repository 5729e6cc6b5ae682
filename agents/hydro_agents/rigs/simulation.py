"""``hydro simulate``: one open-loop run of a rig as CSV and picture."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pandas as pd

from hydro_agents.report.kit import drawn, figure_of, panels, picture
from hydro_agents.rigs.check import resting_place
from hydro_agents.running.folders import output_folder
from hydro_env import ConfigurationError, PlantParameters, Trajectory, equilibrium, simulate
from hydro_env.files import write_text, write_whole
from hydro_env.mistakes import unknown
from hydro_env.plant.analysis import leak_at_test_pressure
from hydro_env.plant.parts.leakage import leak_past_piston
from hydro_env.plant.simulate import TRAJECTORY_NAMES, TRAJECTORY_UNITS
from hydro_env.plant.workable import refuse_unworkable
from hydro_env.task.configuration import LEAKAGE_LIMIT
from hydro_env.task.rig import read_rig
from hydro_env.types import Floats
from hydro_env.units import FULL_VOLTAGE, LITRE_PER_MINUTE

CSV_FILE = "trajectory.csv"
PICTURE_FILE = "trajectory.png"
RIG_FILE = "rig.yaml"
FILES = (CSV_FILE, PICTURE_FILE, RIG_FILE)
SAMPLE_TIME = 1e-3  # s, for which each voltage is held
SHAPES = ("step", "sine", "sweep", "stop")


def input_voltage(signal: str, voltage: float, samples: int, sample_time: float, holding: float) -> Floats:
    """An input in V, (samples,): ``voltage`` times a shape, added to the voltage that holds the start.

    ``step``: constant after 10 % of the time. ``stop``: constant, and the holding voltage for the last 60 %.
    ``sine``: 1 Hz. ``sweep``: from 0.5 to 50 Hz, logarithmically. The sum is limited to ±10 V.
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
    return np.clip(holding + voltage * shape, -FULL_VOLTAGE, FULL_VOLTAGE)


def simulate_to_folder(
    folder: Path,
    rig: Path | None,
    signal: str,
    voltage: float,
    duration: float,
    leakage: float | None,
    position: float | None,
    overwrite: bool,
) -> list[str]:
    """Simulate and write ``trajectory.csv``, ``trajectory.png`` and ``rig.yaml``; see ``hydro simulate --help``.

    Returns:
        Lines for the user: the start, the range of the voltage, and the files.

    Raises:
        ConfigurationError: an argument is impossible, or the folder cannot be used.
    """
    if signal not in SHAPES:
        raise ConfigurationError(f"--input {signal}: {unknown(signal, SHAPES)}")
    parameters = PlantParameters() if rig is None else read_rig(rig).plant
    if leakage is not None:
        if not 0.0 <= leakage <= LEAKAGE_LIMIT:
            raise ConfigurationError(f"--leakage = {leakage:g} l/min: must be within 0 to {LEAKAGE_LIMIT:g} l/min")
        parameters = parameters.replace(leakage=leak_past_piston(leakage, "laminar"))
    refuse_unworkable(parameters, str(rig or "rig"))
    if position is None:
        position = resting_place(parameters)
    _, holding = equilibrium(parameters, position)
    inputs = input_voltage(signal, voltage, round(duration / SAMPLE_TIME), SAMPLE_TIME, holding)
    run = simulate(parameters, inputs, SAMPLE_TIME, {"position": position})
    with output_folder(folder, "simulate", FILES, overwrite=overwrite):
        write_text(folder / CSV_FILE, trajectory_csv(run))
        write_whole(folder / PICTURE_FILE, trajectory_png(run))
        parameters.to_yaml(folder / RIG_FILE)
    return [
        f"start: {1e3 * position:g} mm from mid-stroke",
        f"voltage: {inputs.min():.3g} to {inputs.max():.3g} V ({holding:.3g} V hold the initial position, plus "
        f"--voltage {voltage:g} V)",
        *(str(folder / name) for name in FILES),
    ]


def trajectory_csv(run: Trajectory) -> str:
    """All quantities in SI; the first line names each with its unit."""
    table = pd.DataFrame({f"{name} [{TRAJECTORY_UNITS[name]}]": run[name] for name in TRAJECTORY_NAMES})
    text: str = table.to_csv(index=False, float_format="%.9g", lineterminator="\n")
    return text


@drawn
def trajectory_png(run: Trajectory) -> bytes:
    """A picture of command and spool, position, pressures, flows and acceleration over time."""
    flow, bar = 1.0 / LITRE_PER_MINUTE, 1e-5
    shown = {
        "valve, %": {"command": 10 * run.voltage, "spool": 100 * run.spool_position},
        "position, mm": {"position": 1e3 * run.position},
        "pressure, bar": {
            "a (bore)": bar * run.pressure_a,
            "b (rod)": bar * run.pressure_b,
            "supply": bar * run.supply_pressure,
        },
        "flow, l/min": {
            "into a": flow * run.flow_a,
            "out of b": flow * run.flow_b,
            "leakage a→b": flow * run.leakage_flow,
        },
        "acceleration, m/s²": {"acceleration": run.acceleration},
    }
    axes = panels(len(shown), height=10.5)
    for panel, (label, lines) in zip(axes, shown.items(), strict=True):
        for name, values in lines.items():
            panel.plot(run.time, values, label=name, marker="", linewidth=1.2)
        panel.set_ylabel(label)
    axes[-1].set_xlabel("time, s")
    leak = leak_at_test_pressure(run.parameters)
    figure_of(axes).suptitle(f"internal leakage {leak:.3g} l/min at 100 bar", fontsize=10)
    return picture(axes, "png")
