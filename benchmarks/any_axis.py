"""How hard are drawn rigs: a policy for any axis, and its opponents, on test rigs that nobody used.

    python benchmarks/any_axis.py [--weights WEIGHTS] [--rigs 100] [--first 800] [--tuned FOLDER] [--split test]
                                  [--seconds 2] [--output FILE] [--controller NAME] [--structure]

``--controller`` judges it and the untuned one alone, ``--structure`` rigs with loads that bend, waves, sharp edges.
Errors are those in the sensor's frame, every family of references weighing the same; a failed axis is wrong by its
stroke for the rest of the episode. ``--tuned`` adds gains tuned for each rig, as ``benchmarks/no_tuning.py`` does. The
file of rows is the checkpoint: a later call continues it, with more rigs if asked; other weights, splits, seconds or
controllers need a file of their own.
"""

from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import pandas as pd

from benchmarks import command_line, kept_rows
from benchmarks.no_tuning import tuned_for
from hydro_agents.controllers.base import Controller
from hydro_agents.controllers.flow_linearising import FlowLinearising, FlowLinearisingGains
from hydro_agents.controllers.pid import PID, PIDGains
from hydro_agents.controllers.registry import make_controller
from hydro_agents.evaluation.drawn_rigs import UNTUNED, beside_untuned, cases_of, errors_of, in_words
from hydro_agents.learning.policy import PolicyController
from hydro_agents.learning.rig_gains import gain_sets, searched_gains
from hydro_agents.running.cases import run_cases
from hydro_agents.running.folders import pretrained_folder
from hydro_agents.running.limit_cycles import counted_at_rest
from hydro_agents.running.seeds import ANY_AXIS
from hydro_agents.running.text import markdown
from hydro_env import TaskConfig
from hydro_env.task.configuration import task_config
from hydro_env.task.drawn_rigs import rig_tasks

POLICY, TUNED = "policy for any axis", "flow linearisation, tuned for the rig"
SEARCHED = "flow linearisation, gains searched by simulation"
PID_OF_RIG, FIGURES = "PID, gains searched by simulation", "PID, the recommended gain"
PROPORTIONAL = "P, the recommended gain"
STANDSTILLS = 16
STRUCTURE = {"tip_share": 0.6, "wave_share": 0.3, "sharp_share": 0.4}


def measured(controller: Controller, task: TaskConfig, number: int) -> dict[str, Any]:
    """Errors of a controller on one rig (:func:`errors_of`), and how it comes to rest."""
    cases = cases_of(number)
    found = errors_of(run_cases(task, controller, cases), cases, task.plant.cylinder.stroke)
    rest = counted_at_rest(controller, task, ANY_AXIS, STANDSTILLS)
    failures = int(found["failures"]) + int(rest["failures"])
    return {**found, "failures": failures, "limit_cycles": int(rest["limit_cycles"]), "ringing": int(rest["ringing"])}


def proportional(task: TaskConfig) -> PIDGains:
    """The recommended gain alone, and the overlap of the valve; saturation leaves nothing in the integral."""
    gain: Any = gain_sets("pid", task)[0]
    quiet = {"integral": 0.0, "feedforward_extending": 0.0, "feedforward_retracting": 0.0, "anti_windup_time": 10.0}
    overlap = 1.0 if task.plant.valve.overlap else 0.0
    return PIDGains(proportional=float(gain.proportional), overlap_compensation=overlap, **quiet)


def searched(kind: str, task: TaskConfig) -> Controller:
    """A controller whose gains are searched for the rig."""
    return make_controller(kind, task, searched_gains(kind, task).model_dump())


def controllers_on(task: TaskConfig, weights: str, tuned: Path | None) -> dict[str, Callable[[], Controller]]:
    """What makes each controller on one rig, by name."""
    makers: dict[str, Callable[[], Controller]] = {
        UNTUNED: lambda: FlowLinearising(FlowLinearisingGains(), task),
        POLICY: lambda: PolicyController.load(weights).moved_to(task),
        SEARCHED: lambda: searched("flow_linearising", task),
        PID_OF_RIG: lambda: searched("pid", task),
        FIGURES: lambda: make_controller("pid", task, gain_sets("pid", task)[0].model_dump()),
        PROPORTIONAL: lambda: PID(proportional(task), task),
    }
    if tuned is not None:
        makers[TUNED] = lambda: FlowLinearising(tuned_for(task, tuned, 420), task)
    return makers


def rig_rows(
    number: int, task: TaskConfig, chosen: Sequence[str], weights: str, tuned: Path | None, seconds: float
) -> list[dict[str, Any]]:
    """A row of results for each controller, or for the chosen ones, on one rig."""
    makers = controllers_on(task, weights, tuned and tuned / f"rig_{number:03}")
    judged = task_config(task, episode_duration=seconds)
    names = [name for name in makers if name in (UNTUNED, *chosen) or not chosen]
    return [{"rig": number, "controller": name, **measured(makers[name](), judged, number)} for name in names]


def summary(rows: pd.DataFrame) -> Iterator[list[str]]:
    """One row per controller: its errors relative to those of untuned flow linearisation, rig by rig."""
    travel = rows.pivot(index="rig", columns="controller", values="travel")
    for name, own, ratios in beside_untuned(rows, "controller"):
        sums = [str(int(own[column].sum())) for column in ("failures", "limit_cycles", "ringing")]
        yield [name, *ratios, f"{(travel[name] / travel[UNTUNED]).median():.2f}", *sums]


def against(rows: pd.DataFrame) -> Iterator[list[str]]:
    """The errors of policy and searched gains relative to those of gains of the rig, rig by rig."""
    errors = rows.pivot(index="rig", columns="controller", values="error_um")
    for name, other in ((POLICY, SEARCHED), (POLICY, TUNED), (SEARCHED, TUNED), (PID_OF_RIG, FIGURES)):
        if {name, other} <= {*errors}:
            yield [f"{name} ÷ {other}", *in_words((errors[name] / errors[other]).dropna())]


def main() -> None:
    """Judge the policy on the rigs, and print the summary."""
    weights, splits = str(pretrained_folder() / "policy_any_axis"), ("test", "validation", "training")
    options = {"rigs": 100, "split": splits, "first": 0, "structure": False, "tuned": Path, "seconds": 2.0}
    output = Path("results/any_axis.csv")
    given = command_line(__doc__, weights=weights, **options, output=output, controller=[], jobs=2)
    structure = STRUCTURE if given.structure else {}
    law = {"split": given.split, "count": given.rigs, "first": given.first, "preview_paces": [], "structure": structure}
    tasks = rig_tasks(task_config(law=law))

    def rows_of(number: int) -> list[dict[str, Any]]:
        task = tasks[number - given.first]
        return rig_rows(number, task, given.controller, given.weights, given.tuned, given.seconds)

    rows = kept_rows(given.output, "rig", range(given.first, given.first + len(tasks)), rows_of, given.jobs)
    more = ("geometric mean", "better on", "range")
    header = ("controller", "rigs", "error ÷ untuned, median (95 %)", *more)
    print(markdown((*header, "valve travel, median", "failures", "limit cycles", "ringing"), list(summary(rows))))
    print(markdown(("ratio of errors", "rigs", "median (95 %)", *more), list(against(rows))))


if __name__ == "__main__":
    main()
