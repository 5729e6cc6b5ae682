"""A ladder: trainings that each differ in one setting, on several seeds, evaluated on the same cases."""

from __future__ import annotations

import json
from collections.abc import Generator
from contextlib import closing
from pathlib import Path
from typing import Any, NamedTuple

import pandas as pd
from joblib import Parallel, delayed
from pydantic import Field, model_validator

from hydro_agents.controllers.base import Controller
from hydro_agents.controllers.registry import CONTROLLERS, make_controller
from hydro_agents.evaluation.metrics import rollout_metrics
from hydro_agents.evaluation.protocol import ProtocolSettings
from hydro_agents.learning.progress import validation_errors
from hydro_agents.learning.trainers import Trainer, trainer
from hydro_agents.report.training_plots import ERROR, learning_plots
from hydro_agents.running.cases import Cases, run_cases
from hydro_agents.running.console import ProgressDisplay
from hydro_agents.running.folders import output_folder
from hydro_agents.running.jobs import side_by_side
from hydro_agents.running.seeds import EVALUATION, LADDER, SEED_MARK
from hydro_agents.running.tasks import read_settings, read_task
from hydro_agents.study.ladder_table import ladder_table, rung_scores
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
    kind: str | None = Field(None, description="ppo, sac, or module:attribute for your own trainer")
    corrects: str | None = Field(None, description="name of the controller that it corrects")
    settings: dict[str, Any] = Field(default_factory=dict, description="of the training; override the earlier rung")


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
                guess = did_you_mean(rung.after, earlier)
                raise ValueError(f"rungs.{name}: after = '{rung.after}': must be a rung before it{guess}")
            if rung.kind is None and rung.after is None:
                raise ValueError(f"rungs.{name}: kind is missing")
            if rung.corrects is not None and rung.corrects not in self.controllers:
                raise ValueError(
                    f"rungs.{name}: corrects = '{rung.corrects}': {one_of(rung.corrects, self.controllers)}"
                )
            earlier.append(name)
        return self

    @classmethod
    def from_yaml(cls, path: str | Path) -> LadderSettings:
        """Read a ladder; the settings of a controller may be the path of a YAML file, relative to the ladder's file.

        The task may be such a path too, or a name in ``configs/tasks``.

        Raises:
            ConfigurationError: unreadable file, unknown key or impossible value.
        """
        values = read_yaml(path)
        errors: list[ConfigurationError] = []
        with kept(errors):
            if "task" in values:
                values["task"] = read_task(values.pop("task"), Path(path))
        with kept(errors):
            read_settings(values.get("controllers"), Path(path))
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
            raise ConfigurationError(
                f"rungs.{name}: is trained as a correction (residual: true): give 'corrects: NAME'"
            )
        return Resolved(made, kind, corrects if getattr(checked, "residual", True) else None, checked)

    def cases(self, test: bool) -> tuple[Cases, pd.DataFrame]:
        """The cases, and a table with level, family and plant of each; on validation plants or test plants."""
        return self.evaluation.cases(EVALUATION if test else LADDER)


class Resolved(NamedTuple):
    """The training of a rung."""

    trainer: Trainer
    kind: str
    corrects: str | None
    settings: Group


def run_ladder(
    ladder: LadderSettings,
    folder: Path,
    jobs: int = 1,
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
        jobs: number of jobs side by side.
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
    writes = [
        *TABLES,
        f"rungs/*/{CURVE_FILE}",
        *(f"rungs/*/*/{file}" for file in (*TRAINING_FILES, JOB_FILE, "scores_*.csv")),
    ]
    with output_folder(folder, "ladder", writes, resume=resume, overwrite=overwrite), ProgressDisplay() as display:
        display.update("ladder", 0, len(todo))
        classical = {name: judged(ladder, ladder.make(name), test) for name in ladder.controllers}
        scores: list[pd.DataFrame] = []
        errors: list[str] = []
        with closing(_results(ladder, folder, todo, jobs, test)) as results:
            for name, seed, result in results:
                if isinstance(result, str):
                    errors.append(f"rung {name}, seed {seed}: {result}")
                else:
                    scores.append(rung_scores(name, seed, ladder.resolved(name).corrects, result, classical))
                display.update("ladder", len(scores) + len(errors), len(todo), f"{name}, seed {seed}")
                write_tables(ladder, folder, classical, scores)
        for name in chosen:
            write_curve(ladder, folder, name)
    if errors:
        raise ConfigurationError("; ".join(errors))
    return folder / TABLES[0]


def write_curve(ladder: LadderSettings, folder: Path, rung: str) -> None:
    """Draw the error of a rung during training, relative to the first controller, with the band of its seeds."""
    own = folder / "rungs" / rung
    curves = [
        read_curve(file).assign(controller=f"{rung}{SEED_MARK}{file.name}") for file in sorted(own.glob("seed *"))
    ]
    curve = pd.concat(curves, ignore_index=True) if curves else pd.DataFrame()
    if ERROR in curve:  # the training has validations
        base = next(iter(ladder.controllers))
        error, _, _ = validation_errors(ladder.task, ladder.make(base))
        for plot in learning_plots(curve, base, error):
            write_whole(own / CURVE_FILE, plot.file)


def _results(
    ladder: LadderSettings, folder: Path, todo: list[tuple[str, int]], jobs: int, test: bool
) -> Generator[tuple[str, int, pd.DataFrame | str], None, None]:
    """Results of the jobs in the order of completion."""
    parallel = Parallel(n_jobs=jobs, return_as="generator_unordered")
    yield from side_by_side(parallel, [delayed(run_rung)(ladder, name, seed, folder, test) for name, seed in todo])


def run_rung(
    ladder: LadderSettings, name: str, seed: int, folder: Path, test: bool
) -> tuple[str, int, pd.DataFrame | str]:
    """Train one rung on one seed and evaluate it, or read the results of an earlier run.

    Returns:
        Name, seed, and a table of metrics with one row per case, or the reason for its absence.
    """
    own = folder / "rungs" / name / f"seed {seed}"
    own.mkdir(parents=True, exist_ok=True)
    try:
        controller, seconds = _trained(ladder, name, seed, own)
        file = own / f"scores_{'test' if test else 'validation'}.csv"
        if not file.exists():
            write_whole(file, judged(ladder, controller, test).to_csv(index=False).encode())
        return name, seed, pd.read_csv(file).assign(seconds=seconds)
    except ConfigurationError as error:
        return name, seed, str(error)


def _trained(ladder: LadderSettings, name: str, seed: int, own: Path) -> tuple[Controller, float]:
    """The controller of a job and the seconds of its training."""
    resolved = ladder.resolved(name)
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
        controller = resolved.trainer.train(
            ladder.task,
            resolved.settings,
            seed=seed,
            folder=own,
            resume=any(own.glob(CHECKPOINTS)),
            base=base,
            progress=None,
        )
        controller.save(weights)
    controller = resolved.trainer.load(weights)
    return controller, float(getattr(controller, "training", {}).get("seconds", float("nan")))


def judged(ladder: LadderSettings, controller: Controller, test: bool) -> pd.DataFrame:
    """Metrics of a controller, one row per case."""
    cases, table = ladder.cases(test)
    assert cases.families is not None
    preview = max(ladder.task.references.preview_times, default=0.0)
    rollout = run_cases(ladder.task, controller, cases)
    return table.assign(**rollout_metrics(rollout, cases.families, ladder.task.control_period, preview))


def write_tables(
    ladder: LadderSettings, folder: Path, classical: dict[str, pd.DataFrame], scores: list[pd.DataFrame]
) -> None:
    """Write the ladder as Markdown and CSV, and the scores of each seed."""
    reference = next(iter(classical))
    rows = [rung_scores(name, -1, None, frame, classical) for name, frame in classical.items()]
    all_scores = pd.concat([*rows, *scores], ignore_index=True)
    order = [*ladder.controllers, *ladder.rungs]
    text, table = ladder_table(all_scores, order, reference)
    write_whole(folder / TABLES[0], f"# {ladder.title}\n\n{text}".encode())
    write_whole(folder / TABLES[1], table.to_csv(index=False).encode())
    write_whole(folder / TABLES[2], all_scores.to_csv(index=False).encode())
