"""A ladder: trainings that each differ in one setting, on several seeds, evaluated on the same cases."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from pydantic import Field, model_validator

from hydro_agents.controllers.base import Controller
from hydro_agents.controllers.registry import CONTROLLERS, make_controller
from hydro_agents.evaluation.evaluate import ProtocolSettings, StudyProtocol
from hydro_agents.evaluation.metrics import ERROR, METRICS
from hydro_agents.evaluation.participants import Participants, split_name
from hydro_agents.evaluation.robustness_protocol import PairedCondition
from hydro_agents.evaluation.runner import Results, run
from hydro_agents.learning.trainers import Trainer, trainer
from hydro_agents.report.training_plots import ERROR as VALIDATION_ERROR
from hydro_agents.report.training_plots import learning_plots
from hydro_agents.running.cases import validation_errors
from hydro_agents.running.console import ProgressDisplay
from hydro_agents.running.folders import output_folder
from hydro_agents.running.jobs import JOBS_FOLDER, Columns, Job, run_jobs
from hydro_agents.running.seeds import SEED_MARK
from hydro_agents.running.tasks import read_settings, read_task
from hydro_agents.running.text import markdown
from hydro_agents.study.settings import ControllerEntry, Name
from hydro_agents.study.training import CHECKPOINTS, TRAINING_FILES, WEIGHTS, read_curve
from hydro_env import ConfigurationError, TaskConfig
from hydro_env.files import Group, read_json, read_yaml, validate, write_whole
from hydro_env.mistakes import did_you_mean, kept, one_of, refuse, unknown
from hydro_env.task.rig import merged

JOB_FILE = "job.json"
TABLES = ("ladder.md", "ladder.csv", "scores.csv")
CURVE_FILE = "learning_curve.svg"


class Rung(Group):
    """One training with its settings."""

    after: str | None = Field(None, description="an earlier rung; its kind, corrected controller and settings apply")
    kind: str | None = Field(None, description="ppo, sac, tqc, recurrent_ppo, or module:attribute for your own trainer")
    corrects: str | None = Field(None, description="name of the controller that it corrects")
    settings: dict[str, Any] = Field(default_factory=dict, description="or a YAML file; override the earlier rung")


class LadderSettings(Group):
    """A ladder; ``configs/ladders`` holds examples."""

    title: str = "Ladder of trainings"
    task: TaskConfig = Field(default_factory=TaskConfig)
    controllers: dict[Name, ControllerEntry] = Field(
        min_length=1, description="classical controllers by name; errors are compared with the first one's"
    )
    seeds: int = Field(5, ge=1, le=1000, description="trainings of each rung")
    settings: dict[str, Any] = Field(default_factory=dict, description="of every training")
    rungs: dict[Name, Rung] = Field(min_length=1)
    evaluation: ProtocolSettings = Field(default_factory=lambda: ProtocolSettings(plants=8))

    @model_validator(mode="after")
    def _known(self) -> LadderSettings:
        earlier: list[str] = []
        for name, entry in self.controllers.items():
            if entry.kind not in CONTROLLERS:
                raise ValueError(f"controllers.{name}: kind = '{entry.kind}': {one_of(entry.kind, CONTROLLERS)}")
        for name, rung in self.rungs.items():
            if name in self.controllers:
                raise ValueError(f"rungs.{name}: is the name of a controller")
            if rung.after is not None and rung.after not in earlier:
                must = f"must be a rung before it{did_you_mean(rung.after, earlier)}"
                raise ValueError(f"rungs.{name}: after = '{rung.after}': {must}")
            if rung.kind is None and rung.after is None:
                raise ValueError(f"rungs.{name}: kind is missing")
            if rung.corrects is not None and rung.corrects not in self.controllers:
                must = one_of(rung.corrects, self.controllers)
                raise ValueError(f"rungs.{name}: corrects = '{rung.corrects}': {must}")
            earlier.append(name)
        return self

    @classmethod
    def from_yaml(cls, path: str | Path) -> LadderSettings:
        """Read a ladder; settings of a controller or rung may be the path of a YAML file, relative to the ladder's.

        The task may be such a path too, or a name in ``configs/tasks``.

        Raises:
            ConfigurationError: unreadable file, unknown key or impossible value.
        """
        values = read_yaml(path)
        errors: list[ConfigurationError] = []
        if "task" in values:
            with kept(errors):
                values["task"] = read_task(values.pop("task"), Path(path))
        for part in ("controllers", "rungs"):
            with kept(errors):
                read_settings(values.get(part), Path(path))
        with kept(errors):
            ladder = validate(cls, values, str(path))
        refuse(errors, str(path))
        for check, names in ((ladder.make, ladder.controllers), (ladder.resolved, ladder.rungs)):
            for name in names:
                with kept(errors):
                    check(name)
        refuse(errors, str(path))
        return ladder

    def make(self, name: str) -> Controller:
        """A classical controller of the ladder."""
        entry = self.controllers[name]
        return make_controller(entry.kind, self.task, entry.settings)

    def resolved(self, name: str) -> Resolved:
        """The training of a rung, with the settings of earlier rungs.

        Raises:
            ConfigurationError: its trainer is unknown, or the settings do not fit it.
        """
        chain = [self.rungs[name]]
        while chain[0].after is not None:
            chain.insert(0, self.rungs[chain[0].after])
        settings: dict[str, Any] = self.settings
        for rung in chain:
            settings = merged(settings, rung.settings)
        kind = next(rung.kind for rung in reversed(chain) if rung.kind is not None)
        corrects = next((rung.corrects for rung in reversed(chain) if rung.corrects is not None), None)
        made = trainer(kind)
        checked = validate(made.settings, settings, f"rungs.{name}")
        if getattr(checked, "residual", False) and corrects is None:
            is_correction = "is trained as a correction (residual: true)"
            raise ConfigurationError(f"rungs.{name}: {is_correction}: give 'corrects: NAME'")
        return Resolved(made, kind, corrects if getattr(checked, "residual", True) else None, checked)

    @staticmethod
    def folder(of: Path, name: str, seed: int) -> Path:
        """The folder of a training in that of the ladder."""
        return of / "rungs" / name / f"seed {seed}"

    def protocol(self, test: bool) -> StudyProtocol:
        """The evaluation of every rung, on validation plants or on test plants."""
        sizes, seeds = self.evaluation.model_dump(), "EVALUATION" if test else "LADDER"
        conditions = {"task": PairedCondition()}
        return StudyProtocol(task=self.task, parts=("tracking",), seeds=seeds, conditions=conditions, **sizes)


class Resolved(NamedTuple):
    """The training of a rung."""

    trainer: Trainer
    kind: str
    corrects: str | None
    settings: Group


def run_ladder(
    ladder: LadderSettings,
    folder: Path,
    rungs: list[str] | None = None,
    seeds: int | None = None,
    test: bool = False,
    resume: bool = False,
    overwrite: bool = False,
) -> Path:
    """Train and evaluate every rung on every seed as independent jobs; write the tables of all finished jobs.

    Args:
        ladder: the ladder.
        folder: for the results; each job has its own subfolder.
        rungs: names of the rungs to train; default: all.
        seeds: number of seeds, instead of the ladder's.
        test: evaluate on test plants instead of validation plants; only after all choices are made.
        resume: continue the results in the folder.
        overwrite: replace them.

    Returns:
        The file with the table.

    Raises:
        ConfigurationError: a rung is unknown, the folder is in use, its results have other settings, or a training
            failed; the results of the others are kept.
    """
    chosen = rungs or list(ladder.rungs)
    for name in chosen:
        if name not in ladder.rungs:
            raise ConfigurationError(f"rung '{name}': {unknown(name, ladder.rungs)}")
    todo = [(name, seed) for seed in range(seeds or ladder.seeds) for name in chosen]
    writes = [*TABLES, f"{JOBS_FOLDER}/*.npz", f"rungs/*/{CURVE_FILE}"]
    writes += [f"rungs/*/*/{file}" for file in (*TRAINING_FILES, JOB_FILE)]
    with output_folder(folder, "ladder", writes, resume=resume, overwrite=overwrite), ProgressDisplay() as display:
        names = {f"{name}{SEED_MARK}{seed}": (name, seed) for name, seed in todo}
        trainings = {key: Job(train_rung, None, (ladder, *names[key], str(folder.absolute()))) for key in names}
        answers, _ = run_jobs(trainings, None, None, lambda _, *done: display.update("training", *done), at_once=True)
        failed = {key: answer.error for key, answer in answers.items() if answer.error}
        errors = [f"rung {names[key][0]}, seed {names[key][1]}: {error}" for key, error in failed.items()]
        controllers = {name: ladder.make(name) for name in ladder.controllers}
        for key, (name, seed) in names.items():
            if key not in failed:
                controllers[key] = ladder.resolved(name).trainer.load(ladder.folder(folder, name, seed) / WEIGHTS)
        who = Participants(controllers)
        results = run(ladder.protocol(test), who, folder, None, lambda _, *done: display.update("evaluation", *done))
        write_tables(ladder, folder, results)
        for name in chosen:
            write_curve(ladder, folder, name)
    if errors := [*errors, *results.errors]:
        raise ConfigurationError("; ".join(errors))
    return folder / TABLES[0]


def write_curve(ladder: LadderSettings, folder: Path, rung: str) -> None:
    """Draw the error of a rung during training, relative to the first controller, with the band of its seeds."""
    own = folder / "rungs" / rung
    files = sorted(own.glob("seed *"))
    curves = [read_curve(file).assign(controller=f"{rung}{SEED_MARK}{file.name}") for file in files]
    curve = pd.concat(curves, ignore_index=True) if curves else pd.DataFrame()
    if VALIDATION_ERROR in curve:  # the training has validations
        base = next(iter(ladder.controllers))
        error, _, _ = validation_errors(ladder.task, ladder.make(base))
        for plot in learning_plots(curve, base, error):
            write_whole(own / CURVE_FILE, plot.file)


def train_rung(_: None, ladder: LadderSettings, name: str, seed: int, folder: str) -> Columns:
    """Train one rung on one seed, unless its weights are there; its results are files in its own folder.

    Raises:
        ConfigurationError: the settings do not fit, or the folder holds a training with others.
    """
    own, resolved = ladder.folder(Path(folder), name, seed), ladder.resolved(name)
    own.mkdir(parents=True, exist_ok=True)
    described = {
        "kind": resolved.kind,
        "settings": resolved.settings.model_dump(mode="json"),
        "corrects": ladder.controllers[resolved.corrects].model_dump(mode="json") if resolved.corrects else None,
        "task": ladder.task.model_dump(mode="json"),
        "seed": seed,
    }
    job, weights = own / JOB_FILE, own / WEIGHTS
    if job.exists():
        before = read_json(job)
        changed = next((key for key, value in described.items() if before.get(key) != value), None)
        if changed is not None:
            raise ConfigurationError(f"{job}: was made with another '{changed}'; --overwrite begins anew")
    else:
        write_whole(job, (json.dumps(described, indent=2) + "\n").encode())
    if not weights.with_suffix(".json").exists():
        base = ladder.make(resolved.corrects) if resolved.corrects is not None else None
        resume = any(own.glob(CHECKPOINTS))
        controller = resolved.trainer.train(
            ladder.task, resolved.settings, seed=seed, folder=own, resume=resume, base=base, progress=None
        )
        controller.save(weights)
    return {}


def write_tables(ladder: LadderSettings, folder: Path, results: Results) -> None:
    """Write the ladder as Markdown and CSV, and the scores of each seed."""
    cases = dict(iter(results.part("tracking").groupby(["controller", "training_seed"], sort=False)))
    classical = {name: cases[name, 0] for name in ladder.controllers}
    rows = [rung_scores(name, -1, None, own, classical) for name, own in classical.items()]
    for key, controller in results.participants.controllers.items():
        name, seed = split_name(key)
        if name in ladder.rungs and (name, seed) in cases:
            resolved, record = ladder.resolved(name), getattr(controller, "training", {})
            updates = getattr(resolved.settings, "updates", lambda _: math.nan)(record.get("steps", 0))
            own = cases[name, seed].assign(seconds=record.get("seconds", math.nan), updates=updates)
            rows.append(rung_scores(name, seed, resolved.corrects, own, classical))
    scores = pd.concat(rows, ignore_index=True)
    text, table = ladder_table(scores, [*ladder.controllers, *ladder.rungs], next(iter(classical)))
    write_whole(folder / TABLES[0], f"# {ladder.title}\n\n{text}".encode())
    write_whole(folder / TABLES[1], table.to_csv(index=False).encode())
    write_whole(folder / TABLES[2], scores.to_csv(index=False).encode())


def rung_scores(
    name: str, seed: int, corrects: str | None, cases: pd.DataFrame, classical: Mapping[str, pd.DataFrame]
) -> pd.DataFrame:
    """One row: a training's figures as ratios to the first controller's on the same cases.

    Args:
        name: name of the rung.
        seed: seed of the training; −1 for a controller that is not trained.
        corrects: name of the controller that it corrects.
        cases: its metrics, one row per case; updates and seconds of its training.
        classical: the metrics of the classical controllers, by name.
    """
    reference = next(iter(classical.values()))
    row: dict[str, float | str] = {"rung": name, "seed": seed}
    row["mean"], row["geo"] = ratios(cases, reference)
    corrected = ratios(cases, classical[corrects]) if corrects is not None else (math.nan, math.nan)
    row["mean to corrected"], row["geo to corrected"] = corrected
    for group, label in (("family", "{}"), ("leakage_flow_lpm", "{:g} l/min")):
        for value, errors in cases.groupby(group, sort=False)[ERROR]:
            row[label.format(value)] = errors.mean() / reference.loc[reference[group] == value, ERROR].mean()
    row["worst case"] = float(np.max(cases[ERROR].to_numpy() / reference[ERROR].to_numpy()))
    for metric in METRICS.values():
        if metric.ratio and metric.name in cases and metric.name in reference:
            there = float(reference[metric.name].mean())
            row[metric.ratio] = float(cases[metric.name].mean()) / there if there > 0.0 else math.nan
    row["failed"] = cases["failed"].sum()
    for column, figure in (("updates", "gradient steps"), ("seconds", "seconds")):
        row[figure] = float(cases[column].iloc[0]) if column in cases else math.nan
    return pd.DataFrame([row])


def ratios(cases: pd.DataFrame, reference: pd.DataFrame) -> tuple[float, float]:
    """Ratio of the mean errors over all cases, and the geometric mean of the families' ratios."""
    families = cases.groupby("family")[ERROR].mean() / reference.groupby("family")[ERROR].mean()
    return float(cases[ERROR].mean() / reference[ERROR].mean()), float(np.exp(np.log(families).mean()))


def ladder_table(scores: pd.DataFrame, order: Sequence[str], reference: str) -> tuple[str, pd.DataFrame]:
    """The ladder as Markdown, and as a table of means and standard deviations over seeds.

    Args:
        scores: rows of :func:`rung_scores`.
        order: names of the rungs from top to bottom; those without scores are left out.
        reference: name of the controller for all comparisons.
    """
    figures = [name for name in scores.columns if name not in ("rung", "seed")]
    rows, lines = [], []
    for name in order:
        own = scores[scores["rung"] == name]
        if own.empty:
            continue
        means, spread = own[figures].mean(), own[figures].std(ddof=1)
        seeds = int((own["seed"] >= 0).sum())
        rows.append({"rung": name, "seeds": seeds, **means, **spread.add_suffix(" sd")})
        lines.append([name, str(seeds or "–"), *(_cell(means[figure], spread[figure], figure) for figure in figures)])
    costs = ", ".join(metric.word.lower() for metric in METRICS.values() if metric.cost and metric.ratio)
    note = (
        f"Ratios to {reference} on the same cases: mean error over all cases; geo, the geometric mean of the families' "
        "ratios; then each family and each leak. Worst case: largest ratio of a single case. Offset at standstill, "
        f"{costs}: ratios of means. ±: standard deviation over training seeds.\n\n"
    )
    return f"{note}{markdown(['rung', 'seeds', *figures], lines)}\n", pd.DataFrame(rows)


def _cell(mean: float, spread: float, figure: str) -> str:
    if np.isnan(mean):
        return "–"
    if figure in ("gradient steps", "seconds", "failed"):
        return f"{mean:.1f}" if figure == "failed" and mean != round(mean) else f"{mean:.0f}"
    return f"{mean:.2f}" if np.isnan(spread) or figure not in ("mean", "geo") else f"{mean:.3f} ± {spread:.3f}"
