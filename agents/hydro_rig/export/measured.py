"""The signals that a controller reads on a machine, in SI units, and the observation that it would have in training."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from typing import Any, NamedTuple

import numpy as np

from hydro_agents.controllers.base import ObservationLayout, shown_time
from hydro_agents.controllers.own_loop import OUT_OF_RANGE
from hydro_env import ConfigurationError, TaskConfig
from hydro_env.axes import Axes
from hydro_env.task.sensors import CHANNEL_UNITS, CHANNELS
from hydro_env.task.signals import observation_layout
from hydro_rig.export.graph import SCALED
from hydro_rig.export.tracing import named

COMPUTED = ("velocity_estimate", "tracking_error", "error_integral", "previous_command")
"""Entries of the observation that the block computes itself."""

_PREVIEW = "reference_preview_"
SENSOR_MEANINGS = {
    "position": "measured, from the middle of the stroke; positive: extended",
    "pressure_a": "gauge pressure of the chamber on the bore side",
    "pressure_b": "gauge pressure of the chamber on the rod side",
    "spool_position": "of full stroke; positive: extends",
}


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
    """The signals that a controller needs, in SI units, and their relation to the observation.

    Position and reference are always among them.

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

    def inputs_of(self, axes: Axes) -> dict[str, Any]:
        """Inputs of a block by name: the signals of the first simulated axis as its sensors read, all of them valid."""
        now, found = int(axes.column("step")[0]), dict[str, Any]()
        for signal in self.signals:
            if signal.sensor:
                found[signal.name] = float(axes.column("measured")[0, CHANNELS.index(signal.name)])
                found[f"valid_{signal.name}"] = True
            else:
                found[signal.name] = float(axes.reference[0, now + signal.ahead])
        return found

    def observation(self, value: Mapping[str, Any]) -> Any:
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
