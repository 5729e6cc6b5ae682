"""A study with several training seeds: how far its figures depend on the luck of a training."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import redirect_stderr, redirect_stdout
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pandas as pd
from joblib import effective_n_jobs

from hydro_agents.evaluation.metrics import ERROR, METRICS
from hydro_agents.report.kit import drawn, picture
from hydro_agents.report.parts import BASE_ERROR, learning_axes
from hydro_agents.report.parts import ERROR as VALIDATION_ERROR
from hydro_agents.running.cases import validation_errors
from hydro_agents.running.console import ProgressDisplay, console_table
from hydro_agents.running.folders import output_folder
from hydro_agents.running.jobs import Columns, Job, run_jobs
from hydro_agents.running.seeds import SEED_MARK
from hydro_agents.running.statistics import seeds_interval
from hydro_agents.running.text import Table, number
from hydro_agents.study.results import Phases
from hydro_agents.study.run import HEAD_PHASE, TUNED_FILE, claimed, is_finished, run_study, try_out
from hydro_agents.study.settings import StudySettings
from hydro_agents.study.training import read_curve
from hydro_env import ConfigurationError
from hydro_env.files import write_whole

TABLE, CURVES, CURVE_FILE = "tables/over_seeds.csv", "tables/learning_curves.csv", "learning_curve.svg"
SEED = "seed"  # begins the names of the studies' folders and of the table's columns, as in ``seed 0``
JOB = "study --seeds"
FIRST_ERROR = "first_mean_error_mm"
"""Column of the learning curves: error of the first controller on the same validation plants."""

MAIN = ("all", "equal_weight", "training", "head")
"""Groups of figures that the console shows; the table holds all."""


class Figure(NamedTuple):
    """A figure of one study."""

    of: str  # what was trained, or a controller that was not
    group: str
    figure: str
    value: float


def run_over_seeds(
    study: StudySettings,
    folder: Path,
    seeds: range,
    resume: bool = False,
    overwrite: bool = False,
    command: str = "hydro study --seeds",
) -> Path:
    """Run a study once per training seed, each in its own folder, and collect the results in one table.

    The active ``parallel_config`` says how many run side by side; without one they run one after another.

    All runs use the same test plants; their results differ by the training alone.

    Args:
        study: the study.
        folder: for the studies (``seed 0``, ``seed 1``, …), the table and the learning curves.
        seeds: of the trainings.
        resume: keep the finished studies, and continue an interrupted one.
        overwrite: start again.
        command: the command line, for the reports.

    Returns:
        The file with the table: one row per figure, with its mean over the seeds, the 95 % interval of Student's t,
        and one column per seed.

    Raises:
        ConfigurationError: as :func:`~hydro_agents.study.run.run_study`; or a file is in the way.
        KeyboardInterrupt: Ctrl-C; the finished work remains.
    """
    waiting = [seed for seed in seeds if not (resume and is_finished(study, folder / f"{SEED} {seed}", seed))]
    if effective_n_jobs(None) > 1 and len(waiting) > 1:
        _run_side_by_side(study, folder, waiting, resume, overwrite, command)
    else:
        for seed in waiting:
            run_study(study, folder / f"{SEED} {seed}", seed, resume, overwrite, command)
    with (
        output_folder(folder, JOB, [TABLE, CURVES, CURVE_FILE], overwrite=True),
        ProgressDisplay() as display,
    ):
        table, curves = over_seeds(study, folder, seeds), learning_curves(study, folder, seeds)
        write_whole(folder / TABLE, table.to_csv(index=False).encode())
        if not curves.empty:
            write_whole(folder / CURVES, curves.to_csv(index=False).encode())
            first = next(iter(study.controllers))
            write_whole(folder / CURVE_FILE, learning_picture(relative(curves), first))
        display.console.lines(console_table(_summary(table, len(seeds)), left=(0, 1)))
    return folder / TABLE


def _run_side_by_side(
    study: StudySettings, folder: Path, seeds: Sequence[int], resume: bool, overwrite: bool, command: str
) -> None:
    """Run each study as a job; what it prints goes to ``seed 0.log``, …"""
    study.check()
    folder = folder.absolute()
    logs = output_folder(folder, f"{JOB} --jobs", [f"{SEED} *.log"], resume=True)
    with logs, ProgressDisplay() as display:
        for seed in seeds:
            with claimed(study, folder / f"{SEED} {seed}", resume, overwrite):
                pass  # refuses results of an earlier run, or removes them; the job then goes on if its worker is killed
        try_out(study)
        display.say(f"{len(seeds)} studies side by side; {folder / SEED} *.log tells how far each is")
        jobs = {f"{SEED} {seed}": Job(one_study, None, (study, str(folder), seed, command)) for seed in seeds}
        results, _ = run_jobs(jobs, None, None, lambda _, *done: display.update("studies", *done), at_once=True)
    errors = [f"{key}: {result.error}" for key, result in results.items() if result.error]
    if errors:
        raise ConfigurationError("; ".join(errors))
    for seed in seeds:
        if not is_finished(study, folder / f"{SEED} {seed}", seed):
            raise ConfigurationError(f"{folder / SEED} {seed}: the worker wrote elsewhere; all need a common disk")


def one_study(_: None, study: StudySettings, folder: str, seed: int, command: str) -> Columns:
    """Run or resume the study of one seed; its results are files in its own folder.

    Raises:
        ConfigurationError: as :func:`~hydro_agents.study.run.run_study`.
    """
    own = Path(folder) / f"{SEED} {seed}"
    own.parent.mkdir(parents=True, exist_ok=True)
    with open(f"{own}.log", "a", encoding="utf-8") as log, redirect_stdout(log), redirect_stderr(log):
        run_study(study, own, seed, True, False, command)  # a job whose worker was killed goes on
    return {}


def over_seeds(study: StudySettings, folder: Path, seeds: range) -> pd.DataFrame:
    """Figures of the controllers and the head: ``mean`` with interval ``low``, ``high``, ``sd``, a column per seed."""
    keys = list(Figure._fields[:3])
    columns = []
    for seed in seeds:
        found = pd.DataFrame(_figures(study, folder / f"{SEED} {seed}"), columns=Figure._fields)
        columns.append(found.set_index(keys)["value"].rename(f"{SEED} {seed}"))
    table = pd.concat(columns, axis=1)
    intervals = [seeds_interval(row)._asdict() for row in table.to_numpy(dtype=np.float64)]
    spread = pd.DataFrame(intervals, index=table.index).rename(columns={"value": "mean"})
    shares = table.index.get_level_values("figure").str.endswith("%")
    spread[shares] = spread[shares].clip(0.0, 100.0)
    return pd.concat([spread, table.std(axis=1, ddof=1).rename("sd"), table], axis=1).reset_index()


def learning_curves(study: StudySettings, folder: Path, seeds: range) -> pd.DataFrame:
    """Errors on validation plants (mm) while the controllers learn; ``controller`` is NAME#SEED. Empty without any."""
    first = next(iter(study.controllers))
    parts = []
    for seed in seeds:
        own = folder / f"{SEED} {seed}"
        acting = StudySettings.from_yaml(own / TUNED_FILE).make(first) if first in study.tuned else study.make(first)
        first_error = validation_errors(study.task, acting)[0]
        for name in study.trained:
            curve = read_curve(own / "controllers" / name).rename(columns={"time/total_timesteps": "steps"})
            if VALIDATION_ERROR in curve:
                kept = curve[[column for column in ("steps", VALIDATION_ERROR, BASE_ERROR) if column in curve]]
                kept = kept.assign(controller=f"{name}{SEED_MARK}{seed}", **{FIRST_ERROR: first_error})
                parts.append(kept.dropna(subset=[VALIDATION_ERROR]))
    return pd.concat(parts, ignore_index=True) if parts else pd.DataFrame()


def relative(curves: pd.DataFrame) -> pd.DataFrame:
    """Learning curves in parts of the first controller's error."""
    errors = [name for name in (VALIDATION_ERROR, BASE_ERROR) if name in curves]
    return curves.assign(**{name: curves[name] / curves[FIRST_ERROR] for name in errors})


@drawn
def learning_picture(curves: pd.DataFrame, first: str) -> bytes:
    """The curves of :func:`relative` as an SVG file."""
    return picture(learning_axes(curves, first, 1.0), "svg")


def _figures(study: StudySettings, folder: Path) -> Iterator[Figure]:
    """The figures of one study: of every controller relative to the first, of every training, and of the head."""
    seconds = Phases(folder).seconds
    ratios, cases = (pd.read_csv(folder / "tables" / f"{name}.csv") for name in ("ratios", "cases"))
    first, *others = study.controllers
    of_controller = {str(name): own.reset_index(drop=True) for name, own in cases.groupby("controller", sort=False)}
    for name in others:
        yield from _ratios(name, first, study.controllers[name].corrects, ratios)
        yield from _costs(name, first, of_controller[name], of_controller[first])
    for name in study.trained:
        settings = study.training_settings(name)
        updates = getattr(settings, "updates", None)
        if updates is not None:
            yield Figure(name, "training", "gradient steps", float(updates(getattr(settings, "total_steps", 0))))
        yield Figure(name, "training", "training, s", seconds[f"train {name}"])
    if study.leakage_head is not None:
        for figure, value in _of_head(folder / "tables", first):
            yield Figure(f"leakage head, under {first}", "head", figure, value)
        yield Figure(f"leakage head, under {first}", "head", "training, s", seconds[HEAD_PHASE])


def _ratios(name: str, first: str, corrected: str | None, ratios: pd.DataFrame) -> Iterator[Figure]:
    """Mean error of a controller over that of the first: over all cases, by leak and family; and over the corrected."""
    corrects = ratios[ratios["controller"] == corrected].set_index("group")["ratio"]
    for row in ratios[ratios["controller"] == name].to_dict("records"):
        group, ratio = str(row["group"]), float(row["ratio"])
        words = {
            "equal_weight": "mean error, kinds of reference weigh the same",
            "level": f"mean error, leak of {row['value']} l/min",
            "family": f"mean error, {row['value']}",
        }.get(group, "mean error")
        yield Figure(name, group, f"{words} ÷ {first}'s", ratio)
        if group in ("all", "equal_weight") and group in corrects:
            yield Figure(name, group, f"{words} ÷ that of {corrected}", ratio / float(corrects[group]))


def _costs(name: str, first: str, own: pd.DataFrame, base: pd.DataFrame) -> Iterator[Figure]:
    """The worst case of a controller, what its errors cost relative to the first, and its failures."""
    yield Figure(name, "worst", f"largest ratio of a case, error ÷ {first}'s", float((own[ERROR] / base[ERROR]).max()))
    for metric in METRICS.values():
        there = base[metric.name].mean() if metric.ratio else 0.0
        if there > 0.0:
            yield Figure(
                name, metric.name, f"{metric.word.lower()} ÷ {first}'s", float(own[metric.name].mean() / there)
            )
    yield Figure(name, "failed", "failed cases", float(own["failed"].sum()))


def _of_head(tables: Path, first: str) -> Iterator[tuple[str, float]]:
    """Figures of the leakage head under the first controller."""
    summary = pd.read_csv(tables / "detection_summary.csv").iloc[0]
    rates = pd.read_csv(tables / "detection_rates.csv")
    for row in rates[(rates["controller"] == first) & (rates["group"] == "range")].to_dict("records"):
        yield f"leaks of {row['value']} l/min flagged, %", 100.0 * row["flagged_share"]
    yield "false alarms, %", 100.0 * summary["false_alarm_rate"]
    yield "area under the ROC curve", summary["auroc"]
    yield "size of the leak, median error as a factor", summary["median_size_error_factor"]


def _summary(table: pd.DataFrame, count: int) -> Table:
    """Mean and interval of the main figures."""
    rows = []
    for row in table[table["group"].isin(MAIN)].to_dict("records"):
        mean, low, high = (number(row[name], digits=4) for name in ("mean", "low", "high"))
        rows.append((row["of"], row["figure"], f"{mean} [{low}, {high}]"))
    return Table(f"Over {count} training seeds", ("of", "figure", "mean [95 %, Student's t]"), rows)
