"""The robustness protocol: the same plants, references and noise for every controller, at every leak level.

An evaluation is a list of independent cases, each a pure function of configuration and seed; it uses test seeds only.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any

import pandas as pd
from pydantic import Field, model_validator

from hydro_agents.controllers.base import Controller
from hydro_agents.detection.head import LeakageHead
from hydro_agents.detection.monitor import HeadDetector, check_head
from hydro_agents.evaluation.detection import (
    LeakBounds,
    detection_cases,
    detection_curves,
    detection_rates,
    detection_summary,
    detection_table,
    signal_columns,
)
from hydro_agents.evaluation.metrics import rollout_metrics
from hydro_agents.evaluation.tables import ratio_table, summary_table
from hydro_agents.learning.opponents import opponent
from hydro_agents.running.cases import Cases, ControllerError, run_cases
from hydro_agents.running.seeds import EVALUATION, SEEDS_PER_FAMILY, SeedRange
from hydro_env import REFERENCE_FAMILIES, ConfigurationError, TaskConfig
from hydro_env.files import Group, validate
from hydro_env.mistakes import known_name
from hydro_env.task.configuration import LEAKAGE_LIMIT, task_config

DRAWN_FAMILIES = tuple(name for name in REFERENCE_FAMILIES if name != "user")


class ProtocolSettings(Group):
    """Size of an evaluation."""

    leak_levels: tuple[float, ...] = Field(
        (0.01, 0.03, 0.1, 0.3, 1.0, 2.0, 4.0), min_length=1, description="l/min at 100 bar"
    )
    families: tuple[Annotated[str, known_name(DRAWN_FAMILIES, "family")], ...] = Field(DRAWN_FAMILIES, min_length=1)
    plants: int = Field(32, ge=3, le=SEEDS_PER_FAMILY, description="per level and family")
    detection_episodes: int = Field(4000, ge=100, le=200_000, description="per controller, half of them healthy")

    @model_validator(mode="after")
    def _possible(self) -> ProtocolSettings:
        for level in self.leak_levels:
            if not 0.0 < level <= LEAKAGE_LIMIT:
                raise ValueError(f"leak_levels: {level:g} l/min: must be within 0 (excluded) to {LEAKAGE_LIMIT:g}")
        for name in ("leak_levels", "families"):
            if len(set(getattr(self, name))) != len(getattr(self, name)):
                raise ValueError(f"{name}: has a duplicate entry")
        return self


@dataclass(frozen=True)
class Evaluation:
    """All numbers of an evaluation, as tables."""

    cases: pd.DataFrame  # one row per controller, level, family, plant
    levels: pd.DataFrame  # per controller and level: means, intervals, worst case, CVaR of every metric
    families: pd.DataFrame  # the same per controller and family
    ratios: pd.DataFrame  # per controller against the first: overall, per level, per family
    detection: pd.DataFrame  # one row per episode for the head
    detection_rates: pd.DataFrame  # per controller and class or level
    detection_summary: pd.DataFrame  # per controller: AUROC, average precision, false alarms, size error
    curves: pd.DataFrame  # ROC and precision–recall
    bounds: LeakBounds = field(default_factory=lambda: LeakBounds.of(TaskConfig()))
    errors: dict[str, str] = field(default_factory=dict)  # controller → reason for missing results

    @property
    def controllers(self) -> list[str]:
        """Names of the controllers that have results, in their order."""
        return [str(name) for name in self.cases["controller"].unique()]


def tracking_cases(settings: ProtocolSettings, seeds: SeedRange = EVALUATION) -> tuple[Cases, pd.DataFrame]:
    """All cases of the tracking part, and a table with level, family and plant of each.

    Args:
        settings: levels, families and number of plants.
        seeds: those of the plants.
    """
    rows = [
        (level, family, plant)
        for level in settings.leak_levels
        for family in settings.families
        for plant in range(settings.plants)
    ]
    table = pd.DataFrame(rows, columns=["leakage_flow_lpm", "family", "plant"])
    # A family has the same plants at every level; families have different plants.
    family_number = table["family"].map({name: i for i, name in enumerate(REFERENCE_FAMILIES)})
    numbers = seeds.of_family(family_number.to_numpy(), table["plant"].to_numpy())
    cases = Cases(numbers, table["leakage_flow_lpm"].to_numpy(), table["family"].to_numpy().astype(str))
    return cases, table


def evaluate(
    task: TaskConfig | Mapping[str, Any] | str | Path | None,
    controllers: Mapping[str, Controller | str | Path],
    head: LeakageHead | None = None,
    settings: ProtocolSettings | Mapping[str, Any] | None = None,
    progress: Callable[[str, int, int], None] | None = None,
) -> Evaluation:
    """Compare controllers on test plants: the same plants, references and noise for each.

    A controller that fails (it raises an exception, or returns no finite commands of the right shape) loses only its
    own results: a warning names it and the case, and ``errors`` of the result keeps the message.

    Args:
        task: ``"default"``, a YAML file, a mapping, or a TaskConfig.
        controllers: by name, objects with stable-baselines3's ``predict``, or texts for
            :func:`~hydro_agents.learning.opponents.opponent`. The first one is the baseline of the ratios.
        head: leakage head, run under every controller; ``None`` leaves detection out.
        settings: size of the evaluation, :class:`ProtocolSettings` or its fields.
        progress: called with the name of the phase, the number of cases done, and their total.

    Raises:
        ConfigurationError: the task or the settings are impossible, a text names no controller, weights belong to
            another task, or all controllers failed.
    """
    config = task_config(task)
    if not isinstance(settings, ProtocolSettings):
        settings = validate(ProtocolSettings, settings or {}, "evaluation")
    if not controllers:
        raise ConfigurationError("evaluate: needs at least one controller")
    if head is not None:
        check_head(head, config, "leakage head")
    cases, table = tracking_cases(settings)
    watched = detection_cases(config, settings.detection_episodes)
    preview = max(config.references.preview_times, default=0.0)
    ready = {name: opponent(controller, config, name) for name, controller in controllers.items()}
    tracking, detection, errors = [], [], {}
    for name, controller in ready.items():
        try:
            report = _reporter(progress, f"tracking, {name}", len(cases))
            rollout = run_cases(config, controller, cases, progress=report)
            assert cases.families is not None
            metrics = rollout_metrics(rollout, cases.families, config.control_period, preview)
            estimates = pd.DataFrame()
            if head is not None:
                report = _reporter(progress, f"detection, {name}", len(watched))
                columns = signal_columns(head.settings.layout.names)
                rollout = run_cases(config, controller, watched, columns, states=False, progress=report)
                estimates = detection_table(name, watched, rollout, HeadDetector(head), config)
        except ControllerError as error:
            errors[name] = f"{name}: {error}"
            warnings.warn(errors[name], stacklevel=2)
            continue
        tracking.append(table.assign(controller=name, seed=cases.seeds, **metrics))
        detection.append(estimates)
    if not tracking:
        raise ControllerError("; ".join(errors.values()))
    all_cases, episodes = (pd.concat(frames, ignore_index=True) for frames in (tracking, detection))
    nothing = pd.DataFrame()
    return Evaluation(
        cases=all_cases,
        levels=summary_table(all_cases, "leakage_flow_lpm"),
        families=summary_table(all_cases, "family"),
        ratios=ratio_table(all_cases, [name for name in ready if name not in errors]),
        detection=episodes,
        detection_rates=nothing if head is None else detection_rates(episodes, config),
        detection_summary=nothing if head is None else detection_summary(episodes, head.settings.threshold, config),
        curves=nothing if head is None else detection_curves(episodes, config),
        bounds=LeakBounds.of(config),
        errors=errors,
    )


def _reporter(progress: Callable[[str, int, int], None] | None, phase: str, total: int) -> Callable[[int], None] | None:
    if progress is None:
        return None
    progress(phase, 0, total)
    return lambda done: progress(phase, done, total)
