"""Compare controllers on test plants: the same plants, references and noise for each, at every leak level.

An evaluation is a protocol with one condition, the task itself; it uses test seeds only.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
import pandas as pd
from pydantic import Field

from hydro_agents.controllers.base import Controller
from hydro_agents.detection.head import LeakageHead
from hydro_agents.detection.monitor import check_head
from hydro_agents.evaluation.comparison import Grid
from hydro_agents.evaluation.detection import LeakBounds, detection_rates, detection_summary
from hydro_agents.evaluation.metrics import ERROR, METRICS
from hydro_agents.evaluation.participants import participants, split_name
from hydro_agents.evaluation.robustness_protocol import (
    PairedCases,
    PairedCondition,
    PairedProtocol,
    PlantSeeds,
)
from hydro_agents.evaluation.runner import FAILED, Results, run, table, tables_of
from hydro_agents.running.cases import ControllerError
from hydro_agents.running.limit_cycles import counted
from hydro_agents.running.seeds import SEEDS_PER_FAMILY
from hydro_agents.running.statistics import ratio_interval
from hydro_env import ConfigurationError, TaskConfig
from hydro_env.files import validate
from hydro_env.mistakes import known_name
from hydro_env.task.configuration import task_config
from hydro_env.task.reference_signals import FAMILIES, MOVING_FAMILIES
from hydro_env.units import Number


class ProtocolSettings(PairedCases):
    """Size of an evaluation.

    Example:
        >>> from hydro_agents.evaluation.evaluate import ProtocolSettings
        >>> ProtocolSettings(plants=8).leak_levels
        (0.01, 0.03, 0.1, 0.3, 1.0, 2.0, 4.0)
    """

    leak_levels: tuple[Number, ...] = Field(
        (0.01, 0.03, 0.1, 0.3, 1.0, 2.0, 4.0), min_length=1, description="l/min at 100 bar"
    )
    families: tuple[Annotated[str, known_name(tuple(FAMILIES), "family")], ...] = Field(MOVING_FAMILIES, min_length=1)
    plants: int = Field(32, ge=3, le=SEEDS_PER_FAMILY, description="per level and family")
    seeds: PlantSeeds = Field(
        "EVALUATION",
        description="of the plants, from the ledger; CHOICES: validation plants, to choose among trainings",
    )
    standstill_plants: int = Field(
        8,
        ge=0,
        le=SEEDS_PER_FAMILY,
        description="plants of the search for limit cycles, each at the smallest and the largest leak; 0: no search",
    )
    detection_episodes: int = Field(4000, ge=100, le=200_000, description="per controller, half of them healthy")


class StudyProtocol(ProtocolSettings, PairedProtocol):
    """The evaluation of a study as a protocol with one condition: the task itself."""

    kind: Literal["study"] = "study"
    title: str = "Evaluation"
    plants: int = Field(32, ge=1, le=SEEDS_PER_FAMILY, description="per level and family")

    def asked(self) -> tuple[str, ...]:
        """Tracking and standstills; detection needs a head, which the participants have."""
        return ("tracking", "standstill", "episodes") if self.standstill_plants else ("tracking", "episodes")

    def standstill_levels(self, name: str) -> Sequence[float]:
        """The smallest and the largest leak."""
        return sorted({min(self.leak_levels), max(self.leak_levels)})


@dataclass(frozen=True)
class Evaluation:
    """All numbers of an evaluation, as tables."""

    cases: pd.DataFrame  # one row per controller, training seed, level, family, plant
    levels: pd.DataFrame  # per controller and level: means, intervals, worst case of every metric
    families: pd.DataFrame  # the same per controller and family
    ratios: pd.DataFrame  # per controller against the first: overall, per level, per family
    growth: pd.DataFrame  # per controller and family: error at the largest leak over that at the smallest
    limit_cycles: pd.DataFrame  # one row per controller, training seed, level, plant: an axis at rest without noise
    limit_cycle_summary: pd.DataFrame  # per controller: standstills with a limit cycle, and the largest amplitude
    detection: pd.DataFrame  # one row per episode for the head
    detection_rates: pd.DataFrame  # per controller and class or level
    detection_summary: pd.DataFrame  # per controller: AUROC, false alarms, size error
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
    folder: Path | None = None,
) -> Evaluation:
    """Compare controllers on test plants: the same plants, references and noise for each.

    A controller that fails (it raises an exception, or returns no finite commands of the right shape) loses only its
    own results: a warning names it and the case, and ``errors`` of the result keeps the message.

    Args:
        task: ``"default"``, a YAML file, a mapping, or a TaskConfig.
        controllers: by name, objects with stable-baselines3's ``predict``, or texts for
            :func:`~hydro_agents.learning.loading.load_controller`. The first one is the baseline of the ratios.
            ``NAME#0``, ``NAME#1``, … are training seeds of one controller: they share its rows,
            whose intervals include the seeds.
        head: leakage head, run under every controller; ``None`` leaves detection out.
        settings: size of the evaluation, :class:`ProtocolSettings` or its fields.
        progress: called with the name of the phase, the number of jobs done, and their total.
        folder: keeps the results of finished jobs, and gives those that it has.

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
    protocol = study_protocol(config, settings)
    report = None if progress is None else lambda _, done, total: progress("evaluation", done, total)
    chosen = replace(participants(controllers, protocol), head=head)
    results = run(protocol, chosen, folder, progress=report)
    errors: dict[str, str] = {}
    for row in results.status[results.status["status"] == FAILED].to_dict("records"):
        errors.setdefault(str(row["controller"]), f"{row['controller']}: {row['message']}")
    for message in errors.values():
        warnings.warn(message, stacklevel=2)
    if not controllers.keys() - errors.keys():
        raise ControllerError("; ".join(errors.values()))
    failed = {split_name(name) for name in errors}
    rows = {}
    for part, frame in results.rows.items():
        kept = [who not in failed for who in zip(frame["controller"], frame["training_seed"], strict=True)]
        rows[part] = frame[kept].reset_index(drop=True)
    results = replace(results, rows=rows)
    tables = {name: results.table(name) for name in tables_of("study")}
    return Evaluation(**tables, bounds=LeakBounds.of(config), errors=errors)


def study_protocol(task: TaskConfig, settings: ProtocolSettings) -> StudyProtocol:
    """The evaluation as a protocol."""
    return StudyProtocol(task=task, conditions={"task": PairedCondition()}, **settings.model_dump())


RATIO_COLUMNS = ["controller", "against", "group", "value", "ratio", "low", "high", "share_of_cases_better"]
RATIO_COLUMNS += ["ratio_sensor", "ratio_sensor_low", "ratio_sensor_high"]


@table("cases")
def cases(results: Results) -> pd.DataFrame:
    """One row per controller, training seed, level, family and plant."""
    rows = results.part("tracking")
    return rows[["leakage_flow_lpm", "family", "plant", "controller", "training_seed", "seed", *METRICS]]


@table("levels")
def levels(results: Results) -> pd.DataFrame:
    """Every metric per controller and leak level."""
    return summary_table(results.part("tracking"), "leakage_flow_lpm")


@table("families")
def families(results: Results) -> pd.DataFrame:
    """Every metric per controller and family of references."""
    return summary_table(results.part("tracking"), "family")


@table("ratios")
def ratios(results: Results) -> pd.DataFrame:
    """Mean error of every controller over that of the first."""
    return ratio_table(results.part("tracking"), results.grid.controllers)


@table("growth")
def growth(results: Results) -> pd.DataFrame:
    """Mean error of every controller at the largest leak over that at the smallest; over all families, and of each."""
    return growth_of(results.part("tracking"))


def growth_of(cases: pd.DataFrame) -> pd.DataFrame:
    """The growth of the mean error with the leak, on the same plants; empty with one leak."""
    rows = []
    several = cases["leakage_flow_lpm"].nunique() > 1
    for name, own in cases.groupby("controller", sort=False) if several else ():
        for family in ("all", *own["family"].unique()):
            chosen = own if family == "all" else own[own["family"] == family]
            errors = chosen.pivot_table(ERROR, "plant", "leakage_flow_lpm").to_numpy()
            ratio = ratio_interval(errors[:, -1], errors[:, 0])
            rows.append({"controller": name, "family": family, **ratio.columns("ratio")})
    return pd.DataFrame(rows)


@table("limit_cycles")
def standstills(results: Results) -> pd.DataFrame:
    """One row per controller, training seed, level and plant: the axis after a small step and back, without noise."""
    rows = results.part("standstill")
    return rows if rows.empty else rows.drop(columns=["family", "condition", "group"])


@table("limit_cycle_summary")
def standstill_summary(results: Results) -> pd.DataFrame:
    """Number and largest amplitude of the limit cycles, per controller."""
    rows = results.part("standstill")
    groups = () if rows.empty else rows.groupby("controller", sort=False)
    return pd.DataFrame([{"controller": name, **counted(own)} for name, own in groups])


@table("detection_rates")
def rates(results: Results) -> pd.DataFrame:
    """Share of episodes flagged, by class and size of the leak."""
    episodes = results.part("episodes")
    return episodes if episodes.empty else detection_rates(episodes, results.protocol.task)


@table("detection_summary")
def detection(results: Results) -> pd.DataFrame:
    """Areas under the curves, rates, and errors of the size, per controller."""
    episodes, head = results.part("episodes"), results.participants.head
    return episodes if episodes.empty else detection_summary(episodes, head.settings.threshold, results.protocol.task)


def summary_table(cases: pd.DataFrame, by: str) -> pd.DataFrame:
    """Every metric per controller and value of the column ``by``: mean with interval, worst case."""
    grid, rows = Grid(cases), []
    for (controller, group), frame in cases.groupby(["controller", by], sort=False):
        plants = grid.family == group if by == "family" else grid.all_plants
        situations = grid.leak == group if by != "family" else grid.all_situations
        for metric, about in METRICS.items():
            rows.append(
                {
                    "controller": controller,
                    by: group,
                    "metric": metric,
                    "unit": about.unit,
                    **grid.mean(controller, metric, plants, situations).columns("mean"),
                    "worst": float(frame[metric].max()),
                    "cases": len(frame),
                }
            )
    return pd.DataFrame(rows)


def ratio_table(cases: pd.DataFrame, names: Sequence[str]) -> pd.DataFrame:
    """Mean error of each controller over that of the first, paired by plant, in both frames.

    The ratios are over all cases, per level, per family, and over all with equal weight for each family (otherwise
    large steps outweigh the rest).
    """
    grid, rows = Grid(cases), []
    parts = [("all", "", grid.all_plants, grid.all_situations)]
    parts += [("level", str(leak), grid.all_plants, grid.leak == leak) for leak in cases["leakage_flow_lpm"].unique()]
    parts += [("family", str(name), grid.family == name, grid.all_situations) for name in cases["family"].unique()]
    for name in names[1:]:
        pair = {"controller": name, "against": names[0]}
        compared = [grid.compare(name, names[0], *where) for _, _, *where in parts]
        for (group, value, *_), row in zip(parts, compared, strict=True):
            rows.append({**pair, "group": group, "value": value, **_ratios(row, "ratio", row["share_better"])})
        about = {"group": "equal_weight", "value": "geometric mean of the families' ratios"}
        rows.append({**pair, **about, **_ratios(compared[0], "equal_weight", np.nan)})
    return pd.DataFrame(rows, columns=RATIO_COLUMNS)


def _ratios(row: Mapping[str, float], name: str, better: float) -> dict[str, float]:
    """A ratio of a comparison in both frames, each with its interval."""
    true = {"ratio": row[name], "low": row[f"{name}_low"], "high": row[f"{name}_high"]}
    sensed = {f"ratio_sensor{end}": row[f"{name}_sensor{end}"] for end in ("", "_low", "_high")}
    return {**true, "share_of_cases_better": better, **sensed}
