"""A controller from measured signals in SI units to volts: the computation of an exported controller, in NumPy.

Around ``predict`` it adds the work of the environment in training (velocity estimate, tracking error and its integral,
scaling, limits) and the treatment of lost samples, which only a machine needs.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from functools import reduce
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from hydro_agents.controllers.base import Controller, ObservationLayout, shown_time
from hydro_agents.controllers.flow_model import FlowModel
from hydro_agents.controllers.own_loop import LOST_TIME, LOST_TRAVEL, OUT_OF_RANGE, STOPPING_TIME
from hydro_env import ConfigurationError, TaskConfig
from hydro_env.axes import Axes
from hydro_env.plant.analysis import speed_limits
from hydro_env.task.sensors import CHANNEL_UNITS, CHANNELS
from hydro_env.task.settings import settings_of
from hydro_env.task.signals import observation_layout
from hydro_env.types import Floats
from hydro_env.units import FULL_VOLTAGE
from hydro_rig.export.graph import SCALED
from hydro_rig.export.tracing import named

COMPUTED = ("velocity_estimate", "tracking_error", "error_integral")
"""Entries of the observation that follow from measured signals."""

LOST_RULE = (
    f"those in which the axis travels {1e3 * LOST_TRAVEL:g} mm at the present command, at least one, "
    f"and not more than {1e3 * LOST_TIME:g} ms"
)

_PREVIEW = "reference_preview_"
SENSOR_MEANINGS = {
    "position": "measured, from the middle of the stroke; positive: extended",
    "pressure_a": "gauge pressure of the chamber on the bore side",
    "pressure_b": "gauge pressure of the chamber on the rod side",
    "spool_position": "of full stroke; positive: extends",
}


class MeasuredSignal(NamedTuple):
    """A measured signal."""

    name: str
    unit: str
    low: float  # ends of the range in training
    high: float
    limit: float  # the controller clips values to ± this; of a future reference: its distance from the present one
    meaning: str


class MeasuredSignals:
    """The signals that a controller needs, in SI units, and their relation to the observation.

    Args:
        config: the task: sensors, sampling, limits.
        used: names of the entries of the observation that the controller reads; default: all.

    Raises:
        ConfigurationError: an entry of the task's observation is not a measured signal.
    """

    def __init__(self, config: TaskConfig, used: Collection[str] | None = None) -> None:
        self.config = config
        self.layout = ObservationLayout.of(config)
        self.limits = observation_layout(config)[3]
        self.scale = np.array(self.layout.scale)
        self.used = [name for name in self.layout.names if used is None or name in used]
        shown = [name for name in self.layout.names if name.startswith(_PREVIEW)]
        self.ahead = dict(zip(shown, config.preview_samples, strict=True))  # control periods, by name of the preview
        self.previews = [name for name in shown if name in self.used]
        needed = {*self.used, "previous_command"}
        if needed & set(COMPUTED):
            needed |= {"position"}
        if needed & {"tracking_error", "error_integral", *self.previews}:
            needed |= {"reference"}
        rows = [self._signal(name) for name in self.layout.names if name in needed - set(COMPUTED)]
        self.signals = tuple(dict.fromkeys(rows))  # two previews may show one sample
        self.places = {signal.name: place for place, signal in enumerate(self.signals)}
        spans = np.array([(signal.low, signal.high) for signal in self.signals]).T
        self.lowest, self.highest = spans + OUT_OF_RANGE * (spans[1] - spans[0]) * np.array([[-1.0], [1.0]])

    def _signal(self, name: str) -> MeasuredSignal:
        place = self.layout.index(name)
        limit = float(self.limits[place] * self.scale[place])
        reach = self.config.plant.cylinder.stroke / 2.0
        if name.startswith(_PREVIEW):
            ahead = self.ahead[name]
            own = ahead_name(name, self.config.control_period)
            return MeasuredSignal(own, "m", -reach, reach, limit, f"reference {ahead} control periods ahead")
        if name == "reference":
            return MeasuredSignal(
                name, "m", -reach, reach, limit, "desired position now, from the middle of the stroke"
            )
        if name == "previous_command":
            text = "voltage that the valve received in the last control period"
            return MeasuredSignal("previous_voltage", "V", -FULL_VOLTAGE, FULL_VOLTAGE, FULL_VOLTAGE, text)
        if name not in CHANNELS:
            raise ConfigurationError(f"export: '{name}' of the observation is not a measured signal")
        sensor = getattr(self.config.sensors, name)
        return MeasuredSignal(
            name, CHANNEL_UNITS[name], sensor.low, sensor.high, limit, SENSOR_MEANINGS.get(name, "measured")
        )

    def of_axes(self, axes: Axes) -> Floats:
        """Signals (N, signals) of simulated axes, exactly as their sensors read."""
        now = np.asarray(axes.column("step"), dtype=np.int64)
        row = np.arange(axes.count)
        si = {name: axes.column("measured")[:, place] for place, name in enumerate(CHANNELS)}
        si |= {"reference": axes.reference[row, now], "previous_voltage": FULL_VOLTAGE * axes.column("command")}
        period = self.config.control_period
        si |= {ahead_name(name, period): axes.reference[row, now + count] for name, count in self.ahead.items()}
        return np.stack([si[signal.name] for signal in self.signals], axis=1)


def ahead_name(name: str, period: float) -> str:
    """Name of the reference ahead that a preview of the observation shows, with its true time; period in s."""
    time = shown_time(1e-3 * float(name.removeprefix(_PREVIEW).removesuffix("ms")), period)
    return f"reference_in_{1e3 * time:g}ms".replace(".", "_")


class MeasuredMemory(NamedTuple):
    """Memory of a controller from one sample to the next."""

    last: Floats  # (signals,), the last valid samples
    running: NDArray[np.bool_]  # (), it goes on at the next sample; else it starts there, as a memory of zeros does
    lost_samples: NDArray[np.int64]  # (), successive ones with a lost signal or without a command
    holding: NDArray[np.bool_]  # (), too many samples were lost: it holds the axis until the next start
    holding_voltage: Floats  # (), V, that holds the load of the last complete sample
    last_voltage: Floats  # (), V, of the last call
    computed: dict[str, Floats]
    """If the controller reads them: velocity_estimate (), m/s, and error_integral (), m s. With them standby (),
    whether the last call was a start with a complete sample."""
    controller: Any


class BothWays(NamedTuple):
    """Both continuations of a sample, a start and a continuation, and which of them is valid."""

    begins: Any  # (), whether the controller starts here
    lost: Floats  # (), number of lost signals
    common: dict[str, Any]  # memory that is the same in both cases, by name
    started: dict[str, Any]  # voltage, and the other parts of the memory
    continued: dict[str, Any]


class MeasuredController:
    """A controller with measured signals in SI units as input and the voltage of the valve as output."""

    def __init__(self, controller: Controller, signals: MeasuredSignals) -> None:
        self.controller = controller
        self.signals = signals
        settings = settings_of(signals.config)[0]
        self._period, self._blend = signals.config.control_period, float(settings["velocity_blend"])
        self._integral_time = float(settings["integral_time"])
        self._integral_limit = float(settings["integral_limit"])
        plant = signals.config.plant
        self._model = FlowModel(plant)
        self._speed_per_volt = max(speed_limits(plant)) / FULL_VOLTAGE

    def step(
        self,
        signals: Floats,
        valid: Any,
        start: Any,
        lost_limit: Any,
        memory: MeasuredMemory,
        sound: Sequence[Any] = (),
    ) -> BothWays:
        """Both continuations of one sample.

        Args:
            signals: (signals,), SI units.
            valid: (signals,), whether each signal is what its sensor measures. A signal is lost if it is not valid, not
                a number, or outside of its range by more than :data:`OUT_OF_RANGE`.
            start: (), whether the controller begins here. In consecutive starts it stands by while another controller
                drives the axis: it measures the speed with which it takes over.
            lost_limit: (), successive lost samples that are allowed; 0: :data:`LOST_TRAVEL` and :data:`LOST_TIME`.
            memory: of the last call; of zeros: the controller begins here.
            sound: of each gain that may change, (), whether it is usable; else the last command stays.
        """
        s = self.signals
        reading = np.where(valid, signals, memory.last)  # nothing is compared with a signal that is not valid
        lowest, highest = s.lowest, s.highest
        inside = np.logical_and(np.less_equal(lowest, reading), np.less_equal(reading, highest))
        present = np.logical_and(valid, inside)
        lost = np.where(present, 0.0, 1.0).sum(axis=0)
        begins = np.logical_or(start, np.logical_not(memory.running))
        value: dict[str, Any] = {}
        for name, place in s.places.items():
            sample = np.where(present[place], signals[place], memory.last[place])
            value[name] = named(f"{name}_sample", sample)
        held = np.stack(list(value.values()))
        computed = self._computed(value, memory, start, begins, lost)
        observation = self._observation(value)
        kept = np.clip(value["previous_voltage"], -FULL_VOLTAGE, FULL_VOLTAGE)
        complete = np.less(lost, 0.5)
        still = np.logical_and(memory.holding, np.logical_not(np.logical_and(start, complete)))
        one_more = np.where(still, 0, 1)
        at_rest = self._model.voltage_at_rest(
            value.get("position", np.zeros(())), value.get("pressure_a"), value.get("pressure_b")
        )
        rest = np.where(complete, at_rest, memory.holding_voltage)

        def way(before: Any, *ready: Any) -> dict[str, Any]:
            command, new = self.controller.predict(observation, before)
            wanted_voltage = FULL_VOLTAGE * np.clip(command.astype(np.float64), -1.0, 1.0)[0, 0]
            # The valve keeps its voltage before the first complete sample, and if the command is not a number.
            known = reduce(np.logical_and, (*ready, np.absolute(wanted_voltage) <= FULL_VOLTAGE))
            usable = reduce(np.logical_and, (*sound, known))
            wanted_voltage = np.where(usable, wanted_voltage, kept)
            lost_samples = np.where(np.logical_and(complete, usable), 0, memory.lost_samples + one_more)
            lost_travel = (lost_samples - 1) * (self._period * self._speed_per_volt) * np.absolute(wanted_voltage)
            beyond_own = np.logical_or(lost_travel > LOST_TRAVEL, lost_samples * self._period > LOST_TIME)
            beyond = np.where(lost_limit > 0, lost_samples > lost_limit, beyond_own)
            holding = np.logical_or(still, beyond)
            largest_step = FULL_VOLTAGE * min(self._period / STOPPING_TIME, 1.0)
            stopping_voltage = memory.last_voltage + np.clip(rest - memory.last_voltage, -largest_step, largest_step)
            voltage = np.where(holding, stopping_voltage, wanted_voltage)
            running = np.logical_and(known, np.logical_not(holding))
            own = {"lost_samples": lost_samples, "holding": holding, "last_voltage": voltage}
            return {"voltage": voltage, "running": running, **own, "controller": new}

        common = {"last": held, "computed": computed, "holding_voltage": rest}
        return BothWays(begins, lost, common, way(None, complete), way(memory.controller))

    def _computed(
        self, value: dict[str, Any], memory: MeasuredMemory, start: Any, begins: Any, lost: Any
    ) -> dict[str, Any]:
        """The memory of what follows from the signals; the values that follow are added to those of the signals."""
        s = self.signals
        computed: dict[str, Any] = {}
        if memory.computed:
            goes_on = np.logical_or(np.logical_not(begins), np.logical_and(start, memory.computed["standby"]))
            computed["standby"] = np.logical_and(start, lost < 0.5)
        if "velocity_estimate" in s.used:
            rate = (value["position"] - memory.last[s.places["position"]]) / self._period
            speed = memory.computed["velocity_estimate"]
            smoothed = np.where(goes_on, speed + self._blend * (rate - speed), 0.0)
            computed["velocity_estimate"] = named("velocity_estimate_sample", smoothed)
        if "tracking_error" in s.used or "error_integral" in s.used:
            error = value["reference"] - value["position"]
            value["tracking_error"] = named("tracking_error_sample", error)
        if "error_integral" in s.used:
            integral = memory.computed["error_integral"]
            integral = integral + self._period * (error - integral / self._integral_time)
            integral = np.clip(integral, -self._integral_limit, self._integral_limit)
            computed["error_integral"] = named("error_integral_sample", np.where(goes_on, integral, 0.0))
        value["previous_command"] = named("previous_command_sample", value["previous_voltage"] / FULL_VOLTAGE)
        for name in s.previews:
            preview = value[ahead_name(name, self._period)] - value["reference"]
            value[name] = named(f"{name}_sample", preview)
        value.update(computed)
        return computed

    def _observation(self, value: Mapping[str, Any]) -> Any:
        """The observation of the environment, (1, entries)."""
        s = self.signals
        entries = [np.float32(0.0)] * len(s.layout.names)
        for place, name in enumerate(s.layout.names):
            if name in s.used:
                scaled = np.clip(value[name] / s.scale[place], -s.limits[place], s.limits[place]).astype(np.float32)
                entries[place] = named(name + SCALED, scaled)
        return np.stack(entries)[None]

    def empty(self) -> MeasuredMemory:
        """Memory before the first call: the right shapes, no content."""
        s = self.signals
        computed: dict[str, Floats] = {}
        for name in ("velocity_estimate", "error_integral"):
            if name in s.used:
                computed[name] = np.zeros(())
        if computed:
            computed["standby"] = np.array(False)
        none, zero, never = np.zeros(len(s.signals)), np.zeros(()), np.array(False)
        plain = MeasuredMemory(none, never, np.array(0), never, zero, zero, computed, None)
        observation = np.zeros((1, len(s.layout.names)), dtype=np.float32)
        observation[0] = [0.25 if "pressure" in name else 0.0 for name in s.layout.names]
        _, memory = self.controller.predict(observation, None)
        return plain._replace(controller=memory)

    def __call__(
        self,
        signals: Floats,
        memory: MeasuredMemory | None,
        start: bool = False,
        valid: NDArray[np.bool_] | None = None,
        lost_limit: int = 0,
    ) -> tuple[float, MeasuredMemory]:
        """Voltage, V, for a sample, and the memory for the next one; arguments as :meth:`step`, ``None`` starts."""
        memory = memory if memory is not None else self.empty()
        valid = np.ones(len(self.signals.signals), np.bool_) if valid is None else valid
        with np.errstate(all="ignore"):
            step = self.step(signals, valid, np.array(start), np.array(lost_limit), memory)
        way = dict(step.started if bool(step.begins) else step.continued)
        return float(way.pop("voltage")), MeasuredMemory(**step.common, **way)
