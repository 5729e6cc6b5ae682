"""What the commands ``train``, ``evaluate`` and ``study`` do, with progress on the console."""

from __future__ import annotations

from pathlib import Path

import pandas as pd
from rich.table import Table

from agents.controllers.base import Controller, ObservationLayout
from agents.controllers.pid import PID, PIDGains
from agents.evaluation.protocol import Evaluation, evaluate
from agents.leakage.head import LeakageHead
from agents.leakage.training import train_head
from agents.learning.policy import PolicyController
from agents.learning.training import train_ppo
from agents.learning.tuning import tune_pid
from agents.report.report import StudyRecord, write_report, write_tables
from agents.running.console import ProgressDisplay
from agents.running.folders import prepare_folder, pretrained_folder
from agents.study.run import (
    CONFIG_FILE,
    CURVE_FILE,
    HEAD_FILE,
    POLICY_FILE,
    REPORT_FILE,
    StudySettings,
    example_traces,
    head_progress,
    machine_description,
    package_versions,
    ppo_progress,
    run_study,
    stored_curve,
    write_curve,
)
from hydro_env import ConfigurationError, TaskConfig
from hydro_env.files import write_yaml

EVALUATION_FILE = "evaluation.yaml"


def check_layout(controller_layout: ObservationLayout, config: TaskConfig, what: str) -> None:
    """Weights fit a task only if its observations are those they were trained on.

    Raises:
        ConfigurationError: names, scales or control period differ.
    """
    if controller_layout != ObservationLayout.of(config):
        raise ConfigurationError(
            f"{what}: was trained on other observations (names, scales or control period) than this task gives"
        )


def load_policy(path: Path | None, config: TaskConfig) -> PolicyController:
    """Weights of a policy, the shipped ones by default, checked against the task."""
    path = path or pretrained_folder() / POLICY_FILE
    policy = PolicyController.load(path)
    check_layout(policy.features.layout, config, str(path))
    return policy


def load_head(path: Path | None, config: TaskConfig) -> LeakageHead:
    """Weights of a leakage head, the shipped ones by default, checked against the task."""
    path = path or pretrained_folder() / HEAD_FILE
    head = LeakageHead.load(path)
    check_layout(head.settings.layout, config, str(path))
    if head.settings.window != config.steps:
        raise ConfigurationError(f"{path}: reads {head.settings.window} observations, an episode has {config.steps}")
    return head


def _prepare_training(folder: Path, checkpoint: str, weights: str, resume: bool, overwrite: bool) -> None:
    """Check that a training may go into a folder, or go on from the checkpoint there.

    Raises:
        ConfigurationError: nothing to resume, results that would be replaced unasked, or a study's folder.
    """
    if resume and not (folder / checkpoint).exists():
        raise ConfigurationError(f"{folder}: nothing to resume, there is no {checkpoint}; leave --resume out")
    prepare_folder(folder, resume, overwrite, checkpoint, f"{weights}.json", CONFIG_FILE, can_resume=True)
    if (folder / CONFIG_FILE).exists():
        raise ConfigurationError(f"{folder}: holds a study, whose {weights} this would replace; take another --output")


def train_policy(
    settings: StudySettings, folder: Path, seed: int, resume: bool, overwrite: bool, steps: int | None
) -> Path:
    """Train PPO; weights, checkpoint and training curve go into the folder."""
    _prepare_training(folder, "checkpoint.json", POLICY_FILE, resume, overwrite)
    ppo = settings.ppo if steps is None else settings.ppo.model_copy(update={"total_steps": steps})
    rows = stored_curve(folder / CURVE_FILE) if resume else []
    with ProgressDisplay() as display:
        try:
            policy = train_ppo(
                settings.task,
                ppo,
                settings.base_pid or settings.pid,
                seed,
                folder,
                resume=resume,
                progress=ppo_progress(display, rows),
            )
        finally:
            write_curve(folder / CURVE_FILE, rows)
    return policy.save(folder / POLICY_FILE)


def train_leakage_head(
    settings: StudySettings, folder: Path, seed: int, resume: bool, overwrite: bool, policy: Path | None
) -> Path:
    """Train the leakage head on data of the PID and of a policy."""
    _prepare_training(folder, "head_checkpoint.json", HEAD_FILE, resume, overwrite)
    pid = PID(settings.pid, ObservationLayout.of(settings.task))
    controllers: list[Controller] = [pid, load_policy(policy, settings.task)]
    with ProgressDisplay() as display:
        head = train_head(
            settings.task,
            controllers,
            settings.leakage_head,
            seed,
            head_progress(display),
            folder=folder,
            resume=resume,
        )
    return head.save(folder / HEAD_FILE)


def tune_gains(settings: StudySettings, folder: Path, seed: int, overwrite: bool) -> Path:
    """Find the gains of the PID by an optimiser."""
    path = folder / "pid.yaml"
    prepare_folder(folder, False, overwrite, path.name)
    generations = 80
    with ProgressDisplay() as display:

        def report(generation: int, cost: float, gains: PIDGains) -> None:
            note = f"mean cost {cost:.5f}, proportional {gains.proportional:.4g} 1/m"
            display.update("tune PID", min(generation, generations), generations, note)

        gains, _ = tune_pid(settings.task, generations=generations, seed=seed, progress=report)
    gains.to_yaml(path)
    return path


def evaluate_to_folder(
    settings: StudySettings, folder: Path, policy: Path | None, head: Path | None, overwrite: bool, command: str
) -> None:
    """Evaluate PID, policy and head; tables and report go into the folder, the main figures to the console."""
    controllers: dict[str, Controller] = {
        "PID": PID(settings.pid, ObservationLayout.of(settings.task)),
        "PPO": load_policy(policy, settings.task),
    }
    leakage_head = load_head(head, settings.task)
    prepare_folder(folder, False, overwrite, REPORT_FILE, EVALUATION_FILE, CONFIG_FILE)
    if (folder / CONFIG_FILE).exists():
        raise ConfigurationError(f"{folder}: holds a study, whose report this would replace; take another --output")
    with ProgressDisplay() as display:
        evaluation = evaluate(settings.task, controllers, leakage_head, settings.evaluation, display.update)
    write_tables(folder / "tables", evaluation)
    write_yaml(folder / EVALUATION_FILE, settings.model_dump(mode="json"))
    record = StudyRecord(
        title=settings.title,
        configuration=(folder / EVALUATION_FILE).read_text(encoding="utf-8"),
        command=command,
        versions=package_versions(),
        machine=machine_description(),
        seed=0,
        timings={},
        training_curve=pd.DataFrame(),
        examples=example_traces(settings.task, controllers),
    )
    write_report(folder / REPORT_FILE, evaluation, record)
    print_summary(evaluation, display)
    display.say(f"report: {(folder / REPORT_FILE).resolve()}")


def study_to_folder(
    settings: StudySettings, folder: Path, seed: int, resume: bool, overwrite: bool, command: str
) -> None:
    """Run the whole study and say where the report is."""
    with ProgressDisplay() as display:
        result = run_study(settings, folder, seed, display, resume, overwrite, command)
    print_summary(result.evaluation, display)
    for phase, seconds in result.timings.items():
        display.say(f"{phase}: {seconds:.0f} s")
    display.say(f"report: {result.report.resolve()}")


def print_summary(evaluation: Evaluation, display: ProgressDisplay) -> None:
    """The main figures as tables on the console."""
    levels = evaluation.levels[evaluation.levels["metric"] == "mean_error_mm"]
    ratios = evaluation.ratios
    names = list(evaluation.cases["controller"].unique())
    table = Table(title="Mean absolute tracking error, mm (test plants)")
    table.add_column("leakage, l/min at 100 bar", justify="right")
    for name in names:
        table.add_column(name, justify="right")
    for name in names[1:]:
        table.add_column(f"{name} / {names[0]} [95 %]", justify="right")
    for level in [*evaluation.cases["leakage_flow_lpm"].unique(), None]:
        row = ["all" if level is None else f"{level:g}"]
        for name in names:
            if level is None:
                value = evaluation.cases.loc[evaluation.cases["controller"] == name, "mean_error_mm"].mean()
            else:
                chosen = (levels["controller"] == name) & (levels["leakage_flow_lpm"] == level)
                value = levels.loc[chosen, "mean"].iloc[0]
            row.append(f"{value:.4f}")
        for name in names[1:]:
            kind, label = ("all", "") if level is None else ("level", str(level))
            found = ratios[(ratios["controller"] == name) & (ratios["group"] == kind) & (ratios["value"] == label)]
            entry = found.iloc[0]
            row.append(f"{entry['ratio']:.3f} [{entry['low']:.3f}, {entry['high']:.3f}]")
        table.add_row(*row)
    for name in names[1:]:
        entry = ratios[(ratios["controller"] == name) & (ratios["group"] == "equal_weight")].iloc[0]
        ratio = f"{entry['ratio']:.3f} [{entry['low']:.3f}, {entry['high']:.3f}]"
        table.add_row("all, references weighing the same", *[""] * len(names), ratio)
    display.console.print(table)
    if len(evaluation.detection_summary):
        table = Table(title="Leakage head, 2 s of observations (test plants)")
        for heading in ("controller", "AUROC > 0.1", "false alarms", "detected ≥ 0.3 l/min", "size error, median"):
            table.add_column(heading, justify="right")
        for _, entry in evaluation.detection_summary.iterrows():
            table.add_row(
                str(entry["controller"]),
                f"{entry['auroc_above_0.1_lpm']:.4f}",
                f"{100 * entry['false_alarm_rate']:.2f} %",
                f"{100 * entry['detection_rate_from_0.3_lpm']:.2f} %",
                f"× {entry['median_size_error_factor']:.2f}",
            )
        display.console.print(table)
