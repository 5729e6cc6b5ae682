"""The controllers of the playground: the shipped ones, some with gains that can be changed while they run."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, cast

from hydro_agents.controllers.base import ClassicalController, search_space
from hydro_agents.export.controller_code import ControllerCode, code_of
from hydro_agents.export.controller_graph import controller_graph
from hydro_agents.export.tunable import Tunable
from hydro_agents.learning.opponents import shipped
from hydro_env import TaskConfig


@dataclass(frozen=True)
class Choice:
    """A controller by its kind, as ``hydro evaluate --agent`` names it."""

    kind: str
    name: str
    gains: dict[str, tuple[str, str]]  # field → label of its slider, unit


CHOICES = (
    Choice(
        "pid",
        "PID",
        {
            "proportional": ("Proportional gain", "1/m"),
            "integral": ("Integral gain", "1/(m s)"),
            "derivative": ("Derivative gain", "s/m"),
            "feedforward_extending": ("Feed-forward extending", "s/m"),
            "feedforward_retracting": ("Feed-forward retracting", "s/m"),
        },
    ),
    Choice(
        "flow_linearising",
        "Flow linearisation",
        {
            "position_gain": ("Position gain, per pace of the loop", ""),
            "damping": ("Pressure feedback", ""),
            "friction": ("Friction fed forward, share of data sheet", ""),
        },
    ),
    Choice("ppo", "PPO on flow linearisation", {}),
)


@dataclass(frozen=True)
class Written:
    """A controller in C."""

    choice: Choice
    code: ControllerCode
    signals: tuple[str, ...]  # that it reads, in order
    gains: dict[str, float]  # tuned values
    sliders: list[dict[str, Any]]


def written(choice: Choice, config: TaskConfig) -> Written:
    """The C of a controller.

    Raises:
        TraceError: the controller cannot be exported exactly.
    """
    controller = shipped(choice.kind, config)
    tuned: dict[str, float] = {}
    sliders: list[dict[str, Any]] = []
    if choice.gains:
        classical = cast("ClassicalController", controller)
        tuned = {name: float(getattr(classical.gains, name)) for name in choice.gains}
        space = search_space(type(classical.gains))
        for name, (words, unit) in choice.gains.items():
            low, high, logarithmic = space[name]
            limits = (tuned[name] / 10.0, tuned[name] * 10.0) if logarithmic else (low, high)
            slider = {"name": words, "unit": unit, "low": limits[0], "high": limits[1], "value": tuned[name]}
            identity = {"gain": f"{choice.kind}.{name}", "controller": choice.kind, "logarithmic": logarithmic}
            sliders.append({**slider, **identity})
        controller = Tunable(classical, tuple(choice.gains))
    graph = controller_graph(controller, config)
    signals = tuple(signal.name for signal in graph.signals.signals)
    return Written(choice, code_of(graph, choice.kind), signals, tuned, sliders)
