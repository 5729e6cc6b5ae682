"""What `hydro identify` and `hydro diagnose` say about public recordings of real machines (docs/real_machines.md).

Run: python benchmarks/real_machines.py FOLDER [--only festo speeds friction refusals] [--samples 2 4] [--fit 1 2]

FOLDER holds the folders that the page names; what is absent is left out. The Festo axis is identified from steps of
some voltages and predicted at the others.
"""

from __future__ import annotations

import argparse
import os
import time
from pathlib import Path

import numpy as np

from hydro_agents.detection.monitor import load_head
from hydro_agents.running.console import ProgressDisplay
from hydro_env import HydroError
from hydro_env.folders import config_file
from hydro_env.plant.arrays import plant_coefficients
from hydro_env.task.configuration import task_config
from hydro_env.task.rig import read_rig
from hydro_rig.diagnosis.diagnose import diagnose
from hydro_rig.identification.found_rig import shown
from hydro_rig.identification.held_back import HeldBack
from hydro_rig.identification.identify import identify
from hydro_rig.identification.repeatability import share_inside
from hydro_rig.recordings.columns import ColumnMap
from hydro_rig.recordings.recording import read_recording
from hydro_rig.recordings.sampling import Sampled, sampled

RIG = Path(__file__).parent / "festo_tp511.yaml"
FESTO = "festo_tp511"  # the folder with the MAT files
PARTS = ["festo", "speeds", "friction", "refusals"]
MOVING = 0.3  # of the largest speed

OTHERS = {
    "sjoberg_hydraulic_crane/crane.csv": {
        "time": {"column": "sample", "unit": "ms", "gain": 5.0},  # neither the sampling time is known
        "command": {"column": "valve_opening_u", "unit": "-", "gain": 0.6},
        "position": {"column": "position_x", "unit": "m", "gain": 0.05},
        "pressure_a": {"column": "pressure_p", "unit": "bar", "gain": 10.0, "offset": 45.0},
    },
    # nor a unit: the scales bring its signals into the ranges of the rig
    "vtnsi_rotary_actuators/Act_1/*.txt": None,
    "mbari_wec_bench/FrictionIDMovesWithBiasCurr.exp": {
        "time": {"column": 1, "unit": "s"},
        "command": {"column": "RPM", "unit": "-", "gain": 1e-4},
        "position": {"column": 2, "unit": "in", "offset": -39.0},
        "pressure_a": {"column": 5, "unit": "psi"},
        "pressure_b": {"column": 6, "unit": "psi"},
    },
}
"""Recordings of machines that are none of ours, and their maps; ``None``: without a map."""


def festo_map(chamber: str) -> ColumnMap:
    """The columns of a file with the pressure of one chamber: raw readings, 20 mm/V."""
    return ColumnMap.model_validate(
        {
            "time": {"column": "t", "unit": "s"},
            "command": {"column": "w_verdadero2", "unit": "V"},
            "position": {"column": "poloha_bez_filtr2", "unit": "mm", "gain": 20.0, "offset": -102.9},
            f"pressure_{chamber}": {"column": "pressure_bez_filtr1", "unit": "MPa"},
        }
    )


def festo(folder: Path, samples: list[int], fitted: list[int]) -> None:
    """Identify the axis from steps of some voltages and predict the others."""
    names = {
        folder / f"m_find_b_p{chamber}_{volts}V_sample_{sample}.mat": (volts, chamber)
        for sample in samples
        for volts in range(1, 6)
        for chamber in "AB"
    }
    maps = [festo_map(chamber.lower()) for _, chamber in names.values()]
    began, cost = time.monotonic(), time.process_time()
    others = [volts for volts in range(1, 6) if volts not in fitted]
    apart = [f"*_{volts}V_*" for volts in others]
    task, rig = task_config(None, rig=RIG), read_rig(RIG)
    with ProgressDisplay() as display:
        found = identify(list(names), task, rig, maps, display.update, apart)
    recorded = sum(float(recording.time[-1]) for recording in found.recordings)
    print(f"\n{found.verdict()}")
    print(
        f"{len(names)} recordings, {recorded:.0f} s; {len(found.fit.misfit)} windows; "
        f"{time.monotonic() - began:.0f} s, {time.process_time() - cost:.0f} s of one core; {os.cpu_count()} cores\n"
    )
    print("| unknown | unit | found | 95 % interval | determined | standard deviation of the recordings |")
    print("|---|---|---:|---|---|---:|")
    repeats = {one.name: one for one in found.repeats}
    for one in found.fit.unknowns:
        look, known = shown(one.name, found.config.plant), found.fit.knows(one)
        spread = repeats[one.name].spread if one.name in repeats else float("nan")
        cells = [look.value(one.value, one.high - one.low), look.span(one.low, one.high)]
        own = "–" if np.isnan(spread) else look.value(spread, spread)
        print(f"| {look.words} | {look.unit} | {cells[0]} | {cells[1]} | {'yes' if known else 'no'} | {own} |")
    print(f"\nintervals of single recordings that hold the common value: {share_inside(found.repeats):.0%}\n")
    print("| step | chamber | position, mm | speed out | speed in | pressure out, bar | pressure in, bar |")
    print("|---|---|---:|---:|---:|---:|---:|")
    path_of = list(names)
    worst = 0.0
    for volts in others:
        for place, chamber in enumerate("AB", 1):
            parts = [part for part in found.held_back if names[path_of[part.recording]] == (volts, chamber)]
            ratios = 100.0 * np.median([part.speed_ratios for part in parts], axis=0)
            position = 1e3 * np.median([part.error[0] for part in parts])
            pressures = 1e-5 * np.median([moving_errors(part, place) for part in parts], axis=0)
            worst = max(worst, float(np.abs(ratios).max()))
            print(
                f"| {volts} V | {chamber.lower()} | {position:.1f} | {ratios[0]:+.1f} % | {ratios[1]:+.1f} % "
                f"| {pressures[0]:+.2f} | {pressures[1]:+.2f} |"
            )
    print(f"\nlargest error of a speed: {worst:.1f} %")


def speeds(folder: Path, samples: list[int]) -> None:
    """Print the measured speeds, and how far a straight line through those of 1 and 2 V misses the others."""
    config = task_config(None, rig=RIG)
    print("\n| step | chamber | speed out, mm/s | speed in, mm/s | line through 1 and 2 V: out | in |")
    print("|---|---|---|---|---:|---:|")
    for chamber in "AB":
        middle = {}
        for volts in range(1, 6):
            paths = [folder / f"m_find_b_p{chamber}_{volts}V_sample_{sample}.mat" for sample in samples]
            recordings = [read_recording(path, festo_map(chamber.lower())) for path in paths]
            found = np.array([steady_speeds(sampled(one, config, None)) for one in recordings])
            middle[volts] = np.median(found, axis=0)
            line = middle[1] + (volts - 1) * (middle[min(volts, 2)] - middle[1])
            missed = [f"{100 * ratio:+.1f} %" if volts > 2 else "–" for ratio in line / middle[volts] - 1.0]
            ranges = [f"{low:.1f} to {high:.1f}" for low, high in 1e3 * np.array([found.min(0), found.max(0)]).T]
            print(f"| {volts} V | {chamber.lower()} | {ranges[0]} | {ranges[1]} | {missed[0]} | {missed[1]} |")


def steady(samples: Sampled) -> tuple[np.ndarray, np.ndarray]:
    """The samples out and in, (T,) each, in the middle of the stroke."""
    position, command = samples.signals[0], samples.signals[4]
    inside = np.abs(position) < 0.055
    return inside & (command > 0.0), inside & (command < 0.0)


def steady_speeds(samples: Sampled) -> tuple[float, float]:
    """Speed out and in, m/s, in the middle of the stroke."""
    out, back = (abs(float(np.polyfit(samples.time[k], samples.signals[0, k], 1)[0])) for k in steady(samples))
    return out, back


def friction(folder: Path, samples: list[int]) -> None:
    """Print the force of the pressures at constant speed, and how well some laws of friction describe it.

    The pressures of the chambers come from different runs: each is the mean over the runs with its transducer.
    """
    config = task_config(None, rig=RIG)
    areas = plant_coefficients(config.plant)
    rows = []
    print("\n| step | speed, mm/s | pressure a, bar | pressure b, bar | force, N |")
    print("|---|---:|---:|---:|---:|")
    for volts in range(1, 6):
        found = []  # of each chamber: (runs, directions, 2), pressure and speed
        for channel, chamber in enumerate("AB", 1):
            paths = [folder / f"m_find_b_p{chamber}_{volts}V_sample_{sample}.mat" for sample in samples]
            runs = [sampled(read_recording(path, festo_map(chamber.lower())), config, None) for path in paths]
            pressures = [[np.nanmedian(run.signals[channel, chosen]) for chosen in steady(run)] for run in runs]
            found.append(np.stack([pressures, [steady_speeds(run) for run in runs]], axis=2))
        for direction, sign, word in ((0, 1.0, "out"), (1, -1.0, "in")):
            mean = np.mean(np.array(found)[:, :, direction], axis=1)  # (chambers, 2)
            pressures, speed = mean[:, 0], sign * mean[:, 1].mean()
            rows.append((sign, speed, *pressures, pressures[0] * areas.area_a - pressures[1] * areas.area_b))
            bar = 1e-5 * pressures
            print(f"| {volts} V {word} | {1e3 * speed:.1f} | {bar[0]:.2f} | {bar[1]:.2f} | {rows[-1][-1]:.1f} |")
    sign, speed, pressure_a, pressure_b, force = np.array(rows).T
    laws = {"Coulomb and viscous": [sign, speed]}
    laws["and direction"] = [*laws["Coulomb and viscous"], np.ones_like(sign)]
    laws["and Stribeck, 50 mm/s"] = [*laws["and direction"], sign * np.exp(-((speed / 0.05) ** 2))]
    laws["pressures instead of Stribeck"] = [*laws["and direction"], sign * (pressure_a + pressure_b) * 1e-5]
    print("\n| law of friction | last coefficient | its standard deviation | unexplained, N |\n|---|---:|---:|---:|")
    for name, columns in laws.items():
        matrix = np.column_stack(columns)
        values = np.linalg.lstsq(matrix, force, rcond=None)[0]
        variance = float(np.sum((force - matrix @ values) ** 2)) / (len(force) - len(columns))
        deviation = np.sqrt(variance * np.linalg.inv(matrix.T @ matrix)[-1, -1])
        print(f"| {name} | {values[-1]:.2f} | {deviation:.2f} | {np.sqrt(variance):.1f} |")


def moving_errors(part: HeldBack, channel: int) -> tuple[float, float]:
    """Median of simulated minus measured pressure, Pa, while both move out, and while both move in."""
    position = np.stack([part.measured[0], part.simulated[0]])
    speed = position[:, 50:] - position[:, :-50]
    least = MOVING * np.nanmax(np.abs(speed[0]))
    error = (part.simulated[channel] - part.measured[channel])[25:-25]
    out, back = (np.all(sign * speed > least, axis=0) for sign in (1.0, -1.0))
    return float(np.nanmedian(error[out])), float(np.nanmedian(error[back]))


def refusals(folder: Path) -> None:
    """What the commands answer to recordings of other machines."""
    rig = "kovari_2015"
    config = task_config(None, rig=rig)
    print("\n| recording | command | answer |\n|---|---|---|")
    for pattern, columns in OTHERS.items():
        for path in sorted(folder.glob(pattern))[:1]:
            columns_map = None if columns is None else ColumnMap.model_validate(columns)
            for command in ("identify", "diagnose"):
                try:
                    if command == "identify":
                        known = read_rig(config_file("rigs", Path(rig)))
                        answer = identify(path, config, known, columns_map).verdict()
                    else:
                        answer = diagnose(path, config, load_head(None, config), columns_map).verdict.line()
                except HydroError as error:
                    answer = str(error).replace(f"{path}: ", "").split("; headings")[0]
                print(f"| {path.parts[-2]}/{path.name} | {command} | {answer} |", flush=True)


def main() -> None:
    """Print the tables of the recordings that the folder holds."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", type=Path)
    parser.add_argument("--only", nargs="+", choices=PARTS, default=PARTS)
    parser.add_argument("--fit", type=int, nargs="+", default=[1, 2], help="voltages of the steps that are fitted")
    parser.add_argument("--samples", type=int, nargs="+", default=[2, 4])
    arguments = parser.parse_args()
    if "refusals" in arguments.only:
        refusals(arguments.folder)
    if "speeds" in arguments.only and (arguments.folder / FESTO).is_dir():
        speeds(arguments.folder / FESTO, arguments.samples)
    if "friction" in arguments.only and (arguments.folder / FESTO).is_dir():
        friction(arguments.folder / FESTO, arguments.samples)
    if "festo" in arguments.only and (arguments.folder / FESTO).is_dir():
        festo(arguments.folder / FESTO, arguments.samples, arguments.fit)


if __name__ == "__main__":
    main()
