"""A controller from measured signals in SI units to volts: what an exported controller computes, written in NumPy.

Around ``predict`` it adds what the environment does in training: velocity estimate, tracking error and its integral,
scaling, limits; and what only a machine needs: lost samples.
"""

from __future__ import annotations

from collections.abc import Collection
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from agents.controllers.base import Controller, ObservationLayout
from hydro_env import ConfigurationError, TaskConfig
from hydro_env.task.settings import settings_of
from hydro_env.task.signals import observation_layout
from hydro_env.units import FULL_VOLTAGE

Array = NDArray[np.float64]
_PREVIEW = "reference_preview_"
_COMPUTED = ("velocity_estimate", "tracking_error", "error_integral")


class Signal(NamedTuple):
    """A measured signal."""

    name: str
    unit: str
    low: float  # values beyond are limited
    high: float
    meaning: str


class MeasuredMemory(NamedTuple):
    """What a controller remembers from one sample to the next."""

    last: Array  # (signals,), the last samples that were not lost
    waiting: NDArray[np.bool_]  # (), no sample was complete since the start
    own: dict[str, Array]  # velocity_estimate (), m/s, and error_integral (), m s, if the controller reads them
    controller: Any


class Step(NamedTuple):
    """Both ways on from a sample, and which one holds: a start from rest, and a continuation."""

    begins: Any  # (), whether the controller starts here
    lost: Array  # (), number of lost signals
    common: dict[str, Any]  # memory that is the same both ways, by name
    started: tuple[Any, Any]  # voltage, and memory of the controller
    continued: tuple[Any, Any]


class MeasuredController:
    """A controller with measured signals in SI units as input and the voltage of the valve as output.

    Args:
        controller: any controller of the project.
        config: the task for which it was made: sensors, sampling, limits.
        used: names of the entries of the observation that the controller reads, which decide what is to be measured;
            default: all.

    Raises:
        ConfigurationError: the task's observation holds something that this class cannot compute.
    """

    def __init__(self, controller: Controller, config: TaskConfig, used: Collection[str] | None = None) -> None:
        self.controller = controller
        self.config = config
        self.layout = ObservationLayout.of(config)
        self._limits = observation_layout(config)[3]
        self._scale = np.array(self.layout.scale)
        settings = settings_of(config)[0]
        self._period, self._blend = config.control_period, float(settings["velocity_blend"])
        self._integral_time = float(settings["integral_time"])
        self._integral_limit = float(settings["integral_limit"])
        self._used = [name for name in self.layout.names if used is None or name in used]
        needed = {*self._used, "previous_command"}
        if needed & set(_COMPUTED):
            needed |= {"position"}
        if needed & {"tracking_error", "error_integral", *self._previews()}:
            needed |= {"reference"}
        self.signals = tuple(self._signal(name) for name in self.layout.names if name in needed - set(_COMPUTED))
        self._places = {signal.name: place for place, signal in enumerate(self.signals)}

    def _signal(self, name: str) -> Signal:
        place = self.layout.index(name)
        largest = float(self._limits[place] * self._scale[place])
        if name.startswith(_PREVIEW):
            ahead = dict(zip(self._previews(), self.config.preview_samples, strict=True))[name]
            reach = float(self._limits[0] * self._scale[0])
            return Signal(_ahead(name), "m", -reach, reach, f"reference {ahead} control periods ahead")
        sensors = self.config.sensors
        if name == "reference":
            return Signal(name, "m", -largest, largest, "wanted position now, from the middle of the stroke")
        if name == "previous_command":
            text = "voltage that the valve got in the last control period"
            return Signal("previous_voltage", "V", -FULL_VOLTAGE, FULL_VOLTAGE, text)
        meanings = {
            "position": ("m", "measured, from the middle of the stroke; positive: extended"),
            "pressure_a": ("Pa", "gauge pressure of the chamber on the bore side"),
            "pressure_b": ("Pa", "gauge pressure of the chamber on the rod side"),
            "spool_position": ("1", "of full stroke; positive: extends"),
        }
        if name not in meanings:
            raise ConfigurationError(f"export: no rule for '{name}' of the observation")
        sensor = getattr(sensors, name)
        low, high = (sensor.low, sensor.high) if sensors.enabled else (-largest, largest)
        return Signal(name, meanings[name][0], max(low, -largest), min(high, largest), meanings[name][1])

    def _previews(self) -> list[str]:
        return [name for name in self.layout.names if name.startswith(_PREVIEW) and name in self._used]

    # One sample ---------------------------------------------------------------------------------------------------

    def step(self, signals: Array, start: Any, memory: MeasuredMemory) -> Step:
        """Both ways on from one sample.

        Args:
            signals: (signals,), SI units in the order of :attr:`signals`; a lost one is NaN or infinite.
            start: (), whether the controller begins here.
            memory: of the last call; at the start its values do not count.
        """
        present = np.less(np.absolute(signals), np.inf)
        lost = np.where(present, 0.0, 1.0).sum(axis=0)
        begins = np.logical_or(start, memory.waiting)
        waiting = np.logical_and(begins, lost > 0.5)
        held = np.where(present, signals, memory.last)

        value = {name: held[place] for name, place in self._places.items()}
        own: dict[str, Any] = {}
        if "velocity_estimate" in self._used:
            rate = (value["position"] - memory.last[self._places["position"]]) / self._period
            speed = memory.own["velocity_estimate"]
            own["velocity_estimate"] = np.where(begins, 0.0, speed + self._blend * (rate - speed))
        if "tracking_error" in self._used or "error_integral" in self._used:
            value["tracking_error"] = error = value["reference"] - value["position"]
        if "error_integral" in self._used:
            integral = memory.own["error_integral"]
            integral = integral + self._period * (error - integral / self._integral_time)
            integral = np.clip(integral, -self._integral_limit, self._integral_limit)
            own["error_integral"] = np.where(begins, 0.0, integral)
        value["previous_command"] = value["previous_voltage"] / FULL_VOLTAGE
        value |= {name: value[_ahead(name)] - value["reference"] for name in self._previews()} | own

        entries = [value[name] if name in self._used else 0.0 * lost for name in self.layout.names]
        observation = np.stack(entries) / self._scale
        observation = np.clip(observation, -self._limits, self._limits).astype(np.float32)[None]
        # Before the first complete sample the valve keeps its voltage.
        kept = np.clip(value["previous_voltage"], -FULL_VOLTAGE, FULL_VOLTAGE)
        command, memory_started = self.controller.predict(observation, None)
        voltage_started = np.where(waiting, kept, _voltage(command))
        command, memory_continued = self.controller.predict(observation, memory.controller)
        common = {"last": held, "waiting": waiting, "own": own}
        started, continued = (voltage_started, memory_started), (_voltage(command), memory_continued)
        return Step(begins, lost, common, aligned(started), aligned(continued))

    def empty(self) -> MeasuredMemory:
        """Memory before the first call: the right shapes, no content."""
        rest = np.array([0.5 * (one.low + one.high) for one in self.signals])
        own: dict[str, Array] = {
            name: np.zeros(()) for name in ("velocity_estimate", "error_integral") if name in self._used
        }
        plain = MeasuredMemory(rest, np.array(False), own, None)
        observation = np.zeros((1, len(self.layout.names)), dtype=np.float32)
        observation[0] = [0.25 if "pressure" in name else 0.0 for name in self.layout.names]
        _, memory = self.controller.predict(observation, None)
        return plain._replace(controller=aligned((None, memory))[1])

    def __call__(self, signals: Array, memory: MeasuredMemory | None) -> tuple[float, MeasuredMemory]:
        """Voltage, V, for a sample, and the memory for the next one; ``None`` starts."""
        with np.errstate(all="ignore"):
            step = self.step(signals, np.array(memory is None), memory if memory is not None else self.empty())
        voltage, inner = step.started if bool(step.begins) else step.continued
        return float(voltage), MeasuredMemory(**step.common, controller=inner)

    # To and from the environment ----------------------------------------------------------------------------------

    def from_observation(self, observation: NDArray[Any]) -> Array:
        """Signals (N, signals) whose observations are (N, n): the readings that the environment has rounded.

        Readings of the position are whole steps of the sensor. The tracking error tells the reference more finely than
        the observed reference does.
        """
        si = {name: self.layout.si(observation, name) for name in self.layout.names}
        sensor = self.config.sensors.position
        if self.config.sensors.enabled and sensor.resolution > 0.0:
            steps = np.round((si["position"] - sensor.low) / sensor.resolution)
            si["position"] = np.clip(sensor.low + steps * sensor.resolution, sensor.low, sensor.high)
        observed = observation[:, self.layout.index("reference")].astype(np.float32)
        exact = observed.astype(np.float64)
        low, high = (exact + 0.499 * (np.nextafter(observed, np.float32(end)) - exact) for end in (-np.inf, np.inf))
        scale = self._scale[self.layout.index("reference")]
        if "tracking_error" in si:
            si["reference"] = si["position"] + si["tracking_error"]
        si["reference"] = np.clip(si["reference"], low * scale, high * scale)
        for name in self._previews():
            si[_ahead(name)] = si["reference"] + si[name]
        si["previous_voltage"] = FULL_VOLTAGE * si["previous_command"]
        return np.stack([si[signal.name] for signal in self.signals], axis=1)


def _ahead(name: str) -> str:
    """Name of the reference ahead that a preview of the observation shows."""
    return f"reference_in_{name.removeprefix(_PREVIEW).replace('.', '_')}"


def _voltage(command: Any) -> Any:
    return FULL_VOLTAGE * np.clip(command.astype(np.float64), -1.0, 1.0)[0, 0]


def aligned(way: tuple[Any, Any]) -> tuple[Any, Any]:
    """Command or voltage, and memory, the latter in the form that a trace can hold."""
    command, memory = way
    return command, memory.aligned() if hasattr(memory, "aligned") else memory
