"""The Cramér–Rao bound of the leak: of the windows of a protocol, and of many motions and sensors."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path

import numpy as np
import pandas as pd

from hydro_agents.controllers.base import Controller
from hydro_agents.detection.operations import ACTING
from hydro_agents.evaluation.conditions import Cell, columns_of
from hydro_agents.evaluation.leak_protocol import LeakProtocol
from hydro_agents.running.cases import Cases
from hydro_agents.running.jobs import Columns, Job, Report, fingerprint, run_jobs
from hydro_agents.running.seeds import EVALUATION
from hydro_agents.running.text import frame_markdown, number, setting
from hydro_env import ConfigurationError, TaskConfig
from hydro_env.task.configuration import LEAKAGE_LIMIT
from hydro_env.task.sensors import SENSORS
from hydro_rig.estimation.information import TASK, information, sigma, unknown_sets
from hydro_rig.estimation.known_windows import MOTIONS, known_windows, leak_cases
from hydro_rig.estimation.unknowns import priors_of

ALL_SENSORS = "all sensors"
BEGIN = 1.0  # s after the start of the episode: start of the windows of the survey

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


def survey(
    config: TaskConfig,
    controller: Controller,
    leaks: Sequence[float],
    windows: Sequence[float],
    plants: int,
    folder: Path | None = None,
    progress: Report | None = None,
) -> pd.DataFrame:
    """The bound of every plant, one row per number, with the columns :data:`COLUMNS`.

    Args:
        config: the task.
        controller: moves the axes.
        leaks: l/min at 100 bar.
        windows: lengths, s.
        plants: number of plants of the test seeds, per motion and leak.
        folder: for the results of the jobs, one per motion and leak; ``None`` keeps none.
        progress: called when a job finishes.

    Raises:
        ConfigurationError: a leak or a window is impossible, or a job failed.
    """
    for name, values, low, high, unit in (
        ("leak", leaks, 0.0, LEAKAGE_LIMIT, "l/min"),
        ("window", windows, 2.0 * config.control_period, 60.0, "s"),
    ):
        for value in values:
            if not low <= value <= high:
                raise ConfigurationError(f"--{name} {value:g}: must be within {low:g} to {high:g} {unit}")
    digest, lengths = fingerprint(controller), tuple(dict.fromkeys(windows))
    jobs = {
        f"{motion}|{leak:g}": Job(surveyed, controller, (config, lengths, plants, motion, leak), digest)
        for motion in MOTIONS
        for leak in dict.fromkeys(leaks)
    }
    results = run_jobs(jobs, folder, None, progress)[0]
    for key in jobs:
        if results[key].error:
            raise ConfigurationError(results[key].error)
    return pd.concat([pd.DataFrame(results[key].metrics) for key in jobs], ignore_index=True)


def surveyed(
    controller: Controller, config: TaskConfig, lengths: tuple[float, ...], plants: int, motion: str, leak: float
) -> Columns:
    """The rows of one motion and leak: each set of unknowns with all sensors, each choice of sensors with the task's.

    Raises:
        ConfigurationError: an episode cannot begin.
    """
    sets, choices, task = unknown_sets(config), sensor_choices(config), MOTIONS[motion](config)
    cases = leak_cases(EVALUATION.take(plants), plants, leak)
    windows = known_windows(task, controller, cases, BEGIN, max(lengths))
    known = information(task, windows, priors_of(config), lengths, threads=1)
    pairs = [(name, ALL_SENSORS) for name in sets] + [(TASK, name) for name in choices if name != ALL_SENSORS]
    frames = []
    for name, sensors in pairs:
        values = sigma(known, unknowns=sets[name], sensors=choices[sensors])
        frames += [
            pd.DataFrame({"seed": cases.seeds[windows.case], "window_s": length, "sigma_lpm": values[:, place]}).assign(
                motion=motion, leakage_flow_lpm=leak, unknowns=name, sensors=sensors
            )
            for place, length in enumerate(known.lengths)
        ]
    return columns_of(pd.concat(frames, ignore_index=True)[list(COLUMNS)])


def tables(table: pd.DataFrame) -> dict[str, pd.DataFrame]:
    """Medians over the plants by title, as text; l/min at 100 bar. Where one is fixed: about 2 s and 0.3 l/min."""
    ordinary = next(iter(MOTIONS))
    length, leak = _nearest(table["window_s"], 2.0), _nearest(table["leakage_flow_lpm"], 0.3)
    whole, drawn = table["sensors"] == ALL_SENSORS, table["unknowns"] == TASK
    window, level, usual = table["window_s"] == length, table["leakage_flow_lpm"] == leak, table["motion"] == ordinary
    seconds, given = f"window of {length:g} s", f"unknown: {TASK}"
    return {
        f"By leak and unknowns ({ordinary}, {seconds})": _pivot(
            table[usual & whole & window], "leakage_flow_lpm", "unknowns", "leak, l/min"
        ),
        f"By length of the window and unknowns ({ordinary}, leak of {leak:g} l/min)": _pivot(
            table[usual & whole & level], "window_s", "unknowns", "window, s"
        ),
        f"By sensors and leak ({ordinary}, {seconds}; {given})": _pivot(
            table[usual & drawn & window], "sensors", "leakage_flow_lpm", "sensors"
        ),
        f"By motion and leak: median, and 10 to 90 % of the plants ({seconds}; {given})": _pivot(
            table[whole & drawn & window], "leakage_flow_lpm", "motion", "leak, l/min", spread=True
        ),
    }


def _nearest(values: Iterable[float], wanted: float) -> float:
    """The value with the ratio to ``wanted`` closest to 1."""
    return min(values, key=lambda value: abs(np.log(max(value, 1e-9) / wanted)))


def _pivot(rows: pd.DataFrame, index: str, columns: str, name: str, spread: bool = False) -> pd.DataFrame:
    """Medians, and with ``spread`` the range of most plants, by two columns."""

    def cell(values: pd.Series[float]) -> str:
        low, median, high = (number(float(value), digits=2) for value in np.quantile(values, [0.1, 0.5, 0.9]))
        return f"{median} ({low} to {high})" if spread else median

    def words(value: object) -> str:
        return setting(value) if isinstance(value, float) else str(value)

    return (
        rows.pivot_table("sigma_lpm", index, columns, aggfunc=cell, sort=False)
        .rename(index=words, columns=words)
        .rename_axis(index=name, columns=None)
    )


def bound_markdown(table: pd.DataFrame) -> str:
    """All tables of :func:`tables` as Markdown."""
    return "\n\n".join(f"{title}:\n\n{frame_markdown(part)}" for title, part in tables(table).items())
