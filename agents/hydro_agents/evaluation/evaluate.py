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
from hydro_agents.evaluation.conditions import Name
from hydro_agents.evaluation.detection import LeakBounds, detection_curves, detection_rates, detection_summary
from hydro_agents.evaluation.limit_cycles import counted
from hydro_agents.evaluation.metrics import FRAMES, METRICS
from hydro_agents.evaluation.participants import participants, split_name
from hydro_agents.evaluation.robustness_protocol import (
    PairedCases,
    PairedCondition,
    PairedProtocol,
    PlantSeeds,
)
from hydro_agents.evaluation.runner import FAILED, Results, run, table, tables_of
from hydro_agents.running.cases import ControllerError
from hydro_agents.running.seeds import SEEDS_PER_FAMILY
from hydro_agents.running.statistics import Interval, conditional_value_at_risk
from hydro_env import ConfigurationError, TaskConfig
from hydro_env.files import validate
from hydro_env.mistakes import known_name
from hydro_env.task.configuration import task_config
from hydro_env.task.reference_signals import FAMILIES, MOVING_FAMILIES


class ProtocolSettings(PairedCases):
    """Size of an evaluation.

    Example:
        >>> from hydro_agents.evaluation.evaluate import ProtocolSettings
        >>> ProtocolSettings(plants=8).leak_levels
        (0.01, 0.03, 0.1, 0.3, 1.0, 2.0, 4.0)
    """

    leak_levels: tuple[float, ...] = Field(
        (0.01, 0.03, 0.1, 0.3, 1.0, 2.0, 4.0), min_length=1, description="l/min at 100 bar"
    )
    families: tuple[Annotated[str, known_name(tuple(FAMILIES), "family")], ...] = Field(MOVING_FAMILIES, min_length=1)
    plants: int = Field(32, ge=3, le=SEEDS_PER_FAMILY, description="per level and family")
    standstill_plants: int = Field(
        8,
        ge=0,
        le=SEEDS_PER_FAMILY,
        description="plants of the search for limit cycles, each at the smallest and the largest leak; 0: no search",
    )
    bound_plants: int = Field(
        0,
        ge=0,
        le=SEEDS_PER_FAMILY,
        description="plants of the best found per family, each at the smallest and the largest leak, for the score; "
        "0: no score. It takes about 0.3 s per case",
    )
    detection_episodes: int = Field(4000, ge=100, le=200_000, description="per controller, half of them healthy")


class StudyProtocol(PairedProtocol):
    """The evaluation of a study as a protocol with one condition: the task itself."""

    kind: Literal["study"] = "study"
    title: str = "Evaluation"
    seeds: PlantSeeds = "EVALUATION"
    plants: int = Field(32, ge=1, le=SEEDS_PER_FAMILY, description="per level and family")
    standstill_plants: int = 8
    bound_conditions: tuple[Name, ...] = ("task",)
    bound_plants: int = 0
    detection_episodes: int = 4000

    def asked(self) -> tuple[str, ...]:
        """Tracking, standstills and the best found; detection needs a head, which the participants have."""
        wanted = {"standstill": self.standstill_plants, "best_found": self.bound_plants}
        return ("tracking", *(name for name, plants in wanted.items() if plants), "episodes")

    def bound_levels(self, name: str) -> Sequence[float]:
        """The smallest and the largest leak."""
        return self.standstills_in(name)[0]

    def standstills_in(self, name: str) -> tuple[Sequence[float], int]:
        """The smallest and the largest leak."""
        return sorted({min(self.leak_levels), max(self.leak_levels)}), self.standstill_plants


@dataclass(frozen=True)
class Evaluation:
    """All numbers of an evaluation, as tables."""

    cases: pd.DataFrame  # one row per controller, training seed, level, family, plant
    levels: pd.DataFrame  # per controller and level: means, intervals, worst case, CVaR of every metric
    families: pd.DataFrame  # the same per controller and family
    ratios: pd.DataFrame  # per controller against the first: overall, per level, per family
    score: pd.DataFrame  # per controller: 0 is the first, 100 the best found; with mean errors over all cases
    bound: pd.DataFrame  # one row per case of the best found
    limit_cycles: pd.DataFrame  # one row per controller, training seed, level, plant: an axis at rest without noise
    limit_cycle_summary: pd.DataFrame  # per controller: standstills with a limit cycle, and the largest amplitude
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
            :func:`~hydro_agents.learning.opponents.opponent`. The first one is the baseline of the ratios. ``NAME#0``,
            ``NAME#1``, … are training seeds of one controller: they share its rows, whose intervals include the seeds.
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
    protocol = StudyProtocol(task=config, conditions={"task": PairedCondition()}, **settings.model_dump())
    report = None if progress is None else lambda _, done, total: progress("evaluation", done, total)
    chosen = replace(participants(controllers, protocol), head=head)
    results = run(protocol, chosen, progress=report)
    errors: dict[str, str] = {}
    for row in results.status[results.status["status"] == FAILED].to_dict("records"):
        errors.setdefault(str(row["controller"]), f"{row['controller']}: {row['message']}")
    for message in errors.values():
        warnings.warn(message, stacklevel=2)
    if not controllers.keys() - errors.keys():
        raise ControllerError("; ".join(errors.values()))
    failed = pd.MultiIndex.from_tuples([split_name(name) for name in errors], names=["controller", "training_seed"])
    rows = {part: table[~table.set_index(failed.names).index.isin(failed)] for part, table in results.rows.items()}
    results = replace(results, rows={part: table.reset_index(drop=True) for part, table in rows.items()})
    tables = {name: results.table(name) for name in tables_of("study")}
    return Evaluation(**tables, bounds=LeakBounds.of(config), errors=errors)


KIND = "study"
RATIO_COLUMNS = ["controller", "against", "group", "value", "ratio", "low", "high", "share_of_cases_better"]
RATIO_COLUMNS += ["ratio_sensor", "ratio_sensor_low", "ratio_sensor_high"]


@table("cases", KIND)
def cases(results: Results) -> pd.DataFrame:
    """One row per controller, training seed, level, family and plant."""
    rows = results.part("tracking")
    return rows[["leakage_flow_lpm", "family", "plant", "controller", "training_seed", "seed", *METRICS]]


@table("levels", KIND)
def levels(results: Results) -> pd.DataFrame:
    """Every metric per controller and leak level."""
    return summary_table(results.part("tracking"), "leakage_flow_lpm")


@table("families", KIND)
def families(results: Results) -> pd.DataFrame:
    """Every metric per controller and family of references."""
    return summary_table(results.part("tracking"), "family")


@table("ratios", KIND)
def ratios(results: Results) -> pd.DataFrame:
    """Mean error of every controller over that of the first."""
    return ratio_table(results.part("tracking"), results.grid.controllers)


@table("score", KIND)
def score(results: Results) -> pd.DataFrame:
    """Score of every controller (0: the first, 100: the best found) on ``cases`` cases; errors over all its cases."""
    bound, grid = results.part("best_found"), results.grid
    if bound.empty:
        return bound
    plants, leaks = np.ones(len(grid.family), dtype=np.bool_), np.ones(len(grid.leak), dtype=np.bool_)
    rows = []
    for name, own in results.part("tracking").groupby("controller", sort=False):
        found = Interval(0.0, np.nan, np.nan)
        if name != grid.controllers[0]:
            found = Interval(*_figures(grid.compare(str(name), grid.controllers[0], plants, leaks), "score"))
        errors = own[list(FRAMES)].mean()
        rows.append({"controller": name, **found.columns("score"), **errors, "cases": len(bound)})
    return pd.DataFrame(rows)


@table("bound", KIND)
def bound(results: Results) -> pd.DataFrame:
    """One row per case of the best found."""
    rows = results.part("best_found")
    return rows if rows.empty else rows.drop(columns=["condition", "group"])


@table("limit_cycles", KIND)
def standstills(results: Results) -> pd.DataFrame:
    """One row per controller, training seed, level and plant: the axis after a small step and back, without noise."""
    rows = results.part("standstill")
    return rows if rows.empty else rows.drop(columns=["family", "condition", "group"])


@table("limit_cycle_summary", KIND)
def standstill_summary(results: Results) -> pd.DataFrame:
    """Number and largest amplitude of the limit cycles, per controller."""
    rows = results.part("standstill")
    groups = () if rows.empty else rows.groupby("controller", sort=False)
    return pd.DataFrame([{"controller": name, **counted(own)} for name, own in groups])


@table("detection_rates", KIND)
def rates(results: Results) -> pd.DataFrame:
    """Share of episodes flagged, by class and size of the leak."""
    episodes = results.part("episodes")
    return episodes if episodes.empty else detection_rates(episodes, results.protocol.task)


@table("detection_summary", KIND)
def detection(results: Results) -> pd.DataFrame:
    """Areas under the curves, rates, and errors of the size, per controller."""
    episodes, head = results.part("episodes"), results.participants.head
    return episodes if episodes.empty else detection_summary(episodes, head.settings.threshold, results.protocol.task)


@table("curves", KIND)
def curves(results: Results) -> pd.DataFrame:
    """ROC, and precision over recall, per controller."""
    episodes = results.part("episodes")
    return episodes if episodes.empty else detection_curves(episodes, results.protocol.task)


def summary_table(cases: pd.DataFrame, by: str) -> pd.DataFrame:
    """Every metric per controller and value of the column ``by``: mean with interval, worst case, mean of the worst."""
    grid, rows = Grid(cases), []
    for (controller, group), frame in cases.groupby(["controller", by], sort=False):
        plants = grid.family == group if by == "family" else np.ones(len(grid.family), dtype=np.bool_)
        situations = grid.leak == group if by != "family" else np.ones(len(grid.leak), dtype=np.bool_)
        for metric, about in METRICS.items():
            rows.append(
                {
                    "controller": controller,
                    by: group,
                    "metric": metric,
                    "unit": about.unit,
                    **grid.mean(controller, metric, plants, situations).columns("mean"),
                    "worst": float(frame[metric].max()),
                    "cvar_5_percent": conditional_value_at_risk(frame[metric].to_numpy()),
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
    plants, leaks = np.ones(len(grid.family), dtype=np.bool_), np.ones(len(grid.leak), dtype=np.bool_)
    parts = [("all", "", plants, leaks)]
    parts += [("level", str(leak), plants, grid.leak == leak) for leak in cases["leakage_flow_lpm"].unique()]
    parts += [("family", str(family), grid.family == family, leaks) for family in cases["family"].unique()]
    for name in names[1:]:
        found = [grid.compare(name, names[0], *part) for _, _, *part in parts]
        for (group, value, *_), row in zip(parts, found, strict=True):
            rows.append((name, names[0], group, value, *_figures(row, "ratio"), row["share_better"]))
            rows[-1] += _figures(row, "ratio_sensor")
        both = (*_figures(found[0], "equal_weight"), np.nan, *_figures(found[0], "equal_weight_sensor"))
        rows.append((name, names[0], "equal_weight", "geometric mean of the families' ratios", *both))
    return pd.DataFrame(rows, columns=RATIO_COLUMNS)


def _figures(row: Mapping[str, float], name: str) -> tuple[float, ...]:
    """A column of a comparison with its interval."""
    return tuple(row[f"{name}{end}"] for end in ("", "_low", "_high"))
