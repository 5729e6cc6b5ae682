"""The Cramér–Rao bound of the leak on many plants: by leak, motion, length of the window, unknowns and sensors."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from pydantic import Field

from hydro_agents.controllers.base import Controller
from hydro_agents.estimation.information import TASK, Information, UnknownSets, information, sigma, unknown_sets
from hydro_agents.estimation.known_windows import MOTIONS, known_windows, leak_cases
from hydro_agents.running.seeds import EVALUATION
from hydro_env import ConfigurationError, TaskConfig
from hydro_env.files import Group
from hydro_env.task.configuration import LEAKAGE_LIMIT
from hydro_env.task.sensors import SENSORS

Progress = Callable[[str, int, int], None]

ALL_SENSORS = "all sensors"

COLUMNS = ("motion", "leakage_flow_lpm", "seed", "window_s", "unknowns", "sensors", "sigma_lpm")
"""Columns of the table."""


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
    progress: Progress | None = None,
) -> pd.DataFrame:
    """The bound of every plant, one row per number, with the columns :data:`COLUMNS`.

    Args:
        config: the task.
        controller: moves the axes.
        settings: leaks, windows, plants and unknowns.
        progress: called with the phase, the number of combinations of motion and leak done, and their total.

    Raises:
        ConfigurationError: the settings are impossible.
    """
    unknowns, frames = checked(settings, config), []
    jobs = [(motion, leak) for motion in MOTIONS for leak in settings.leak_levels]
    for number, (motion, leak) in enumerate(jobs):
        if progress is not None:
            progress("bound", number, len(jobs))
        task = MOTIONS[motion](config)
        cases = leak_cases(EVALUATION.take(settings.plants), settings.plants, leak)
        windows = known_windows(task, controller, cases, settings.begin, max(settings.windows))
        known = information(task, windows, unknowns.priors, settings.windows)
        frames.append(_rows(known, unknowns, sensor_choices(config), cases.seeds[windows.case], motion, leak))
    if progress is not None:
        progress("bound", len(jobs), len(jobs))
    return pd.concat(frames, ignore_index=True)


def _rows(
    known: Information,
    unknowns: UnknownSets,
    choices: Mapping[str, tuple[str, ...]],
    seeds: NDArray[np.int64],
    motion: str,
    leak: float,
) -> pd.DataFrame:
    """Every set of unknowns with all sensors, and every choice of sensors with the unknowns of the task."""
    pairs = [(name, ALL_SENSORS) for name in unknowns.sets] + [(TASK, name) for name in choices if name != ALL_SENSORS]
    frames = []
    for name, sensors in pairs:
        chosen = unknowns.sets[name]
        values = sigma(known, unknowns=chosen.unknowns, sensors=choices[sensors], widths=chosen.widths)
        frames += [
            pd.DataFrame({"seed": seeds, "window_s": length, "sigma_lpm": values[:, place]}).assign(
                motion=motion, leakage_flow_lpm=leak, unknowns=name, sensors=sensors
            )
            for place, length in enumerate(known.lengths)
        ]
    return pd.concat(frames, ignore_index=True)[list(COLUMNS)]
