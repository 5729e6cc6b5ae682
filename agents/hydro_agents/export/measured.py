"""A controller from measured signals in SI units to volts: the computation of an exported controller, in NumPy.

Around ``predict`` it adds the work of the environment in training (velocity estimate, tracking error and its integral,
scaling, limits) and the treatment of lost samples, which only a machine needs.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from hydro_agents.controllers.base import Controller
from hydro_agents.export.measured_signals import MeasuredSignals, ahead_name
from hydro_env.task.settings import settings_of
from hydro_env.units import FULL_VOLTAGE

Array = NDArray[np.float64]


class MeasuredMemory(NamedTuple):
    """Memory of a controller from one sample to the next."""

    last: Array  # (signals,), the last valid samples
    waiting: NDArray[np.bool_]  # (), it starts at the next sample: none was complete, or the command was not a number
    computed: dict[str, Array]  # velocity_estimate (), m/s, and error_integral (), m s, if the controller reads them
    controller: Any


class Step(NamedTuple):
    """Both continuations of a sample, a start from rest and a continuation, and which of them is valid."""

    begins: Any  # (), whether the controller starts here
    lost: Array  # (), number of lost signals
    common: dict[str, Any]  # memory that is the same in both cases, by name
    started: dict[str, Any]  # voltage, and the other parts of the memory
    continued: dict[str, Any]


class MeasuredController:
    """A controller with measured signals in SI units as input and the voltage of the valve as output.

    Args:
        controller: any controller of the project.
        signals: the signals that it reads, and the task for which it was made.
    """

    def __init__(self, controller: Controller, signals: MeasuredSignals) -> None:
        self.controller = controller
        self.signals = signals
        settings = settings_of(signals.config)[0]
        self._period, self._blend = signals.config.control_period, float(settings["velocity_blend"])
        self._integral_time = float(settings["integral_time"])
        self._integral_limit = float(settings["integral_limit"])

    # One sample ---------------------------------------------------------------------------------------------------

    def step(self, signals: Array, start: Any, memory: MeasuredMemory) -> Step:
        """Both continuations of one sample.

        Args:
            signals: (signals,), SI units; a lost signal is NaN or infinite.
            start: (), whether the controller begins here.
            memory: of the last call; at a start its values are ignored.
        """
        s = self.signals
        present = np.less(np.absolute(signals), np.inf)
        lost = np.where(present, 0.0, 1.0).sum(axis=0)
        begins = np.logical_or(start, memory.waiting)
        held = np.where(present, signals, memory.last)

        value = {name: held[place] for name, place in s.places.items()}
        computed: dict[str, Any] = {}
        if "velocity_estimate" in s.used:
            rate = (value["position"] - memory.last[s.places["position"]]) / self._period
            speed = memory.computed["velocity_estimate"]
            computed["velocity_estimate"] = np.where(begins, 0.0, speed + self._blend * (rate - speed))
        if "tracking_error" in s.used or "error_integral" in s.used:
            value["tracking_error"] = error = value["reference"] - value["position"]
        if "error_integral" in s.used:
            integral = memory.computed["error_integral"]
            integral = integral + self._period * (error - integral / self._integral_time)
            integral = np.clip(integral, -self._integral_limit, self._integral_limit)
            computed["error_integral"] = np.where(begins, 0.0, integral)
        value["previous_command"] = value["previous_voltage"] / FULL_VOLTAGE
        value |= {name: value[ahead_name(name)] - value["reference"] for name in s.previews} | computed

        entries = [value[name] if name in s.used else 0.0 * lost for name in s.layout.names]
        observation = np.stack(entries) / s.scale
        observation = np.clip(observation, -s.limits, s.limits).astype(np.float32)[None]
        kept = np.clip(value["previous_voltage"], -FULL_VOLTAGE, FULL_VOLTAGE)

        def way(memory: Any, incomplete: Any) -> dict[str, Any]:
            command, new = aligned(self.controller.predict(observation, memory))
            voltage = FULL_VOLTAGE * np.clip(command.astype(np.float64), -1.0, 1.0)[0, 0]
            # The valve keeps its voltage before the first complete sample, and if the command is not a number.
            waiting = np.logical_or(incomplete, np.logical_not(np.absolute(voltage) < np.inf))
            return {"voltage": np.where(waiting, kept, voltage), "waiting": waiting, "controller": new}

        common = {"last": held, "computed": computed}
        return Step(begins, lost, common, way(None, lost > 0.5), way(memory.controller, np.array(False)))

    def empty(self) -> MeasuredMemory:
        """Memory before the first call: the right shapes, no content."""
        s = self.signals
        rest = np.array([0.5 * (one.low + one.high) for one in s.signals])
        computed: dict[str, Array] = {
            name: np.zeros(()) for name in ("velocity_estimate", "error_integral") if name in s.used
        }
        plain = MeasuredMemory(rest, np.array(False), computed, None)
        observation = np.zeros((1, len(s.layout.names)), dtype=np.float32)
        observation[0] = [0.25 if "pressure" in name else 0.0 for name in s.layout.names]
        _, memory = self.controller.predict(observation, None)
        return plain._replace(controller=aligned((None, memory))[1])

    def __call__(self, signals: Array, memory: MeasuredMemory | None) -> tuple[float, MeasuredMemory]:
        """Voltage, V, for a sample, and the memory for the next one; ``None`` starts."""
        with np.errstate(all="ignore"):
            step = self.step(signals, np.array(memory is None), memory if memory is not None else self.empty())
        way = dict(step.started if bool(step.begins) else step.continued)
        return float(way.pop("voltage")), MeasuredMemory(**step.common, **way)


def aligned(way: tuple[Any, Any]) -> tuple[Any, Any]:
    """Command and memory; the memory in a form that a trace can record."""
    command, memory = way
    return command, memory.aligned() if hasattr(memory, "aligned") else memory
