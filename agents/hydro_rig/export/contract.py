"""What a block and its user agree on: signals with units, inputs and outputs, states, and the internal reference."""

from collections.abc import Collection, Sequence
from enum import IntEnum
from typing import Any, NamedTuple

import numpy as np

from hydro_agents.controllers.base import MOVING, ObservationLayout, shown_time
from hydro_agents.controllers.own_loop import LOST_TIME, LOST_TRAVEL, OUT_OF_RANGE, STOPPING_TIME
from hydro_env import ConfigurationError, TaskConfig
from hydro_env.axes import Axes
from hydro_env.plant.analysis import closed_port_natural_frequency, speed_limits
from hydro_env.task.paces import full_speed
from hydro_env.task.sensors import CHANNEL_UNITS, CHANNELS
from hydro_env.task.signals import observation_layout
from hydro_env.types import ByName
from hydro_env.units import FULL_VOLTAGE
from hydro_rig.export.graph import SCALED
from hydro_rig.export.tracing import named

COMPUTED = ("velocity_estimate", "tracking_error", "error_integral", "previous_command")  # by the block itself
_PREVIEW = "reference_preview_"
SENSOR_MEANINGS = {
    "position": "measured, from the middle of the stroke; positive: extended",
    "pressure_a": "gauge pressure of the chamber on the bore side",
    "pressure_b": "gauge pressure of the chamber on the rod side",
    "spool_position": "of full stroke; positive: extends",
}
LOST_RULE = (
    f"those in which the axis travels {1e3 * LOST_TRAVEL:g} mm at the present command, at least one, "
    f"and not more than {1e3 * LOST_TIME:g} ms"
)
SPEED_SHARE = 0.5  # of the lower full speed: the usual speed with which the axis joins its reference
ACCELERATING = 35.0  # periods of the oscillation / 2π in which it reaches this speed
LARGEST = 1e9  # m/s, m/s²: no limit


class MeasuredSignal(NamedTuple):
    """A measured signal, or a reference."""

    name: str
    unit: str
    low: float  # ends of the range in training
    high: float
    limit: float  # the controller clips values to ± this; of a future reference: its distance from the present one
    meaning: str
    sensor: bool  # whether a sensor measures it
    ahead: int = 0  # control periods, of a future reference

    @property
    def beyond(self) -> tuple[float, float]:
        """Lowest and highest value; beyond them the signal is lost."""
        margin = OUT_OF_RANGE * (self.high - self.low)
        return self.low - margin, self.high + margin


class MeasuredSignals:
    """The signals that a controller needs, in SI units, and their relation to the observation of a task.

    ``used``: names of the entries of the observation that the controller reads; default: all. Position and reference
    are always among them.

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
        needed = {*self.used, "position", "reference"} - set(COMPUTED)
        rows = [self._signal(name) for name in self.layout.names if name in needed]
        self.signals = tuple(dict.fromkeys(rows))  # two previews may show one sample
        self.horizon = max(signal.ahead for signal in self.signals)

    def _signal(self, name: str) -> MeasuredSignal:
        place = self.layout.index(name)
        limit = float(self.limits[place] * self.scale[place])
        reach = self.config.plant.cylinder.stroke / 2.0
        within = ("m", -reach, reach, limit)
        if name.startswith(_PREVIEW):
            ahead, own = self.ahead[name], ahead_name(name, self.config.control_period)
            return MeasuredSignal(own, *within, f"reference {ahead} control periods ahead", False, ahead)
        if name == "reference":
            return MeasuredSignal(name, *within, "desired position, from the middle of the stroke", False)
        if name not in CHANNELS:
            raise ConfigurationError(f"export: '{name}' of the observation is not a measured signal")
        sensor = getattr(self.config.sensors, name)
        text = SENSOR_MEANINGS.get(name, "measured")
        return MeasuredSignal(name, CHANNEL_UNITS[name], sensor.low, sensor.high, limit, text, True)

    def inputs_of(self, axes: Axes) -> ByName:
        """Inputs of a block by name: the signals of the first simulated axis as its sensors read, all of them valid."""
        now, found = int(axes.column("step")[0]), ByName()
        for signal in self.signals:
            if signal.sensor:
                found[signal.name] = float(axes.column("measured")[0, CHANNELS.index(signal.name)])
                found[f"valid_{signal.name}"] = True
            else:
                found[signal.name] = float(axes.reference[0, now + signal.ahead])
        return found

    def observation(self, value: ByName) -> Any:
        """The observation of the environment, (1, entries), from signals and computed entries by name, SI units."""
        entries = [np.float32(0.0)] * len(self.layout.names)
        for place, name in enumerate(self.layout.names):
            if name in self.used:
                scaled = np.clip(value[name] / self.scale[place], -self.limits[place], self.limits[place])
                entries[place] = named(name + SCALED, scaled.astype(np.float32))
        return np.stack(entries)[None]


def ahead_name(name: str, period: float) -> str:
    """Name of the reference ahead that a preview of the observation shows, with its true time; period in s."""
    time = shown_time(1e-3 * float(name.removeprefix(_PREVIEW).removesuffix("ms")), period)
    return f"reference_in_{1e3 * time:g}ms".replace(".", "_")


class State(IntEnum):
    """States of the block."""

    OFF = 0
    READY = 1
    CONTROLLING = 2
    MANUAL = 3
    HOLDING = 4
    FAULT = 5


class FaultCode(IntEnum):
    """Why the block holds or is in fault; the last one is a warning."""

    NONE = 0
    LOST_SIGNAL = 1
    FOLLOWING_ERROR = 2
    NOT_A_NUMBER = 3
    REFUSED_GAIN = 4


class BlockInput(NamedTuple):
    """An input of the block beside the gains."""

    name: str
    meaning: str
    kind: type = bool
    default: Any = False
    unit: str = ""


OUTPUTS = {
    "command": ("V", "of the valve, within ±10 V; positive: extends"),
    "state": ("", ", ".join(f"{one.value} {one.name.lower()}" for one in State)),
    "fault_code": ("", ", ".join(f"{one.value} {one.name.lower().replace('_', ' ')}" for one in FaultCode)),
    "lost_signals": ("", "sum of 1, 2, 4 … for each lost signal, in the order of the inputs"),
    "internal_reference": ("m", "that the controller follows"),
    "base_command": ("V", "of the controller that the policy corrects"),
    "correction": ("V", "of the policy"),
    "estimated_leak": ("l/min", "past the piston seal at 100 bar"),
    "estimated_flow_gain": ("1", "of the valve, per data sheet"),
    "estimated_offset": ("%", "of full speed, that neither explains"),
}
"""Unit and meaning of each output that a block may have."""


def block_inputs(
    signals: Sequence[MeasuredSignal], max_speed: float, max_acceleration: float, corrects: bool
) -> list[BlockInput]:
    """The inputs of a block beside its gains; the usual limits of an own motion are in m/s and m/s².

    ``corrects``: whether its controller is a policy that corrects another one.
    """
    rows = [
        BlockInput("enable", "FALSE: off"),
        BlockInput("control", "a change to TRUE closes the loop"),
        BlockInput("manual", "a change to TRUE hands the valve to manual_command; before control"),
        BlockInput("reset", "a change to TRUE leaves holding, if no signal is lost, and fault"),
    ]
    for signal in signals:
        rows.append(BlockInput(signal.name, signal.meaning, float, 0.0, signal.unit))
        if signal.sensor:
            text = "its sensor measures: wire, module and bus in order, a number"
            rows.append(BlockInput(f"valid_{signal.name}", text))
    follow = "TRUE: the reference, and those ahead, are a motion; FALSE: reference is a target of the own motion"
    lost = f"successive lost samples that are allowed; 0: {LOST_RULE}"
    rows += [
        BlockInput("follow", f"{follow}. Read when the loop closes"),
        BlockInput("manual_command", "in state manual, such as that of another controller", float, 0.0, "V"),
        BlockInput("output_limit", "largest command in every state", float, FULL_VOLTAGE, "V"),
        BlockInput("output_rate", "largest change; 0: the usual one", float, FULL_VOLTAGE / STOPPING_TIME, "V/s"),
        BlockInput("max_speed", "of the own motion; 0: the usual one", float, max_speed, "m/s"),
        BlockInput("max_acceleration", "of it; 0: the usual one", float, max_acceleration, "m/s^2"),
        BlockInput("error_limit", "following error beyond which it is in fault; 0: none", float, 0.0, "m"),
        BlockInput("lost_limit", lost, int, 0),
    ]
    if corrects:
        text = "largest correction by the policy; 0: the controller that it corrects acts alone"
        rows.append(BlockInput("correction_limit", text, float, 2.0 * FULL_VOLTAGE, "V"))
    return rows


class InternalReference:
    """An own motion to a target, or what is added to a given motion until both are one."""

    def __init__(self, signals: MeasuredSignals) -> None:
        plant = signals.config.plant
        self._signals, self._period = signals, signals.config.control_period
        self._full_speed, self._jump = full_speed(plant), max(speed_limits(plant))
        self.max_speed = SPEED_SHARE * min(speed_limits(plant))  # usual speed of an own motion, m/s
        self.max_acceleration = self.max_speed * closed_port_natural_frequency(plant) / ACCELERATING
        """Its usual acceleration, m/s²."""

    def add(self, value: ByName, new: ByName, inputs: ByName, memory: Any, begins: Any) -> None:
        """The reference that the controller sees: it starts at the axis, with its speed, and joins the given one.

        What is added to a given motion goes to 0; an own motion goes to its target. Both end exactly there.
        """
        period, horizon = self._period, self._signals.horizon
        follows = new["follows"] = np.where(begins, inputs["follow"], memory.follows)
        measured = value["velocity_estimate"]
        speed = np.where(np.absolute(measured) > MOVING * self._full_speed, measured, 0.0)
        later = [signal for signal in self._signals.signals if signal.ahead]
        if later:
            first = min(later, key=lambda signal: signal.ahead)
            given_speed = (value[first.name] - value["reference"]) / (first.ahead * period)
            is_speed = follows & (np.absolute(given_speed) <= self._jump)
            speed = speed - np.where(is_speed, given_speed, 0.0)
        start = value["position"] - np.where(follows, value["reference"], 0.0)
        target = np.where(follows, 0.0, value["reference"])
        limits = self._limits(inputs)
        at_once = self._arrives(target - start, speed, *limits)  # such as an axis that rests on its reference
        start, speed = np.where(at_once, target, start), np.where(at_once, 0.0, speed)
        fresh_path = start + speed * (period * np.arange(horizon + 1.0))
        end, end_speed = self._step_towards(target, memory.path[horizon], memory.path_speed, *limits)
        moved_path = np.concatenate([memory.path[1:], end.reshape(1)])
        path = new["path"] = np.where(begins, fresh_path, moved_path)
        new["path_speed"] = np.where(begins, speed, end_speed)
        for signal in self._signals.signals:
            if not signal.sensor:
                given = np.where(follows, value[signal.name], 0.0)
                value[signal.name] = named(f"internal_{signal.name}", path[signal.ahead] + given)
        for name in self._signals.previews:
            preview = value[ahead_name(name, period)] - value["reference"]
            value[name] = named(f"{name}_sample", preview)

    def _limits(self, inputs: ByName) -> tuple[Any, Any]:
        speed, acceleration = (np.minimum(inputs[name], LARGEST) for name in ("max_speed", "max_acceleration"))
        largest_speed = np.where(speed > 0.0, speed, self.max_speed)
        return largest_speed, np.where(acceleration > 0.0, acceleration, self.max_acceleration)

    def _arrives(self, gap: Any, speed: Any, largest_speed: Any, acceleration: Any) -> Any:
        """Whether a point with a speed can be at its target one period later, and at rest another one later."""
        change, needed = acceleration * self._period, gap / self._period
        slow = (np.absolute(needed) <= change) & (np.absolute(needed) <= largest_speed)
        return slow & (np.absolute(needed - speed) <= change)

    def _step_towards(
        self, target: Any, place: Any, speed: Any, largest_speed: Any, acceleration: Any
    ) -> tuple[Any, Any]:
        """Place and speed one period later of a point that comes to rest at a target, in the shortest time."""
        change, gap = acceleration * self._period, target - place
        distance = np.absolute(gap)
        braking = np.sqrt(0.25 * change * change + 2.0 * acceleration * distance) - 0.5 * change
        quick = np.minimum(np.minimum(braking, distance / self._period), largest_speed)
        wanted_speed = np.where(gap < 0.0, -quick, quick)
        changed_speed = speed + np.clip(wanted_speed - speed, -change, change)
        arrives = self._arrives(gap, speed, largest_speed, acceleration)
        end = np.where(arrives, target, place + self._period * changed_speed)
        return end, np.where(arrives, gap / self._period, changed_speed)
