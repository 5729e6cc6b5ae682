"""The reference that a controller in a block sees: from the axis to the given one, without a jump."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from hydro_agents.controllers.base import MOVING
from hydro_env.plant.analysis import closed_port_natural_frequency, speed_limits
from hydro_env.task.paces import full_speed
from hydro_rig.export.contract import MeasuredSignals, ahead_name
from hydro_rig.export.tracing import named

SPEED_SHARE = 0.5  # of the lower full speed: the usual speed with which the axis joins its reference
ACCELERATING = 35.0  # periods of the oscillation / 2π in which it reaches this speed

LARGEST = 1e9  # m/s, m/s²: no limit


class InternalReference:
    """An own motion to a target, or what is added to a given motion until both are one."""

    def __init__(self, signals: MeasuredSignals) -> None:
        plant = signals.config.plant
        self._signals, self._period = signals, signals.config.control_period
        self._full_speed, self._jump = full_speed(plant), max(speed_limits(plant))
        self.max_speed = SPEED_SHARE * min(speed_limits(plant))
        """Usual speed of an own motion, m/s."""
        self.max_acceleration = self.max_speed * closed_port_natural_frequency(plant) / ACCELERATING
        """Its usual acceleration, m/s²."""

    def add(
        self, value: dict[str, Any], new: dict[str, Any], inputs: Mapping[str, Any], memory: Any, begins: Any
    ) -> None:
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

    def _limits(self, inputs: Mapping[str, Any]) -> tuple[Any, Any]:
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
