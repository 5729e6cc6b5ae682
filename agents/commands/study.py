"""The main job: train PPO and the leakage head from nothing, evaluate them beside the PID, write the report.

Each phase leaves its result in the output folder, so that a study that was stopped can be resumed.
"""

from __future__ import annotations

import json
import math
import os
import platform
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from pydantic import Field

from agents.controllers.base import Controller, ObservationLayout
from agents.controllers.pid import PID, PIDGains
from agents.evaluation.protocol import Evaluation, ProtocolSettings, evaluate
from agents.leakage.head import LeakageHead
from agents.leakage.training import HeadTrainingSettings, train_head
from agents.learning.policy import PolicyController
from agents.learning.progress import Progress
from agents.learning.training import PPOSettings, train_ppo
from agents.report.report import Example, StudyRecord, write_report, write_tables
from agents.running.cases import Cases, run_cases
from agents.running.console import ProgressDisplay
from agents.running.folders import prepare_folder
from agents.running.seeds import TEST_SEEDS
from hydro_env import ConfigurationError, TaskConfig, __version__
from hydro_env.files import Group, read_yaml, validate, write_whole, write_yaml

POLICY_FILE = "policy"
HEAD_FILE = "leakage_head"
CURVE_FILE = "training_curve.csv"
CONFIG_FILE = "study.yaml"
REPORT_FILE = "report.html"
TIMINGS_FILE = "timings.yaml"
STUDY_FILES = (CONFIG_FILE, f"{POLICY_FILE}.json", f"{HEAD_FILE}.json", "checkpoint.json", REPORT_FILE)
TRAINED_BY = ("seed", "task", "pid", "base_pid", "ppo", "leakage_head")
"""What trained weights depend on; the rest of a study may change when it is resumed."""


class StudySettings(Group):
    """A study: the task, the opponents, what is trained and how it is judged. ``configs/studies`` holds some."""

    seed: int = Field(0, ge=0, le=2**32 - 1, description="of everything that is drawn; --seed overrides it")
    title: str = "A servo axis that leaks: PID, PPO and the leakage head"
    task: TaskConfig = Field(default_factory=TaskConfig)
    pid: PIDGains = Field(default_factory=PIDGains, description="the opponent, tuned on the mean error")
    base_pid: PIDGains | None = Field(None, description="what the residual policy corrects; absent: the opponent")
    ppo: PPOSettings = Field(default_factory=PPOSettings)
    leakage_head: HeadTrainingSettings = Field(default_factory=HeadTrainingSettings)
    evaluation: ProtocolSettings = Field(default_factory=ProtocolSettings)

    @classmethod
    def from_yaml(cls, path: str | Path) -> StudySettings:
        """Read a study; a group may be the path of another YAML file, relative to this one.

        Raises:
            ConfigurationError: unreadable file, unknown key or impossible value.
        """
        values = read_yaml(path)
        for key, value in values.items():
            if isinstance(value, str) and value.endswith((".yaml", ".yml")) and key in GROUPS:
                file = Path(path).parent / value
                values[key] = validate(GROUPS[key], read_yaml(file), str(file))
        return validate(cls, values, str(path))


GROUPS: dict[str, type[Group]] = {
    "task": TaskConfig,
    "pid": PIDGains,
    "base_pid": PIDGains,
    "ppo": PPOSettings,
    "leakage_head": HeadTrainingSettings,
    "evaluation": ProtocolSettings,
}
"""Groups of a study that may be the path of a file of their own."""


@dataclass(frozen=True)
class StudyResult:
    """What a study leaves."""

    report: Path
    evaluation: Evaluation
    timings: dict[str, float]


def run_study(
    settings: StudySettings,
    folder: Path,
    seed: int,
    display: ProgressDisplay,
    resume: bool = False,
    overwrite: bool = False,
    command: str = "hydro study",
) -> StudyResult:
    """Run all phases; with ``resume`` those that are done with the same settings are not repeated.

    Raises:
        ConfigurationError: the folder cannot be used, or its results are of other settings.
        KeyboardInterrupt: Ctrl-C; what was done so far stays and can be resumed.
    """
    prepare_folder(folder, resume, overwrite, *STUDY_FILES, can_resume=True)
    described = {**settings.model_dump(mode="json"), "seed": seed}
    stored = folder / CONFIG_FILE
    if resume and stored.exists():
        before, now = read_yaml(stored), json.loads(json.dumps(described))
        changed = next((key for key in TRAINED_BY if before.get(key) != now.get(key)), None)
        if changed is not None:
            raise ConfigurationError(
                f"{stored}: is of another seed or other settings ('{changed}' differs); --overwrite begins anew"
            )
        write_yaml(stored, described)
    else:
        stale = (f"{POLICY_FILE}.json", f"{HEAD_FILE}.json", "checkpoint.json", "head_checkpoint.json")
        for name in (*stale, CURVE_FILE, TIMINGS_FILE):
            (folder / name).unlink(missing_ok=True)
        write_yaml(stored, described)

    timings = _stored_timings(folder)
    policy, curve = _timed(folder, timings, "train PPO", lambda: _policy(settings, folder, seed, display))
    pid = PID(settings.pid, ObservationLayout.of(settings.task))
    controllers: dict[str, Controller] = {"PID": pid, "PPO": policy}
    head = _timed(folder, timings, "train leakage head", lambda: _head(settings, folder, seed, display, controllers))
    evaluation = _timed(
        folder,
        timings,
        "evaluate",
        lambda: evaluate(settings.task, controllers, head, settings.evaluation, display.update),
    )
    examples = _timed(folder, timings, "examples", lambda: example_traces(settings.task, controllers))
    write_tables(folder / "tables", evaluation)
    record = StudyRecord(
        title=settings.title,
        configuration=stored.read_text(encoding="utf-8"),
        command=command,
        versions=package_versions(),
        machine=machine_description(),
        seed=seed,
        timings=timings,
        training_curve=curve,
        examples=examples,
    )
    report = folder / REPORT_FILE
    write_report(report, evaluation, record)
    return StudyResult(report, evaluation, timings)


def _timed(folder: Path, timings: dict[str, float], name: str, work: Callable[[], Any]) -> Any:
    """Do a phase and add the seconds it took to those of sessions before, here and in the folder."""
    began = time.monotonic()
    try:
        return work()
    finally:
        timings[name] = round(timings.get(name, 0.0) + time.monotonic() - began, 1)
        write_yaml(folder / TIMINGS_FILE, timings)


def _stored_timings(folder: Path) -> dict[str, float]:
    file = folder / TIMINGS_FILE
    return {name: float(value) for name, value in read_yaml(file).items()} if file.exists() else {}


def _policy(
    settings: StudySettings, folder: Path, seed: int, display: ProgressDisplay
) -> tuple[PolicyController, pd.DataFrame]:
    curve_file = folder / CURVE_FILE
    if (folder / f"{POLICY_FILE}.json").exists():
        display.say("PPO: already trained")
        curve = pd.read_csv(curve_file) if curve_file.exists() and curve_file.stat().st_size > 1 else pd.DataFrame()
        return PolicyController.load(folder / POLICY_FILE), curve
    gains = settings.base_pid or settings.pid
    go_on = (folder / "checkpoint.json").exists()
    rows = stored_curve(curve_file) if go_on else []
    try:
        policy = train_ppo(
            settings.task,
            settings.ppo,
            gains,
            seed,
            folder,
            resume=go_on,
            progress=ppo_progress(display, rows),
        )
    finally:
        write_curve(curve_file, rows)
    curve = pd.DataFrame(rows)
    policy.save(folder / POLICY_FILE)
    return policy, curve


def stored_curve(file: Path) -> list[dict[str, float]]:
    """The training curve of the sessions before, to which a resumed training adds."""
    if not file.exists() or file.stat().st_size <= 1:
        return []
    return [{str(key): float(value) for key, value in row.items()} for row in pd.read_csv(file).to_dict("records")]


def write_curve(file: Path, rows: list[dict[str, float]]) -> None:
    """Write the training curve; an empty one leaves the file alone."""
    if rows:
        write_whole(file, pd.DataFrame(rows).to_csv(index=False).encode())


def ppo_progress(display: ProgressDisplay, rows: list[dict[str, float]]) -> Callable[[Progress], None]:
    """A callback that shows a PPO training and notes its curve."""
    before = rows[-1]["seconds"] if rows else 0.0
    last = [0.0, rows[-1]["steps"] if rows else 0.0]

    def report(progress: Progress) -> None:
        passed, steps = progress.seconds - last[0], progress.steps - last[1]
        last[:] = progress.seconds, progress.steps
        seconds = before + progress.seconds
        rows.append({"steps": progress.steps, "seconds": seconds, "mean_reward": progress.mean_reward})
        rate = f"{steps / passed:,.0f} steps/s" if passed > 0 else ""
        reward = "" if math.isnan(progress.mean_reward) else f", mean reward {progress.mean_reward:.4f}"
        display.update("train PPO", min(progress.steps, progress.total_steps), progress.total_steps, rate + reward)

    return report


def head_progress(display: ProgressDisplay) -> Callable[[str, int, int, float], None]:
    """A callback that shows the training of the leakage head."""

    def report(phase: str, done: int, total: int, loss: float) -> None:
        note = "" if math.isnan(loss) else f"loss {loss:.4f}"
        display.update(f"leakage head, {phase}", done, total, note)

    return report


def _head(
    settings: StudySettings,
    folder: Path,
    seed: int,
    display: ProgressDisplay,
    controllers: Mapping[str, Controller],
) -> LeakageHead:
    if (folder / f"{HEAD_FILE}.json").exists():
        display.say("leakage head: already trained")
        return LeakageHead.load(folder / HEAD_FILE)
    head = train_head(
        settings.task,
        list(controllers.values()),
        settings.leakage_head,
        seed,
        head_progress(display),
        folder=folder,
        resume=(folder / "head_checkpoint.json").exists(),
    )
    head.save(folder / HEAD_FILE)
    return head


EXAMPLES = (
    ("step", 0.01, "steps, healthy seal (0.01 l/min at 100 bar)"),
    ("step", 4.0, "the same with 4 l/min"),
    ("start_stop", 0.01, "start–stop, healthy seal (0.01 l/min at 100 bar)"),
    ("start_stop", 4.0, "the same with 4 l/min"),
)


def example_traces(config: TaskConfig, controllers: Mapping[str, Controller], number: int = 0) -> list[Example]:
    """Time traces of a few test episodes under every controller."""
    seed = TEST_SEEDS.start + 900_000 + number
    cases = Cases(
        np.full(len(EXAMPLES), seed, dtype=np.int64),
        np.array([leak for _, leak, _ in EXAMPLES]),
        np.array([family for family, _, _ in EXAMPLES]),
    )
    runs = {name: run_cases(config, controller, cases) for name, controller in controllers.items()}
    first = next(iter(runs.values()))
    return [
        Example(
            title=title,
            time=first.time,
            reference=first.reference[case],
            position={name: run.position[case] for name, run in runs.items()},
            command={name: run.command[case] for name, run in runs.items()},
        )
        for case, (_, _, title) in enumerate(EXAMPLES)
    ]


def package_versions() -> dict[str, str]:
    """Versions of what the results rest on."""
    names = ("gymnasium", "numba", "numpy", "scipy", "stable-baselines3", "torch")
    own = {"python": platform.python_version(), "hydro_env": __version__}
    return {**own, **{name: version(name) for name in names}}


def machine_description() -> str:
    """Processor, cores and system in one line."""
    model = platform.processor() or platform.machine()
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
        model = next((line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")), model)
    except OSError:
        pass
    return f"{model}, {os.cpu_count()} cores, {platform.system()}"
