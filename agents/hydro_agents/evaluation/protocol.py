"""Compare controllers on test plants: the same plants, references and noise for each, at every leak level.

An evaluation is a protocol with one condition, the task itself; it uses test seeds only.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated, Any, Literal

import pandas as pd
from pydantic import Field

from hydro_agents.controllers.base import Controller
from hydro_agents.detection.head import LeakageHead
from hydro_agents.detection.monitor import check_head
from hydro_agents.evaluation.detection import LeakBounds
from hydro_agents.evaluation.paired_cases import (
    DRAWN_FAMILIES,
    PairedCases,
    PairedCondition,
    PairedProtocol,
    PlantSeeds,
)
from hydro_agents.evaluation.participants import Participants
from hydro_agents.evaluation.runner import FAILED, run, tables_of
from hydro_agents.learning.opponents import opponent
from hydro_agents.running.cases import ControllerError
from hydro_agents.running.seeds import SEEDS_PER_FAMILY
from hydro_env import ConfigurationError, TaskConfig
from hydro_env.files import validate
from hydro_env.mistakes import known_name
from hydro_env.task.configuration import task_config


class ProtocolSettings(PairedCases):
    """Size of an evaluation.

    Example:
        >>> from hydro_agents.evaluation.protocol import ProtocolSettings
        >>> ProtocolSettings(plants=8).leak_levels
        (0.01, 0.03, 0.1, 0.3, 1.0, 2.0, 4.0)
    """

    leak_levels: tuple[float, ...] = Field(
        (0.01, 0.03, 0.1, 0.3, 1.0, 2.0, 4.0), min_length=1, description="l/min at 100 bar"
    )
    families: tuple[Annotated[str, known_name(DRAWN_FAMILIES, "family")], ...] = Field(DRAWN_FAMILIES, min_length=1)
    plants: int = Field(32, ge=3, le=SEEDS_PER_FAMILY, description="per level and family")
    detection_episodes: int = Field(4000, ge=100, le=200_000, description="per controller, half of them healthy")


class StudyProtocol(PairedProtocol):
    """The evaluation of a study as a protocol with one condition: the task itself."""

    kind: Literal["study"] = "study"
    title: str = "Evaluation"
    seeds: PlantSeeds = "EVALUATION"
    plants: int = Field(32, ge=1, le=SEEDS_PER_FAMILY, description="per level and family")
    detection_episodes: int = 4000

    def asked(self) -> tuple[str, ...]:
        """Tracking; detection needs a head, which the participants have."""
        return ("tracking", "episodes")


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

    Example:
        >>> from hydro_agents import evaluate
        >>> size = {"plants": 3, "leak_levels": [1.0], "families": ["step"]}
        >>> results = evaluate("default", {"PID": "pid", "mine": "flow_linearising"}, settings=size)
        >>> results.controllers, len(results.cases)  # one row per controller and case
        (['PID', 'mine'], 6)
        >>> results.ratios.loc[0, ["controller", "against", "group"]].tolist()
        ['mine', 'PID', 'all']
    """
    config = task_config(task)
    if not isinstance(settings, ProtocolSettings):
        settings = validate(ProtocolSettings, settings or {}, "evaluation")
    if not controllers:
        raise ConfigurationError("evaluate: needs at least one controller")
    if head is not None:
        check_head(head, config, "leakage head")
    ready = {name: opponent(controller, config, name) for name, controller in controllers.items()}
    protocol = StudyProtocol(task=config, conditions={"task": PairedCondition()}, **settings.model_dump())
    report = None if progress is None else lambda _, done, total: progress("evaluation", done, total)
    results = run(protocol, Participants(ready, head=head), jobs=1, progress=report)
    errors: dict[str, str] = {}
    for row in results.status[results.status["status"] == FAILED].to_dict("records"):
        errors.setdefault(str(row["controller"]), f"{row['controller']}: {row['message']}")
    for message in errors.values():
        warnings.warn(message, stacklevel=2)
    if len(errors) == len(ready):
        raise ControllerError("; ".join(errors.values()))
    rows = {part: table[~table["controller"].isin(list(errors))] for part, table in results.rows.items()}
    results = replace(results, rows={part: table.reset_index(drop=True) for part, table in rows.items()})
    tables = {name: results.table(name) for name in tables_of("study")}
    return Evaluation(**tables, bounds=LeakBounds.of(config), errors=errors)
