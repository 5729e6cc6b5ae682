"""What `hydro identify` and `hydro diagnose` say about public recordings of real machines (docs/leakage.md).

Run: python benchmarks/real_machines.py FOLDER [--only festo shake refusals simulators] [--samples 2 4] [--fit 1 2]

FOLDER holds the folders that benchmarks/notes names; what is absent is left out. The Festo axis is identified from
steps of the voltages ``--fit`` and predicted at the others. The shake table
(github.com/SJ-Chuang/TD3-Shake-Table-System) is identified from its training runs; each forecast of a test run lasts
2 s and begins at a measured state. Recordings of other simulators have their leak in their name,
PLANT_MOTION_LEAK_SEED, l/min at 100 bar.
"""

from argparse import Namespace
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks import command_line
from hydro_agents.running.console import ProgressDisplay
from hydro_agents.running.text import markdown
from hydro_env import HydroError, TaskConfig
from hydro_env.files import read_yaml
from hydro_env.folders import config_file
from hydro_env.task.configuration import task_config
from hydro_env.task.rig import read_rig
from hydro_env.task.sensors import POSITION, PRESSURE_A
from hydro_rig.diagnosis.diagnose import diagnose
from hydro_rig.diagnosis.verdict import Kind, Limits, Verdict
from hydro_rig.estimation.solver import told_to
from hydro_rig.identification.found_rig import shown
from hydro_rig.identification.held_back import HeldBack
from hydro_rig.identification.identify import Identification, identify
from hydro_rig.recordings.columns import ColumnMap

HERE, MAPS = Path(__file__).parent, read_yaml(Path(__file__).with_suffix(".yaml"))
FESTO, SHAKE = "festo_tp511", "td3_shake_table"  # folders
SIMULATORS = {"exudyn_axes": {"A1": "a1 t5", "A3": "a2 t2"}, "hopsan_servo_axis": {"B0": "b0 t2", "B1": "b1 t2"}}
"""By folder, the files of rig and task of each plant, by the first letters of its recordings."""

MOVING = 0.3  # of the largest speed
PERIODS = {"faster/faster.csv": 7.7531e-3}  # s, of the controllers that are not those of the default task


def map_of(entries: dict[str, Any] | None) -> ColumnMap | None:
    """A map of columns."""
    return None if entries is None else ColumnMap.model_validate(entries)


def identified(
    rig: Path, files: Sequence[Path], maps: Sequence[ColumnMap | None], held_back: list[str]
) -> Identification:
    """The rig of some files, and what it predicts of those held back; the verdict is printed."""
    with ProgressDisplay() as display, told_to(display.update):
        found = identify(list(files), task_config(None, rig=rig), read_rig(rig), list(maps), held_back)
    print(f"\n{found.verdict()}\n{len(files)} recordings; {len(found.fit.misfit)} windows\n")
    return found


def festo(given: Namespace) -> None:
    """Identify the axis from steps of some voltages and predict the others."""
    names = {
        given.folder / FESTO / f"m_find_b_p{chamber}_{volts}V_sample_{sample}.mat": (volts, chamber)
        for sample in given.samples
        for volts in range(1, 6)
        for chamber in "AB"
    }
    entries = dict(MAPS[FESTO])
    pressure = entries.pop("pressure")
    maps = [map_of(entries | {f"pressure_{chamber.lower()}": pressure}) for _, chamber in names.values()]
    others = [volts for volts in range(1, 6) if volts not in given.fit]
    found = identified(HERE / "festo_tp511.yaml", [*names], maps, [f"*_{volts}V_*" for volts in others])
    fit, lines = found.fit, []
    for one in fit.unknowns:
        look = shown(one.name)
        cells = [look.value(one.value, one.high - one.low), look.span(one.low, one.high)]
        lines.append((look.words, look.unit, *cells, "yes" if fit.knows(one) else "no"))
    print(markdown(("unknown", "unit", "found", "95 % interval", "determined"), lines), end="\n\n")
    path_of, lines = list(names), []
    for volts in others:
        for place, chamber in enumerate("AB", 1):
            parts = [part for part in found.held_back if names[path_of[part.recording]] == (volts, chamber)]
            position = 1e3 * np.median([part.whole.error[0] for part in parts])
            figures = np.median([in_motion(part, place) for part in parts], axis=0)
            cells = [f"{100.0 * ratio:+.1f} %" for ratio in figures[:2]]
            cells += [f"{1e-5 * pressure:+.2f}" for pressure in figures[2:]]
            lines.append((f"{volts} V", chamber.lower(), f"{position:.1f}", *cells))
    header = ("step", "chamber", "position, mm", "speed out", "speed in", "pressure out, bar", "pressure in, bar")
    print(markdown(header, lines, left=(0, 1)))


def in_motion(part: HeldBack, channel: int) -> list[float]:
    """Simulated over measured speed minus 1, and minus measured pressure, Pa: medians of motion out, and in."""
    position = np.stack([part.measured[0], part.simulated[0]])
    speed = position[:, 50:] - position[:, :-50]
    both = [np.all(sign * speed > MOVING * np.nanmax(np.abs(speed[0])), axis=0) for sign in (1.0, -1.0)]
    error = (part.simulated[channel] - part.measured[channel])[25:-25]
    ratios = [float(np.median(speed[1, moves] / speed[0, moves])) - 1.0 for moves in both]
    return ratios + [float(np.nanmedian(error[moves])) for moves in both]


def shake(given: Namespace) -> None:
    """Identify the shake table from one of eight training runs, and forecast its test runs over 2 s."""
    training, test = (sorted((given.folder / SHAKE / name).glob("*.csv")) for name in ("train", "test"))
    files = [*training[::8], *test]
    held_back = [str(one) for one in test]
    found = identified(HERE / "shake_table.yaml", files, [map_of(MAPS[SHAKE])] * len(files), held_back)
    length = round(2.0 / found.config.control_period)
    for channel, name in ((POSITION, "position"), (PRESSURE_A, "load pressure")):
        shares = []
        for part in found.held_back:
            measured, simulated = part.forecasts[:, :, channel, :length]
            whole = np.isfinite(measured).all(axis=1)
            away = measured[whole] - measured[whole].mean(axis=1, keepdims=True)
            shares.append(1.0 - ((measured - simulated)[whole] ** 2).sum() / (away**2).sum())
        print(f"{name}: share of the variance over 2 s, median {np.median(shares):.3f}, worst {np.min(shares):.3f}")


def refusals(given: Namespace) -> None:
    """What the commands answer to recordings of other machines."""
    rig = "kovari_2015"
    print("\n| recording | command | answer |\n|---|---|---|")
    for pattern, entries in MAPS.items():
        config = task_config(None, rig=rig, control_period=PERIODS.get(pattern, TaskConfig().control_period))
        for path in sorted(given.folder.glob(pattern))[:1] if "/" in pattern else []:
            for command in ("identify", "diagnose"):
                try:
                    if command == "identify":
                        known = read_rig(config_file("rigs", Path(rig)))
                        answer = identify([path], config, known, [map_of(entries)]).verdict()
                    else:
                        answer = diagnose(path, config, map_of(entries)).verdict.line()
                except HydroError as error:
                    answer = str(error).replace(f"{path}: ", "").split("; headings")[0]
                print(f"| {path.parts[-2]}/{path.name} | {command} | {answer} |", flush=True)


def simulators(given: Namespace) -> None:
    """The verdicts on recordings of axes with known leaks in simulators that nobody here wrote."""
    print("\n| recording | leak | verdict | leak that was read | |\n|---|---:|---|---|---|")
    count = Counter({"right": 0, "wrong": 0, "cannot tell": 0})
    for name, plants in SIMULATORS.items():
        for path in sorted((given.folder / name).glob("*.csv")):
            rig, task = (given.folder / name / f"{one}.yaml" for one in plants[path.name[:2]].split())
            config, leak = task_config(task, rig=rig), float(path.stem.split("_")[-2])
            found = diagnose(path, config).verdict
            outcome = judged(found, leak, Limits.of(config))
            count[outcome] += 1
            read = found.leak.text().split(" l/min")[0] if found.leak else ""
            why = "" if found.kind in (Kind.HEALTHY, Kind.UNKNOWN) else f": {found.why}"
            print(f"| {path.stem} | {leak:g} | {found.kind}{why} | {read} | {outcome} |", flush=True)
    print("\n" + ", ".join(f"{number} {outcome}" for outcome, number in count.items()))


def judged(verdict: Verdict, leak: float, limits: Limits) -> str:
    """Whether a verdict on a rig without any other fault is right; between the two limits a seal may be called both."""
    if verdict.kind is Kind.UNKNOWN:
        return "cannot tell"
    right = {Kind.HEALTHY: leak < limits.fault, Kind.LEAK: leak > limits.healthy and "besides" not in verdict.why}
    return "right" if right.get(verdict.kind) else "wrong"


PARTS = {made.__name__: made for made in (festo, shake, refusals, simulators)}


def main() -> None:
    """Print the tables of the recordings that the folder holds."""
    given = command_line(__doc__, "folder", only=PARTS, fit=[1, 2], samples=[2, 4])
    needed = {"festo": given.folder / FESTO, "shake": given.folder / SHAKE}
    for name in given.only:
        if needed.get(name, given.folder).is_dir():
            PARTS[name](given)


if __name__ == "__main__":
    main()
