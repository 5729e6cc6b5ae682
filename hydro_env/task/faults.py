"""Faults other than the leak past the piston: of valve, sensors, return line and rod seal.

Each kind occurs with a probability, has a magnitude within a range and a schedule; all are drawn per episode. The
observation does not show them; ``info["faults"]`` does. To add a fault, add a class with its range, a field of
:class:`Faults`, and its effect in :mod:`hydro_env.task.fault_effects`.
"""

from collections.abc import Sequence
from typing import Annotated, Literal

from pydantic import Field

from hydro_env.files import Group
from hydro_env.mistakes import known_name
from hydro_env.task.sensors import CHANNELS, SENSORS
from hydro_env.units import Number, Range, interval


class Fault(Group):
    """One kind of fault: probability and time; its subclasses define the magnitude."""

    probability: Number = Field(0.0, ge=0.0, le=1.0, description="share of episodes with this fault")
    schedule: Literal["constant", "onset", "growth", "mixed"] = Field(
        "constant",
        description="constant; a sudden onset; growth (linear) from none to the end of the episode; mixed: one of the "
        "three, drawn per episode",
    )
    start_range: Range = interval((0.25, 0.75), "1", 0.0, 1.0, "onset or start of growth, as a share of the episode")


class SensorFault(Fault):
    """A fault of one randomly chosen sensor."""

    sensors: tuple[Annotated[str, known_name(CHANNELS, "sensor")], ...] = Field(
        SENSORS, min_length=1, description="sensors that may fail, with equal probability"
    )


class ValveNullShift(Fault):
    """The edges are not centred at the spool's zero; the spool's sensor does not show it."""

    range: Range = interval((0.005, 0.02), "1", 0.0, 0.5, "of full stroke; sign drawn")


class ValveUnderlap(Fault):
    """Worn edges: more oil passes the closed valve."""

    range: Range = interval((0.02, 0.05), "1", 0.0, 0.4, "added to the underlap, of full stroke")


class ValveFlow(Fault):
    """Worn or clogged edges: more or less oil at the same opening."""

    range: Range = interval((0.1, 0.3), "1", 0.0, 0.9, "relative change of the rated flow; sign drawn")


class ValveHysteresis(Fault):
    """The drive follows a command only after it has moved by this much (play): hysteresis and threshold."""

    range: Range = interval((0.005, 0.04), "1", 0.0, 1.0, "width, as a fraction of full command")


class TankPressure(Fault):
    """A clogged return line."""

    range: Range = interval((2e5, 8e5), "Pa", 0.0, 5e6, "added to the tank pressure")


class ExternalLeak(Fault):
    """A worn rod seal: oil from chamber b to the outside."""

    range: Range = interval((0.3, 2.0), "l/min", 0.0, 20.0, "at 100 bar")


class SensorOffset(SensorFault):
    """The reading differs from the true value by a constant."""

    range: Range = interval((0.005, 0.03), "1", 0.0, 1.0, "of the sensor's range; sign drawn")


class SensorGain(SensorFault):
    """The reading is a multiple of the true value."""

    range: Range = interval((0.01, 0.05), "1", 0.0, 0.9, "relative change; sign drawn")


class SensorFreeze(SensorFault):
    """The reading no longer changes."""

    range: Range = interval((1.0, 1.0), "1", 0.0, 1.0, "1: the sensor is frozen")


class SensorDropout(SensorFault):
    """Some samples are lost: the sensor reads the lower end of its range, like a broken 4–20 mA loop."""

    range: Range = interval((0.02, 0.2), "1", 0.0, 1.0, "share of samples")


class Faults(Group):
    """The possible faults of an episode; none by default. Each is drawn independently: several may occur together."""

    valve_null_shift: ValveNullShift = ValveNullShift()
    valve_underlap: ValveUnderlap = ValveUnderlap()
    valve_flow: ValveFlow = ValveFlow()
    valve_hysteresis: ValveHysteresis = ValveHysteresis()
    tank_pressure: TankPressure = TankPressure()
    external_leak: ExternalLeak = ExternalLeak()
    sensor_offset: SensorOffset = SensorOffset()
    sensor_gain: SensorGain = SensorGain()
    sensor_freeze: SensorFreeze = SensorFreeze()
    sensor_dropout: SensorDropout = SensorDropout()


FAULT_KINDS = tuple(Faults.model_fields)  # names of the kinds
SIGNED_KINDS = ("valve_null_shift", "valve_flow", "sensor_offset", "sensor_gain")  # their size may be negative


def faults_of(kind: str, sensors: Sequence[str] = CHANNELS) -> list[str]:
    """Names of the faults of a kind; of a kind that affects sensors, one for each of ``sensors``."""
    if not kind.startswith("sensor_"):
        return [kind]
    return [f"{channel}_{kind.removeprefix('sensor_')}" for channel in sensors]


FAULTS = tuple(name for kind in FAULT_KINDS for name in faults_of(kind))
"""Every single fault; those of sensors with the name of the sensor: ``position_offset``, ``pressure_a_freeze``, …"""

KIND_OF_FAULT = {name: kind for kind in FAULT_KINDS for name in faults_of(kind)}  # kind of each fault


def fault_limits(name: str) -> tuple[float, float]:
    """Smallest and largest allowed magnitude of a fault."""
    kind = KIND_OF_FAULT[name]
    extra = type(getattr(Faults(), kind)).model_fields["range"].json_schema_extra
    return (-extra["high"] if kind in SIGNED_KINDS else 0.0), extra["high"]
