"""Controllers on drawn rigs that no training saw: their errors beside those of untuned flow linearisation, and returns.

An agent of one's own reads the observation of ``rig="drawn"``, the baseline that of the rig's own task. Both get the
same plants, references and noise.
"""

from collections.abc import Iterator, Mapping
from pathlib import Path

import numpy as np
import pandas as pd

from hydro_agents.controllers.base import Controller
from hydro_agents.controllers.registry import CONTROLLERS
from hydro_agents.learning.loading import SHIPPED_WEIGHTS, load_controller
from hydro_agents.running.cases import Cases, Rollout, run_cases
from hydro_agents.running.jobs import Columns, Job, Report, fingerprint, run_jobs
from hydro_agents.running.seeds import ANY_AXIS
from hydro_env import ConfigurationError, TaskConfig, task_config
from hydro_env.task.drawn_rigs import rig_tasks
from hydro_env.task.reference_signals import MOVING_FAMILIES

UNTUNED = "flow linearisation, untuned"
LEAKS = (0.05, 2.0)  # l/min at 100 bar
PLANTS = 8  # of each family and leak
RESAMPLES = 2000


def cases_of(number: int, plants: int = PLANTS) -> Cases:
    """The cases on a rig: plants of each moving family of references, at each leak."""
    pairs = [(family, leak) for family in MOVING_FAMILIES for leak in LEAKS for _ in range(plants)]
    seeds = np.array(ANY_AXIS.take(len(pairs), 1000 + (400 * number) % 40_000))
    return Cases(seeds, np.array([leak for _, leak in pairs]), np.array([family for family, _ in pairs]))


def errors_of(run: Rollout, cases: Cases, stroke: float) -> dict[str, float]:
    """Errors of each family in the frame of the sensor, their geometric mean, µm; failures; valve travel, 1/s.

    A failed axis is wrong by its stroke for the rest of the episode.
    """
    error = np.abs(run.position + run.position_bias[:, None] - run.reference)
    for axis in np.flatnonzero(run.failed_at >= 0):
        error[axis, run.failed_at[axis] :] = stroke
    errors = {f"{family}_um": 1e6 * error[cases.families == family].mean() for family in MOVING_FAMILIES}
    return {
        "error_um": np.exp(np.mean(np.log(list(errors.values())))),
        "failures": (run.failed_at >= 0).sum(),
        "travel": np.abs(np.diff(run.command, axis=1)).mean() / run.time[0],
        **errors,
    }


def on_rig(controller: Controller | None, what: str, drawn: TaskConfig, number: int, plants: int) -> Columns:
    """Errors of one rig (:func:`errors_of`), and mean and standard deviation of the returns of its episodes.

    ``controller`` is an agent that reads the observation of drawn rigs; ``None``: ``what`` is loaded for the rig's own
    task (:func:`~hydro_agents.learning.loading.load_controller`).
    """
    assert drawn.law
    law = {"first": drawn.law.first + number, "count": 1}
    own = task = rig_tasks(task_config(drawn, law=law | {"preview_paces": ()}))[0]
    if controller is None:
        controller = load_controller(what, own, what)
    else:
        task = task_config(drawn, law=law)
    cases = cases_of(number, plants)
    run = run_cases(task, controller, cases)
    returns = run.reward.sum(axis=1)
    found = {
        "rig": number,
        **errors_of(run, cases, own.plant.cylinder.stroke),
        "return": returns.mean(),
        "return_sd": returns.std(),
    }
    return {name: np.array([value]) for name, value in found.items()}


def on_drawn_rigs(
    drawn: TaskConfig, agents: Mapping[str, str], plants: int, folder: Path | None, progress: Report | None = None
) -> pd.DataFrame:
    """One row per agent and rig, untuned flow linearisation first; finished jobs in the folder are read.

    Raises:
        ConfigurationError: an agent cannot be made, or failed.
    """
    jobs = {}
    assert drawn.law
    first_rig = rig_tasks(task_config(drawn, law={"count": 1, "preview_paces": ()}))[0]
    for name, what in {UNTUNED: "flow_linearising", **agents}.items():
        of_rig, digest = ":" not in what, what
        controller = None if of_rig else load_controller(what, drawn, name)
        if what not in (*CONTROLLERS, *SHIPPED_WEIGHTS):
            digest = fingerprint(controller or load_controller(what, first_rig, name))
        for rig in range(drawn.law.count):
            jobs[f"{name}|{rig}"] = Job(on_rig, controller, (what, drawn, rig, plants), digest)
    first = {key: job for key, job in jobs.items() if key.endswith("|0")}  # an agent that fails, fails at once
    others = {key: job for key, job in jobs.items() if key not in first}
    rows = {}
    for part, told in ((first, None), (others, progress)):
        for key, answer in run_jobs(part, folder, told).items():
            name, _, number = key.partition("|")
            if answer.error:
                raise ConfigurationError(f"{name}, rig {number}: {answer.error}")
            rows[key] = pd.DataFrame({"agent": name.partition("#")[0], **answer.metrics})
    return pd.concat([rows[key] for key in jobs], ignore_index=True)


def in_words(ratio: pd.Series) -> list[str]:
    """Of errors relative to another, one per rig: rigs, median (95 %), geometric mean, better on, range."""
    chosen = np.random.default_rng(0).integers(0, len(ratio), (RESAMPLES, len(ratio)))
    low, high = np.quantile(np.median(ratio.to_numpy()[chosen], axis=1), [0.025, 0.975])
    return [
        f"{len(ratio)}",
        f"{ratio.median():.3f} ({low:.3f}–{high:.3f})",
        f"{np.exp(np.log(ratio).mean()):.3f}",
        f"{int((ratio < 1.0).sum())}",
        f"{ratio.min():.3f}–{ratio.max():.3f}",
    ]


def beside_untuned(rows: pd.DataFrame, by: str) -> Iterator[tuple[str, pd.DataFrame, list[str]]]:
    """Each controller of the column ``by``, its rows, and its errors relative to untuned flow linearisation's."""
    errors = rows.pivot_table("error_um", "rig", by)  # of the seeds of a training, the mean
    for name in rows[by].unique():
        yield name, rows[rows[by] == name], in_words((errors[name] / errors[UNTUNED]).dropna())


def summary(rows: pd.DataFrame) -> Iterator[list[str]]:
    """One row per agent: its errors relative to those of untuned flow linearisation, failures, and its return."""
    for name, own, ratios in beside_untuned(rows, "agent"):
        returns = own["return"].to_numpy()
        spread = np.sqrt(np.mean(own["return_sd"] ** 2 + (returns - returns.mean()) ** 2))
        yield [name, *ratios, f"{int(own['failures'].sum())}", f"{returns.mean():.1f} ± {spread:.1f}"]
