"""The Cramér–Rao bound of the leak: of the windows of a protocol, and of many motions and sensors."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from pydantic import Field

from hydro_agents.controllers.base import Controller
from hydro_agents.detection.operations import ACTING
from hydro_agents.evaluation.conditions import Cell, columns_of
from hydro_agents.evaluation.leak_protocol import LeakProtocol
from hydro_agents.running.cases import Cases
from hydro_agents.running.jobs import Columns, Job, Report, fingerprint, run_jobs
from hydro_agents.running.seeds import EVALUATION
from hydro_env import ConfigurationError, TaskConfig
from hydro_env.files import Group
from hydro_env.task.configuration import LEAKAGE_LIMIT
from hydro_env.task.sensors import SENSORS
from hydro_rig.estimation.information import TASK, UnknownSets, information, sigma, unknown_sets
from hydro_rig.estimation.known_windows import MOTIONS, known_windows, leak_cases
from hydro_rig.estimation.unknowns import priors_of

ALL_SENSORS = "all sensors"

COLUMNS = ("motion", "leakage_flow_lpm", "seed", "window_s", "unknowns", "sensors", "sigma_lpm")
"""Columns of :func:`survey`."""


def leak_bound(protocol: LeakProtocol, chosen: object) -> Iterator[Cell]:
    """The part ``leak_bound``: the bound of some windows of the conditions that a protocol names."""
    del chosen
    for name in protocol.bound_conditions:
        condition, config = protocol.conditions[name], protocol.task_in(name)
        begin = 0.0 if condition.begins == "at rest" else condition.duration
        times = (begin, condition.duration - config.control_period)
        for level in protocol.levels_in(name):
            if level >= 0.0:
                cases = protocol.cases_in(name, level, protocol.bound_windows)
                arguments = (config, protocol.known_task(name), condition.acting, *times, cases)
                job = Job(bound_of_windows, None, arguments, digest="bound")
                yield Cell("bound", name, {"condition": name, "level": level}, (job,))


def bound_of_windows(
    _: None, config: TaskConfig, known: TaskConfig, acting: str, begin: float, duration: float, cases: Cases
) -> Columns:
    """Smallest standard deviation of the leak, l/min at 100 bar; all quantities that the task draws are unknown.

    Args:
        config: task of the runs.
        known: task that the priors follow from.
        acting: controller of the axes.
        begin: of the windows, s.
        duration: of the windows, s.
        cases: of the runs.

    Raises:
        ConfigurationError: the bound cannot be computed.
    """
    controller = ACTING[acting].make(config, len(cases), int(cases.seeds[0]))
    try:
        windows = known_windows(config, controller, cases, begin, duration)
        gained = information(config, windows, priors_of(known), threads=1)
    except ConfigurationError as error:
        raise ConfigurationError(f"the bound cannot be computed: {error}") from None
    found = np.full(len(cases), np.nan)
    found[windows.case] = sigma(gained)[:, -1]
    return {"seed": cases.seeds.astype(np.float64), "sigma_lpm": found}


class SurveySettings(Group):
    """Leaks, windows and plants of the table."""

    leak_levels: tuple[float, ...] = Field(
        (0.0, 0.05, 0.1, 0.3, 1.0, 4.0), min_length=1, description="l/min at 100 bar"
    )
    windows: tuple[float, ...] = Field((0.5, 1.0, 2.0, 4.0, 8.0), min_length=1, description="s")
    plants: int = Field(24, ge=3, le=10_000, description="of the test seeds, per motion and leak")
    begin: float = Field(1.0, ge=0.0, le=1e4, description="start of the window, s after the start of the episode")
    more_unknowns: tuple[str, ...] = Field((), description="in addition to those of the task, as a separate set")


def sensor_choices(config: TaskConfig) -> dict[str, tuple[str, ...]]:
    """Choices of the sensors that the rig has, by name; the command is always known."""
    fitted = [name for name in SENSORS if getattr(config.sensors, name).fitted]
    choices = {
        ALL_SENSORS: fitted,
        "without pressures": [name for name in fitted if not name.startswith("pressure")],
        "without spool position": [name for name in fitted if name != "spool_position"],
        "without position": [name for name in fitted if name != "position"],
        **{f"{name.replace('_', ' ')} alone": [name] for name in fitted},
    }
    return {name: tuple(sensors) for name, sensors in choices.items() if name == ALL_SENSORS or sensors != fitted}


def checked(settings: SurveySettings, config: TaskConfig) -> UnknownSets:
    """Check leaks, windows and unknowns; returns the sets of unknowns.

    Raises:
        ConfigurationError: a value is impossible or occurs twice.
    """
    for name, values, low, high, unit in (
        ("leak", settings.leak_levels, 0.0, LEAKAGE_LIMIT, "l/min"),
        ("window", settings.windows, 2.0 * config.control_period, 60.0, "s"),
    ):
        for value in values:
            if not low <= value <= high:
                raise ConfigurationError(f"--{name} {value:g}: must be within {low:g} to {high:g} {unit}")
            if values.count(value) > 1:
                raise ConfigurationError(f"--{name} {value:g}: is given twice")
    return unknown_sets(config, settings.more_unknowns)


def survey(
    config: TaskConfig,
    controller: Controller,
    settings: SurveySettings,
    folder: Path | None = None,
    progress: Report | None = None,
) -> pd.DataFrame:
    """The bound of every plant, one row per number, with the columns :data:`COLUMNS`.

    Args:
        config: the task.
        controller: moves the axes.
        settings: leaks, windows, plants and unknowns.
        folder: for the results of the jobs, one per motion and leak; ``None`` keeps none.
        progress: called when a job finishes.

    Raises:
        ConfigurationError: the settings are impossible.
    """
    checked(settings, config)
    return _rows(surveyed, controller, (config, settings), MOTIONS, settings.leak_levels, folder, progress)


def surveyed(controller: Controller, config: TaskConfig, settings: SurveySettings, motion: str, leak: float) -> Columns:
    """The rows of one motion and leak: each set of unknowns with all sensors, each choice of sensors with the task's.

    Raises:
        ConfigurationError: an episode cannot begin.
    """
    unknowns, choices = checked(settings, config), sensor_choices(config)
    cases = leak_cases(EVALUATION.take(settings.plants), settings.plants, leak)
    windows = known_windows(MOTIONS[motion](config), controller, cases, settings.begin, max(settings.windows))
    known = information(MOTIONS[motion](config), windows, unknowns.priors, settings.windows, threads=1)
    pairs = [(name, ALL_SENSORS) for name in unknowns.sets] + [(TASK, name) for name in choices if name != ALL_SENSORS]
    frames = []
    for name, sensors in pairs:
        chosen = unknowns.sets[name]
        values = sigma(known, unknowns=chosen.unknowns, sensors=choices[sensors], widths=chosen.widths)
        frames += [
            pd.DataFrame({"seed": cases.seeds[windows.case], "window_s": length, "sigma_lpm": values[:, place]}).assign(
                motion=motion, leakage_flow_lpm=leak, unknowns=name, sensors=sensors
            )
            for place, length in enumerate(known.lengths)
        ]
    return columns_of(pd.concat(frames, ignore_index=True)[list(COLUMNS)])


def _rows(
    work: Callable[..., Columns],
    controller: Controller,
    arguments: tuple[Any, ...],
    motions: Iterable[str],
    leaks: Iterable[float],
    folder: Path | None,
    progress: Report | None,
) -> pd.DataFrame:
    """The rows of one job per motion and leak, in this order.

    Raises:
        ConfigurationError: a job failed.
    """
    digest, leaks = fingerprint(controller), tuple(leaks)
    jobs = {
        f"{motion}|{leak:g}": Job(work, controller, (*arguments, motion, leak), digest)
        for motion in motions
        for leak in leaks
    }
    results = run_jobs(jobs, folder, None, progress)[0]
    for key in jobs:
        if results[key].error:
            raise ConfigurationError(results[key].error)
    return pd.concat([pd.DataFrame(results[key].metrics) for key in jobs], ignore_index=True)
