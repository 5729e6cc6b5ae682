"""The measured signals: noise, bias, range and acquisition of each sensor."""

from collections.abc import Mapping
from typing import Any, Literal

from pydantic import Field, model_validator

from hydro_env.errors import at
from hydro_env.files import Group, whole_group
from hydro_env.units import Number, in_si, quantity


class Sensor(Group):
    """One measured signal: white noise, a bias drawn per episode, 16-bit steps, and its range."""

    noise: Number = Field(ge=0.0, le=1e9, description="standard deviation, unit of the signal")
    bias: Number = Field(ge=0.0, le=1e9, description="largest constant error of an episode, unit of the signal")
    resolution: Number = Field(ge=0.0, le=1e9, description="step of the 16-bit acquisition, in that unit; 0 = none")
    low: Number = Field(ge=-1e9, le=1e9, description="lower end of the range, unit of the signal")
    high: Number = Field(ge=-1e9, le=1e9, description="upper end of the range, unit of the signal")
    fitted: bool = Field(True, description="false: rig and observation lack this sensor")

    @whole_group
    def _range_rises(self) -> "Sensor":
        if not self.low < self.high:
            raise ValueError(f"low = {self.low:g} must be below high = {self.high:g}")
        return self


SCALED_FIELDS = tuple(name for name in Sensor.model_fields if name != "fitted")  # in the unit of its signal


def _current_loop(span: float) -> float:
    """Step of a 4–20 mA signal over 500 Ω on a 16-bit converter of ±10 V: 26214 steps for the span."""
    return span / (65536 * 8.0 / 20.0)


CHANNEL_UNITS = {"position": "m", "pressure_a": "Pa", "pressure_b": "Pa", "spool_position": "1"}
"""SI unit of each measured signal."""


def _in_si(channel: str, fields: Mapping[str, Any]) -> dict[str, Any]:
    result = {}
    for name, value in fields.items():
        with at(f"{channel}.{name} = {value!r}"):
            result[name] = in_si(value, CHANNEL_UNITS[channel])
    return result


class Sensors(Group):
    """The measured signals (Table 1 of the paper; noise and bias from data sheets of this class of transducers)."""

    enabled: bool = Field(True, description="false: exact signals, for tests and teaching")
    position: Sensor = Sensor(noise=30e-6, bias=80e-6, resolution=_current_loop(0.4), low=-0.2, high=0.2)
    pressure_a: Sensor = Sensor(noise=0.05e5, bias=0.25e5, resolution=_current_loop(100e5), low=0.0, high=100e5)
    pressure_b: Sensor = Sensor(noise=0.2e5, bias=1.0e5, resolution=_current_loop(400e5), low=0.0, high=400e5)
    spool_position: Sensor = Sensor(noise=1e-3, bias=2e-3, resolution=2.0 / 65536, low=-1.0, high=1.0)
    pressure_rise_time: Number = quantity(1.5e-3, "s", "10–90 % rise of the transducers", 0.0, 0.1)
    pressures_at: Literal["cylinder", "valve"] = Field(
        "cylinder", description="where the pressure transducers sit; differs with waves in the lines"
    )
    differential_pressure: bool = Field(
        False,
        description="true: the transducer of pressure a reads pressure a minus b, and there is none for b; for "
        "recordings: no environment has it",
    )
    velocity_filter_time: Number = quantity(0.010, "s", "first-order filter of the differenced position", 0.0, 1.0)

    @property
    def in_order(self) -> list[Sensor]:
        """The sensors of :data:`SENSORS`."""
        return [getattr(self, name) for name in SENSORS]

    @whole_group
    def _possible(self) -> "Sensors":
        if not self.position.fitted:
            raise ValueError("position.fitted = false: an axis without position sensor cannot follow a reference")
        if self.differential_pressure and (self.pressure_b.fitted or not self.pressure_a.fitted):
            raise ValueError("differential_pressure: true needs pressure_a.fitted: true and pressure_b.fitted: false")
        return self

    @model_validator(mode="before")
    @classmethod
    def _complete(cls, values: Any) -> Any:
        """Fill the missing fields of a sensor with its defaults; a field may be written with a unit."""
        if not isinstance(values, Mapping):
            return values
        return {
            name: cls.model_fields[name].default.model_dump() | _in_si(name, value)
            if isinstance(value, Mapping) and name in CHANNEL_UNITS
            else value
            for name, value in values.items()
        }


CHANNELS = tuple(CHANNEL_UNITS)  # names of the measured signals

SENSORS = ("position", "pressure_a", "pressure_b", "spool_position")
"""Sensors that estimator, detectors, recordings and exports read; windows of signals hold them in this order, and then
the command. A further channel does not concern them."""

POSITION, PRESSURE_A, PRESSURE_B, SPOOL, COMMAND = range(len(SENSORS) + 1)  # rows of a window of signals
SENSOR_COLUMNS = [CHANNELS.index(name) for name in SENSORS]  # in arrays with a column per channel
