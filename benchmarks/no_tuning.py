"""Flow linearisation on rigs that nobody tuned: gains for any rig, and what they cost against gains of the rig's own.

Run: python benchmarks/no_tuning.py tune [--evaluations 700] [--folder FOLDER]
     python benchmarks/no_tuning.py sets [--rigs 24] [--evaluations 252] [--folder FOLDER]
     python benchmarks/no_tuning.py test [--rigs 30] [--evaluations 420] [--folder FOLDER]

``tune`` searches one set of gains over rigs of :mod:`hydro_env.task.drawn_rigs`, the defaults of the class. ``sets``
tunes a set for each of some training rigs, and keeps the eight that serve twice as many other ones best together:
``configs/agents/flow_linearising_sets.yaml``, of which a simulation chooses one for a rig. ``test`` judges the defaults
on other drawn rigs, beside gains tuned for each rig, and the PID that follows from the rig's figures: errors in the
sensor's frame on drawn plants with all leaks and kinds of reference, failures, limit cycles. An interrupted run goes on
where it was.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from hydro_agents.controllers.base import Controller
from hydro_agents.controllers.flow_linearising import FlowLinearising, FlowLinearisingGains
from hydro_agents.controllers.pid import PID
from hydro_agents.evaluation.limit_cycles import counted_at_rest
from hydro_agents.learning.opponents import usual_gains
from hydro_agents.learning.trials import JUDGED, LEAK_LEVELS, REST, REST_LEAKS, RESTING
from hydro_agents.learning.tuning import Tuned, rig_scores, tune
from hydro_agents.rigs.stable_gain import pid_from_figures
from hydro_agents.running.cases import Cases, run_cases
from hydro_agents.running.seeds import RIGS, UNTUNED_RIGS
from hydro_agents.running.text import markdown
from hydro_env import TaskConfig
from hydro_env.files import read_yaml, write_text, write_yaml
from hydro_env.plant.analysis import closed_port_natural_frequency, speed_limits
from hydro_env.task.configuration import task_config
from hydro_env.task.drawn_rigs import drawn_task, rig_tasks
from hydro_env.task.law import RigLaw
from hydro_env.task.reference_signals import MOVING_FAMILIES

KIND = "flow_linearising"
LAW = RigLaw(preview_paces=())  # previews as in the default task
TRAINING_RIGS, CASES = 12, 14
SETS, SET_RIGS, JUDGING_RIGS = 8, 1100, 1000  # sets beside the default; first training rigs to tune for, and to judge
COUNTED = 16  # standstills per rig and controller in the test
UNTUNED, TUNED, FIGURES = "untuned", "tuned", "PID from figures"


def tune_for_any_rig(folder: Path, evaluations: int) -> None:
    """Tune one set of gains over the training rigs, from those of the paper's rig; the log is the checkpoint."""
    tasks = [drawn_task(task_config("mixed_leaks"), LAW, seed) for seed in RIGS.take(TRAINING_RIGS)]
    start = FlowLinearisingGains(**read_yaml(usual_gains(KIND)))
    log, began = folder / "tuning.csv", time.perf_counter()

    def progress(best: Tuned) -> None:
        write_yaml(folder / "gains.yaml", best.gains.model_dump(mode="json"))
        took = time.perf_counter() - began
        print(f"{best.evaluations} candidates: {1e3 * best.score.equal:.5f} mm, {took:.0f} s", flush=True)

    resume = log.exists()
    tune(KIND, tasks, evaluations=evaluations, cases=CASES, start=start, log=log, resume=resume, progress=progress)


def sets_for_any_rig(folder: Path, rigs: int, evaluations: int) -> None:
    """Tune a set of gains for each of some rigs, and write those that serve others best beside the default."""

    def training(first: int, count: int) -> tuple[TaskConfig, ...]:
        law = {"split": "training", "first": first, "count": count, "preview_paces": []}
        return rig_tasks(task_config(law=law))

    sets = [FlowLinearisingGains()]
    for number, task in enumerate(training(SET_RIGS, rigs)):
        sets.append(tuned_for(task, folder / f"set_{number:02}", evaluations, CASES))
        print(f"set {number + 1} of {rigs}", flush=True)
    scores = [rig_scores(KIND, sets, task) for task in training(JUDGING_RIGS, 2 * rigs)]
    errors = np.log([[score.equal for score in of_rig] for of_rig in scores])
    chosen = [0]
    while len(chosen) <= min(SETS, rigs):
        left = [number for number in range(len(sets)) if number not in chosen]
        chosen.append(min(left, key=lambda number: errors[:, [*chosen, number]].min(axis=1).mean()))
        ratio = np.exp(errors[:, chosen].min(axis=1) - errors[:, 0])
        print(f"{len(chosen)} sets: {np.median(ratio):.3f} of the default's error, median")
    rounded = [{name: float(f"{value:.3g}") for name, value in sets[number].model_dump().items()} for number in chosen]
    write_yaml(folder / "flow_linearising_sets.yaml", {"sets": rounded[1:]})


# Test ---------------------------------------------------------------------------------------------------------------


def tuned_for(task: TaskConfig, folder: Path, evaluations: int, cases: int = 42) -> FlowLinearisingGains:
    """Gains tuned for one rig, from those for any rig; a file keeps them."""
    file = folder / "gains.yaml"
    if not file.exists():
        log = folder / "tuning.csv"
        best = tune(KIND, task, evaluations=evaluations, cases=cases, log=log, resume=log.exists())
        write_yaml(file, best.gains.model_dump(mode="json"))
    return FlowLinearisingGains(**read_yaml(file))


def family_errors(controller: Controller, task: TaskConfig, skip: int) -> tuple[dict[str, float], int]:
    """Mean absolute error of each family in the sensor's frame, m, and number of failures.

    A failed axis is wrong by the length of its stroke for the rest of the episode.
    """
    resting = task_config(task, episode_duration=REST)
    parts = ((task, MOVING_FAMILIES, LEAK_LEVELS, task.episode_duration), (resting, RESTING, REST_LEAKS, JUDGED))
    errors: dict[str, float] = {}
    failures = 0
    for config, families, leaks, judged in parts:
        pairs = [(family, leak) for family in families for leak in leaks]
        seeds = np.array(UNTUNED_RIGS.take(len(pairs), skip))
        skip += len(pairs)
        names = np.array([family for family, _ in pairs])
        run = run_cases(config, controller, Cases(seeds, np.array([leak for _, leak in pairs]), names))
        error = np.abs(run.position + run.position_bias[:, None] - run.reference)
        failed = run.failed_at >= 0
        for axis in np.flatnonzero(failed):
            error[axis, run.failed_at[axis] :] = config.plant.cylinder.stroke
        mean = error[:, -round(judged / config.control_period) :].mean(axis=1)
        errors |= {family: float(mean[names == family].mean()) for family in families}
        failures += int(failed.sum())
    return errors, failures


def judged_rig(number: int, folder: Path, evaluations: int) -> Iterator[dict[str, Any]]:
    """A row of results for each controller on one drawn rig; ``evaluations`` = 0: none is tuned for it."""
    task = drawn_task(TaskConfig(), LAW, UNTUNED_RIGS.take(1, number)[0])
    plant = task.plant
    facts = {
        "rig": number,
        "bore_mm": 1e3 * plant.cylinder.bore_diameter,
        "rod_mm": 1e3 * plant.cylinder.rod_diameter,
        "stroke_mm": 1e3 * plant.cylinder.stroke,
        "supply_bar": 1e-5 * plant.supply.pressure,
        "mass_kg": plant.load.mass,
        "frequency_hz": closed_port_natural_frequency(plant) / (2.0 * np.pi),
        "speed_mps": float(np.mean(speed_limits(plant))),
        "overlap": plant.valve.overlap,
        "period_ms": 1e3 * task.control_period,
        "latency_ms": 1e3 * task.command_latency,
    }
    controllers: dict[str, Controller] = {UNTUNED: FlowLinearising(FlowLinearisingGains(), task)}
    if evaluations:
        controllers[TUNED] = FlowLinearising(tuned_for(task, folder / f"rig_{number:02}", evaluations), task)
    figures = pid_from_figures(task)
    if figures is not None:
        controllers[FIGURES] = PID(figures, task)
    for name, controller in controllers.items():
        errors, failures = family_errors(controller, task, 1000 + 100 * number)
        rest = counted_at_rest(controller, task, UNTUNED_RIGS, COUNTED)
        yield {
            **facts,
            "controller": name,
            "error_um": 1e6 * float(np.exp(np.mean(np.log(list(errors.values()))))),
            "failures": failures + int(rest["failures"]),
            "limit_cycles": int(rest["limit_cycles"]),
            "largest_amplitude_um": rest["largest_amplitude_um"],
            **{f"{family}_um": 1e6 * error for family, error in errors.items()},
        }


def summary(rows: pd.DataFrame) -> list[list[str]]:
    """One row per controller: ratios of its errors to those of the untuned gains over the rigs, and what went wrong."""
    errors = rows.pivot(index="rig", columns="controller", values="error_um")
    lines = []
    for name in (UNTUNED, TUNED, FIGURES):
        if name not in errors:
            continue
        ratio = (errors[UNTUNED] / errors[name]).dropna()
        own = rows[rows["controller"] == name]
        low, middle, high = ratio.quantile([0.25, 0.5, 0.75])
        lines.append(
            [
                name,
                str(len(ratio)),
                f"{middle:.2f} ({low:.2f}–{high:.2f})",
                f"{ratio.min():.2f}–{ratio.max():.2f}",
                f"{int(own['failures'].sum())}",
                f"{int(own['limit_cycles'].sum())} on {int((own['limit_cycles'] > 0).sum())} rigs",
                f"{own['largest_amplitude_um'].max():.0f}",
            ]
        )
    return lines


def test_on_other_rigs(folder: Path, rigs: int, evaluations: int) -> None:
    """Judge the gains on other drawn rigs; write the rows of every rig, and print the summary."""
    kept = folder / "test.csv"
    rows = pd.read_csv(kept) if kept.exists() else pd.DataFrame({"rig": []})
    for number in range(rigs):
        if number in set(rows["rig"]):
            continue
        began = time.perf_counter()
        found = pd.DataFrame(judged_rig(number, folder, evaluations))
        rows = found if rows.empty else pd.concat([rows, found], ignore_index=True)
        write_text(kept, rows.to_csv(index=False, float_format="%.5g"))
        errors = ", ".join(f"{row['controller']} {row['error_um']:.1f} µm" for _, row in found.iterrows())
        print(f"rig {number}: {errors}; {time.perf_counter() - began:.0f} s", flush=True)
    header = ("controller", "rigs", "untuned / this, median (middle half)", "lowest–highest")
    print(markdown((*header, "failures", "limit cycles", "largest, µm"), summary(rows)))


def main() -> None:
    """Run one of the two commands."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", choices=("tune", "sets", "test"))
    parser.add_argument(
        "--evaluations", type=int, help="candidates: of all rigs (700), of a set (252), or per rig (420; 0: none)"
    )
    parser.add_argument("--rigs", type=int, help="number of drawn rigs of the test (30) or of the sets (24)")
    parser.add_argument("--folder", type=Path, default=Path("results/no_tuning"))
    given = parser.parse_args()
    default = {"tune": 700, "sets": 252, "test": 420}[given.what]
    evaluations = default if given.evaluations is None else given.evaluations
    if given.what == "tune":
        tune_for_any_rig(given.folder, evaluations)
    elif given.what == "sets":
        sets_for_any_rig(given.folder, given.rigs or 24, evaluations)
    else:
        test_on_other_rigs(given.folder, given.rigs or 30, evaluations)


if __name__ == "__main__":
    main()
