"""The measured signals that a controller needs, in SI units, and their computation from the environment."""

from __future__ import annotations

from collections.abc import Collection
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from hydro_agents.controllers.base import ObservationLayout
from hydro_env import ConfigurationError, TaskConfig
from hydro_env.axes import Axes
from hydro_env.task.sensors import CHANNEL_UNITS, CHANNELS
from hydro_env.task.signals import observation_layout
from hydro_env.units import FULL_VOLTAGE

Array = NDArray[np.float64]
COMPUTED = ("velocity_estimate", "tracking_error", "error_integral")
"""Entries of the observation that follow from measured signals."""

_PREVIEW = "reference_preview_"
_MEANINGS = {
    "position": "measured, from the middle of the stroke; positive: extended",
    "pressure_a": "gauge pressure of the chamber on the bore side",
    "pressure_b": "gauge pressure of the chamber on the rod side",
    "spool_position": "of full stroke; positive: extends",
}


class Signal(NamedTuple):
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
        self.previews = [name for name in self.used if name.startswith(_PREVIEW)]
        needed = {*self.used, "previous_command"}
        if needed & set(COMPUTED):
            needed |= {"position"}
        if needed & {"tracking_error", "error_integral", *self.previews}:
            needed |= {"reference"}
        self.signals = tuple(self._signal(name) for name in self.layout.names if name in needed - set(COMPUTED))
        self.places = {signal.name: place for place, signal in enumerate(self.signals)}

    def _signal(self, name: str) -> Signal:
        place = self.layout.index(name)
        limit = float(self.limits[place] * self.scale[place])
        reach = self.config.plant.cylinder.stroke / 2.0
        if name.startswith(_PREVIEW):
            shown = [one for one in self.layout.names if one.startswith(_PREVIEW)]
            ahead = dict(zip(shown, self.config.preview_samples, strict=True))[name]
            return Signal(ahead_name(name), "m", -reach, reach, limit, f"reference {ahead} control periods ahead")
        if name == "reference":
            return Signal(name, "m", -reach, reach, limit, "desired position now, from the middle of the stroke")
        if name == "previous_command":
            text = "voltage that the valve received in the last control period"
            return Signal("previous_voltage", "V", -FULL_VOLTAGE, FULL_VOLTAGE, FULL_VOLTAGE, text)
        if name not in CHANNELS:
            raise ConfigurationError(f"export: '{name}' of the observation is not a measured signal")
        sensor = getattr(self.config.sensors, name)
        return Signal(name, CHANNEL_UNITS[name], sensor.low, sensor.high, limit, _MEANINGS.get(name, "measured"))

    def of_observation(self, observation: NDArray[Any]) -> Array:
        """Signals (N, signals) for observations (N, n), with the readings as rounded by the environment.

        Readings of the position are whole steps of the sensor. The tracking error gives the reference with a finer
        resolution than the observed reference.
        """
        si = {name: self.layout.si(observation, name) for name in self.layout.names}
        sensor = self.config.sensors.position
        if self.config.sensors.enabled and sensor.resolution > 0.0:
            steps = np.round((si["position"] - sensor.low) / sensor.resolution)
            si["position"] = np.clip(sensor.low + steps * sensor.resolution, sensor.low, sensor.high)
        observed = observation[:, self.layout.index("reference")].astype(np.float32)
        exact = observed.astype(np.float64)
        low, high = (exact + 0.499 * (np.nextafter(observed, np.float32(end)) - exact) for end in (-np.inf, np.inf))
        scale = self.scale[self.layout.index("reference")]
        si["reference"] = np.clip(si["position"] + si["tracking_error"], low * scale, high * scale)
        return self._stacked(si, {name: si["reference"] + si[name] for name in self.previews})

    def of_axes(self, axes: Axes) -> Array:
        """Signals (N, signals) of simulated axes, exactly as their sensors read."""
        now = np.asarray(axes.column("step"), dtype=np.int64)
        row = np.arange(axes.count)
        si = {name: axes.column("measured")[:, place] for place, name in enumerate(CHANNELS)}
        si |= {"reference": axes.reference[row, now], "previous_command": axes.column("command")}
        shown = [name for name in self.layout.names if name.startswith(_PREVIEW)]
        counts = dict(zip(shown, self.config.preview_samples, strict=True))
        return self._stacked(si, {name: axes.reference[row, now + counts[name]] for name in self.previews})

    def _stacked(self, si: dict[str, Array], ahead: dict[str, Array]) -> Array:
        values = si | {ahead_name(name): reference for name, reference in ahead.items()}
        values["previous_voltage"] = FULL_VOLTAGE * si["previous_command"]
        return np.stack([values[signal.name] for signal in self.signals], axis=1)


def ahead_name(name: str) -> str:
    """Name of the reference ahead that a preview of the observation shows."""
    return f"reference_in_{name.removeprefix(_PREVIEW).replace('.', '_')}"
