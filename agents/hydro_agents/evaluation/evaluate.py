"""Compare controllers on test plants: a protocol with one condition, the task itself."""

import warnings
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from pydantic import Field

from hydro_agents.controllers.base import Controller
from hydro_agents.evaluation.robustness_protocol import (
    Levels,
    PairedCases,
    PairedCondition,
    PlantSeeds,
    RobustnessProtocol,
    participants,
)
from hydro_agents.evaluation.runner import Results, run
from hydro_agents.running.jobs import Report
from hydro_agents.running.seeds import SEEDS_PER_FAMILY
from hydro_env import TaskConfig, task_config
from hydro_env.files import validate
from hydro_env.task.configuration import Given


class ProtocolSettings(PairedCases):
    """Size of an evaluation on test plants.

    Example:
        >>> from hydro_agents.evaluation.evaluate import ProtocolSettings
        >>> ProtocolSettings(plants=8).leak_levels
        (0.01, 0.03, 0.1, 0.3, 1.0, 2.0, 4.0)
    """

    leak_levels: Levels = (0.01, 0.03, 0.1, 0.3, 1.0, 2.0, 4.0)  # l/min at 100 bar
    plants: int = Field(32, ge=3, le=SEEDS_PER_FAMILY)  # per level and family
    # Of the plants, from the ledger; CHOICES: validation plants, to choose among trainings
    seeds: PlantSeeds = "EVALUATION"
    # Plants of the search for limit cycles, each at the smallest and the largest leak; 0: no search
    standstill_plants: int = Field(8, ge=0, le=SEEDS_PER_FAMILY)

    def protocol(self, task: TaskConfig, title: str = "Evaluation") -> RobustnessProtocol:
        """The evaluation as a protocol whose only condition is the task itself."""
        return RobustnessProtocol(
            title=title,
            task=task,
            conditions={"task": PairedCondition()},
            standstill_leak_levels=tuple(sorted({min(self.leak_levels), max(self.leak_levels)})),
            chunk=2048,
            **self.model_dump(),
        )


def evaluate(
    task: Given,
    controllers: Mapping[str, Controller | str | Path],
    settings: ProtocolSettings | Mapping[str, Any] | None = None,
    progress: Report | None = None,
    folder: Path | None = None,
) -> Results:
    """Compare controllers on test plants: the same plants, references and noise for each.

    A controller that fails (it raises an exception, or returns no finite commands of the right shape) loses only its
    own results: a warning names it and the case, and ``errors`` of the result keeps the message.

    Args:
        task: ``"default"``, a YAML file, a mapping, or a TaskConfig.
        controllers: by name, objects with stable-baselines3's ``predict``, or texts for
            :func:`~hydro_agents.learning.loading.load_controller`. The first one is the baseline of the ratios.
            ``NAME#0``, ``NAME#1``, … are training seeds of one controller: they share its rows,
            whose intervals include the seeds.
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
        >>> results.controllers, len(results.table("cases"))  # one row per controller and case
        (['PID', 'mine'], 6)
        >>> results.table("comparison").loc[0, ["controller", "against", "group"]].tolist()
        ['mine', 'PID', 'all']
    """
    config = task_config(task)
    if not isinstance(settings, ProtocolSettings):
        settings = validate(ProtocolSettings, settings or {}, "evaluation")
    protocol = settings.protocol(config)
    results = run(protocol, participants(controllers, protocol), folder, progress)
    for message in results.errors:
        warnings.warn(message, stacklevel=2)
    return results
