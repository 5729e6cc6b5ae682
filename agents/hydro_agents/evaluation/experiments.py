"""Parts about the task alone: frequency response, stiffness, standstill under noise, and the cost of a leak."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import partial
from typing import Any

import pandas as pd

from hydro_agents.controllers.base import Controller
from hydro_agents.evaluation.frequency import frequency_response
from hydro_agents.evaluation.leak_price import leak_price
from hydro_agents.evaluation.participants import Participants, split_name
from hydro_agents.evaluation.parts import Cell
from hydro_agents.evaluation.robustness_protocol import RobustnessProtocol
from hydro_agents.evaluation.standstill import standstill
from hydro_agents.evaluation.stiffness import force_sine, force_step
from hydro_agents.running.jobs import Columns, Job, fingerprint
from hydro_env import TaskConfig

EXPERIMENTS: dict[str, Callable[..., pd.DataFrame]] = {
    "frequency": frequency_response,
    "force_step": force_step,
    "force_sine": force_sine,
    "hold": standstill,
}
"""Experiments with a controller in the loop: (config, controllers) to a table."""


def _cells(experiment: str, protocol: RobustnessProtocol, chosen: Participants) -> Iterator[Cell]:
    """An experiment on every controller; of several training seeds the first one takes part."""
    controllers: dict[str, Controller] = {}
    for name, controller in chosen.controllers.items():
        controllers.setdefault(split_name(name)[0], controller)
    for name, controller in controllers.items():
        job = Job(measured, controller, (experiment, protocol.task), fingerprint(controller))
        yield Cell(name, known={"controller": name}, jobs=(job,))


frequency, force_steps, force_sines, hold = (partial(_cells, name) for name in EXPERIMENTS)


def measured(controller: Controller, experiment: str, config: TaskConfig) -> Columns:
    """The table of an experiment on one controller.

    Raises:
        ControllerError: the controller raises an exception or returns no finite commands.
    """
    return _columns(EXPERIMENTS[experiment](config, {"": controller}).drop(columns="controller"))


def price(protocol: RobustnessProtocol, chosen: Participants) -> Iterator[Cell]:
    """What a leak costs even if the axis holds its position; no controller takes part."""
    del chosen
    yield Cell("leak", jobs=(Job(leak_costs, None, (protocol.task,), digest="plant"),))


def leak_costs(_: Any, config: TaskConfig) -> Columns:
    """The table of the cost of a leak."""
    return _columns(leak_price(config))


def _columns(table: pd.DataFrame) -> Columns:
    return {str(name): table[name].to_numpy() for name in table}
