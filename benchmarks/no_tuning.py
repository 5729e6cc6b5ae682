"""Gains of flow linearisation for rigs that nobody tunes: one set for any rig, and sets of which a simulation chooses.

Run: python benchmarks/no_tuning.py tune [--evaluations 700] [--folder FOLDER]
     python benchmarks/no_tuning.py sets [--rigs 24] [--evaluations 252] [--folder FOLDER]

``tune`` searches one set of gains over rigs of :mod:`hydro_env.task.drawn_rigs`, the defaults of the class. ``sets``
tunes a set for each of some training rigs, and keeps the eight that serve twice as many other ones best together:
``configs/agents/flow_linearising_sets.yaml``. ``any_axis.py`` judges them on other drawn rigs. An interrupted run goes
on where it was.
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path

import numpy as np

from hydro_agents.controllers.flow_linearising import FlowLinearisingGains
from hydro_agents.learning.loading import usual_gains
from hydro_agents.learning.rig_gains import costs_on_rig
from hydro_agents.learning.tuning import Search, Tuned, tune
from hydro_agents.running.seeds import RIGS
from hydro_env import TaskConfig
from hydro_env.files import read_yaml, write_yaml
from hydro_env.task.configuration import task_config
from hydro_env.task.drawn_rigs import drawn_task, rig_tasks
from hydro_env.task.law import RigLaw

KIND = "flow_linearising"
LAW = RigLaw(preview_paces=())  # previews as in the default task
TRAINING_RIGS, CASES = 12, 14
SETS, SET_RIGS, JUDGING_RIGS = 8, 1100, 1000  # sets beside the default; first training rigs to tune for, and to judge


def tune_for_any_rig(folder: Path, evaluations: int) -> None:
    """Tune one set of gains over the training rigs, from those of the paper's rig; the folder is the checkpoint."""
    tasks = [drawn_task(task_config("mixed_leaks"), LAW, seed) for seed in RIGS.take(TRAINING_RIGS)]
    start = FlowLinearisingGains(**read_yaml(usual_gains(KIND)))
    began = time.perf_counter()

    def progress(best: Tuned) -> None:
        write_yaml(folder / "gains.yaml", best.gains.model_dump(mode="json"))
        took = time.perf_counter() - began
        print(f"{best.evaluations} candidates: {1e3 * best.cost:.5f} mm, {took:.0f} s", flush=True)

    search = Search(evaluations=evaluations, cases=CASES, start=start)
    tune(KIND, tasks, search, folder, progress)


def sets_for_any_rig(folder: Path, rigs: int, evaluations: int) -> None:
    """Tune a set of gains for each of some rigs, and write those that serve others best beside the default."""

    def training(first: int, count: int) -> tuple[TaskConfig, ...]:
        law = {"split": "training", "first": first, "count": count, "preview_paces": []}
        return rig_tasks(task_config(law=law))

    sets = [FlowLinearisingGains()]
    for number, task in enumerate(training(SET_RIGS, rigs)):
        sets.append(tuned_for(task, folder / f"set_{number:02}", evaluations, CASES))
        print(f"set {number + 1} of {rigs}", flush=True)
    costs = [costs_on_rig(KIND, sets, task) for task in training(JUDGING_RIGS, 2 * rigs)]
    errors = np.log(costs)
    chosen = [0]
    while len(chosen) <= min(SETS, rigs):
        left = [number for number in range(len(sets)) if number not in chosen]
        chosen.append(min(left, key=lambda number: errors[:, [*chosen, number]].min(axis=1).mean()))
        ratio = np.exp(errors[:, chosen].min(axis=1) - errors[:, 0])
        print(f"{len(chosen)} sets: {np.median(ratio):.3f} of the default's error, median")
    rounded = [{name: float(f"{value:.3g}") for name, value in sets[number].model_dump().items()} for number in chosen]
    write_yaml(folder / "flow_linearising_sets.yaml", {"sets": rounded[1:]})


def tuned_for(task: TaskConfig, folder: Path, evaluations: int, cases: int = 42) -> FlowLinearisingGains:
    """Gains tuned for one rig, from those for any rig; a file keeps them."""
    file = folder / "gains.yaml"
    if not file.exists():
        best = tune(KIND, task, Search(evaluations=evaluations, cases=cases), folder)
        write_yaml(file, best.gains.model_dump(mode="json"))
    return FlowLinearisingGains(**read_yaml(file))


def main() -> None:
    """Run one of the two commands."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", choices=("tune", "sets"))
    parser.add_argument("--evaluations", type=int, help="candidates: of all rigs (700), or of a set (252)")
    parser.add_argument("--rigs", type=int, default=24, help="number of drawn rigs of the sets")
    parser.add_argument("--folder", type=Path, default=Path("results/no_tuning"))
    given = parser.parse_args()
    if given.what == "tune":
        tune_for_any_rig(given.folder, given.evaluations or 700)
    else:
        sets_for_any_rig(given.folder, given.rigs, given.evaluations or 252)


if __name__ == "__main__":
    main()
