"""Gains of flow linearisation for rigs that nobody tunes: one set for any rig, and sets of which a simulation chooses.

Run: python benchmarks/no_tuning.py [--evaluations 700] [--folder FOLDER]
     python benchmarks/no_tuning.py --sets [--rigs 24] [--evaluations 252] [--folder FOLDER]

It searches one set of gains over drawn rigs, the defaults of the class. With ``--sets`` it
tunes a set for each of some training rigs, and keeps the eight that serve twice as many other ones best together:
``configs/agents/flow_linearising_sets.yaml``. ``any_axis.py`` judges them on other drawn rigs. An interrupted run goes
on where it was.
"""

from pathlib import Path

import numpy as np

from benchmarks import command_line
from hydro_agents.controllers.flow_linearising import FlowLinearisingGains
from hydro_agents.learning.loading import usual_gains
from hydro_agents.learning.rig_gains import CHOICE_CASES
from hydro_agents.learning.tuning import Search, Tuned, costs_of_sets, tune
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
    start = FlowLinearisingGains(**usual_gains(KIND))

    def progress(best: Tuned) -> None:
        write_yaml(folder / "gains.yaml", best.gains.model_dump(mode="json"))
        print(f"{best.evaluations} candidates: {1e3 * best.cost:.5f} mm", flush=True)

    search = Search(start, evaluations, cases=CASES)
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
    costs = [costs_of_sets(KIND, sets, [task], CHOICE_CASES, 0)["costs"] for task in training(JUDGING_RIGS, 2 * rigs)]
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
        best = tune(KIND, [task], Search(FlowLinearisingGains(), evaluations, cases=cases), folder)
        write_yaml(file, best.gains.model_dump(mode="json"))
    return FlowLinearisingGains(**read_yaml(file))


def main() -> None:
    """Run one of the two commands."""
    given = command_line(__doc__, sets=False, evaluations=int, rigs=24, folder=Path("results/no_tuning"))
    if given.sets:
        sets_for_any_rig(given.folder, given.rigs, given.evaluations or 252)
    else:
        tune_for_any_rig(given.folder, given.evaluations or 700)


if __name__ == "__main__":
    main()
