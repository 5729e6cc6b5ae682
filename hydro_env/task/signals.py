"""The measured signals, and the observation.

To add a measured signal, add a ``Sensor`` to :class:`~hydro_env.task.sensors.Sensors`, its true value to
:func:`sample`, and its row and value to :func:`_entries` and :func:`write_observation`; CONTRIBUTING shows every line.
"""

import math
from collections.abc import Sequence

import numpy as np

from hydro_env.compiling import inline, named_tuple
from hydro_env.task.configuration import TaskConfig
from hydro_env.task.fault_effects import lost_or_frozen, misread
from hydro_env.task.law import RigLaw
from hydro_env.task.paces import full_speed, pace
from hydro_env.task.random_numbers import between, noise_pair
from hydro_env.task.record import table
from hydro_env.task.sensors import CHANNELS
from hydro_env.task.settings import ERROR_INTEGRAL_LIMIT
from hydro_env.types import Array, Floats

POSITION, PRESSURE_A, PRESSURE_B, SPOOL_POSITION = (
    CHANNELS.index(name) for name in ("position", "pressure_a", "pressure_b", "spool_position")
)

FIRST_BIAS = 1_000_000_000  # index of the first bias among the numbers of the noise key, far beyond those of the steps
Signals = named_tuple("Signals", CHANNELS, __name__)  # one value per measured signal


def _entries(half: float) -> tuple[tuple[str, str, float, float], ...]:
    """Name, unit, scale and largest absolute value of each entry except the previews; ``half``: half stroke, m."""
    return (
        ("reference", "m", 0.1, 1.5 * half),
        ("position", "m", 0.1, 1.5 * half),
        ("velocity_estimate", "m/s", 0.1, 2.0),
        ("pressure_a", "Pa", 50e5, 400e5),
        ("pressure_b", "Pa", 50e5, 400e5),
        ("spool_position", "1", 1.0, 1.0),
        ("previous_command", "1", 1.0, 1.0),
        ("tracking_error", "m", 0.01, 2.5 * half),
        ("error_integral", "m s", 0.001, ERROR_INTEGRAL_LIMIT),
    )


Entries = named_tuple("Entries", [*(name for name, *_ in _entries(1.0)), "constant"], __name__)
"""One value per entry of the observation except the previews, which follow the first entry."""

LAYOUT = np.dtype([("scale", "f8"), ("limit", "f8"), ("preview", "i8"), ("entry", "i8")])
"""One entry: SI units per 1, largest absolute value in the observation, for a preview the periods ahead (else 0), and
for another one its index in :data:`Entries`; a constant is 1 over its scale."""

OWN_ENTRIES = (
    ("reference", "half stroke", 1.5),
    ("position", "half stroke", 1.5),
    ("velocity_estimate", "full speed", 5.0),
    ("pressure_a", "supply pressure", 5.0),
    ("pressure_b", "supply pressure", 5.0),
    ("spool_position", "1", 1.0),
    ("previous_command", "1", 1.0),
    ("tracking_error", "full speed, pace", 1000.0),
    ("error_integral", "full speed, pace squared", 1000.0),
)
"""Name, unit and largest absolute value of each entry of a task that draws its rigs, except previews and data sheet."""

SHEET = (
    "log_periods_per_pace",
    "latency_per_period",
    "log_oscillation_times_pace",
    "log_valve_frequency_times_pace",
    "log_pace",
    "log_full_speed",
    "log_noise_per_travel",
    "area_ratio",
    "edge_ratio",
    "overlap",
    "weight",
    "friction",
    "supply",
    "spool_sensor",
)
"""Entries of the data sheet, all of order 1; :func:`data_sheet` computes them."""

SHEET_LIMIT = 10.0


Layout = tuple[tuple[str, ...], tuple[str, ...], Floats, Floats]


def observation_layout(config: TaskConfig) -> Layout:
    """Names, units, scales (SI per 1 of the observation) and largest absolute values (in the observation)."""
    if config.law:
        return _own_layout(config, config.law)
    half = 0.5 * config.plant.cylinder.stroke
    reference, *others = _entries(half)
    previews = [(name, "m", 0.01, 2.0 * half) for name in _preview_names(config)]
    fitted = [row for row in others if row[0] not in CHANNELS or getattr(config.sensors, row[0]).fitted]
    names, units, scale, largest = zip(reference, *previews, *fitted, strict=True)
    return names, units, np.array(scale), np.array(largest) / np.array(scale)


def _preview_names(config: TaskConfig) -> list[str]:
    return [f"reference_preview_{1e3 * time:g}ms" for time in config.references.preview_times]


def _own_layout(config: TaskConfig, law: RigLaw) -> Layout:
    """The layout of a task that draws its rigs: the observation is in units of the rig, its scale is 1."""
    reference, *others = OWN_ENTRIES
    ahead = [f"reference_preview_{paces:g}_paces" for paces in law.preview_paces] or _preview_names(config)
    previews = [(name, "full speed, pace", 1000.0) for name in ahead]
    sheet = [(name, "1", SHEET_LIMIT) for name in SHEET] if law.sheet else []
    names, units, largest = zip(reference, *previews, *others, *sheet, strict=True)
    return names, units, np.ones(len(names)), np.array(largest)


def data_sheet(config: TaskConfig) -> dict[str, float]:
    """The nameplate of a rig as numbers of order 1, by the names of :data:`SHEET`."""
    from hydro_env.plant.analysis import closed_port_natural_frequency, full_pressure_forces  # compiled code

    plant, period, own = config.plant, config.control_period, pace(config)
    speed, weakest = full_speed(plant), min(full_pressure_forces(plant))
    cylinder, valve, noise = plant.cylinder, plant.valve, config.sensors.position
    area_a = cylinder.bore_diameter**2 - cylinder.rod_diameter_a**2
    values = {
        "log_periods_per_pace": math.log(own / period),
        "latency_per_period": config.command_latency / period,
        "log_oscillation_times_pace": math.log(closed_port_natural_frequency(plant) * own),
        "log_valve_frequency_times_pace": math.log(valve.natural_frequency * own),
        "log_pace": math.log(own / 0.01),
        "log_full_speed": math.log(speed / 0.3),
        "log_noise_per_travel": math.log(max(noise.noise, noise.resolution, 1e-9) / (speed * own)) / 4.0,
        "area_ratio": (cylinder.bore_diameter**2 - cylinder.rod_diameter**2) / area_a,
        "edge_ratio": valve.edge_ratio,
        "overlap": 20.0 * valve.overlap,
        "weight": 3.0 * plant.load.external_force / weakest,
        "friction": 20.0 * plant.friction.coulomb_force / weakest,
        "supply": plant.supply.pressure / 100e5,
        "spool_sensor": config.sensors.spool_position.fitted,
    }
    return {name: np.clip(values[name], -SHEET_LIMIT, SHEET_LIMIT) for name in SHEET}


def layout_of(config: TaskConfig, law: RigLaw | None = None) -> Array:
    """The layout of the observation for compiled code, one row (:data:`LAYOUT`) per entry.

    With a law the task is that on one of the rigs that the law draws.
    """
    names, units, scale, limit = _own_layout(config, law) if law else observation_layout(config)
    layout = table(len(scale), LAYOUT)
    layout["limit"] = limit
    layout["preview"][1 : 1 + len(config.preview_samples)] = config.preview_samples
    layout["entry"] = [Entries._fields.index(name) if name in Entries._fields else 0 for name in names]
    if law:
        scale = _own_scale(config, names, units)
        if not config.sensors.spool_position.fitted:  # the best substitute
            layout["entry"][names.index("spool_position")] = Entries._fields.index("previous_command")
        layout["entry"][np.isin(names, SHEET)] = Entries._fields.index("constant")
    layout["scale"] = scale
    return layout


def _own_scale(config: TaskConfig, names: Sequence[str], units: Sequence[str]) -> Floats:
    """SI units per 1 of each entry of a drawn rig's observation; for the data sheet, one over the value."""
    speed, own = full_speed(config.plant), pace(config)
    scales = {
        "half stroke": 0.5 * config.plant.cylinder.stroke,
        "full speed": speed,
        "supply pressure": config.plant.supply.pressure,
        "full speed, pace": speed * own,
        "full speed, pace squared": speed * own * own,
        "1": 1.0,
    }
    sheet = {name: 1.0 / value if value else math.inf for name, value in data_sheet(config).items()}
    return np.array([sheet.get(name, scales[unit]) for name, unit in zip(names, units, strict=True)])


@inline
def draw_biases(row, settings):
    """Draw the constant error of each sensor for this episode; exact sensors have none."""
    for channel in range(len(CHANNELS)):
        largest = settings.channels[channel].bias if settings.sensors.enabled else 0.0
        row.bias[channel] = largest * between(row.noise_key, FIRST_BIAS + channel, -1.0, 1.0)


@inline
def _quantised(value, resolution):
    return math.floor(value / resolution + 0.5) * resolution if resolution > 0.0 else value


@inline
def sensor_reading(true, bias, noise, sensor):
    """Value from the acquisition: true value plus bias and noise, limited to the range, in 16-bit steps."""
    value = min(max(true + bias + sensor.noise * noise, sensor.low), sensor.high)
    return min(max(sensor.low + _quantised(value - sensor.low, sensor.resolution), sensor.low), sensor.high)


@inline
def lagged(sensed, old, new, settings):
    """Signal of a transducer after a period in which its pressure changed linearly: exact for a first-order lag."""
    slope = settings.pressure_lag * (new - old)
    lagging = sensed - old + slope
    return new - slope + settings.pressure_decay * lagging


@inline
def sample(row, s, settings):
    """Read all sensors at this instant into the record; ``s`` is the state."""
    signals = Signals(
        position=s.position, pressure_a=row.sensed_a, pressure_b=row.sensed_b, spool_position=s.spool_position
    )
    for first in range(0, len(CHANNELS), 2):
        noise = noise_pair(row.noise_key, np.int64(row.step), first // 2) if settings.sensors.enabled else (0.0, 0.0)
        for channel in range(first, min(first + 2, len(CHANNELS))):
            sensor = settings.channels[channel]
            value = signals[channel]
            if row.faulty > 0.0:
                value = misread(value, channel, row, sensor)
            if settings.sensors.enabled:
                value = sensor_reading(value, row.bias[channel], noise[channel - first], sensor)
            if row.faulty > 0.0:
                value = lost_or_frozen(value, channel, row, sensor)
            row.measured[channel] = value


@inline
def follow_motion(row, before, settings):
    """Velocity estimate and error integral one control period later; ``before`` is the position measured then, m."""
    period = settings.control_period
    rate = (row.measured[POSITION] - before) / period
    row.velocity_estimate += settings.velocity_blend * (rate - row.velocity_estimate)
    error = row.reference - row.measured[POSITION]
    integral = row.error_integral + period * (error - row.error_integral / settings.integral_time)
    row.error_integral = min(max(integral, -settings.integral_limit), settings.integral_limit)


@inline
def write_observation(observation, row, reference, layout):
    """One row of the observation: physical values over their fixed scale, inside the bounds of the Box."""
    step = np.int64(row.step)
    now = reference[step]
    values = Entries(
        reference=now,
        position=row.measured[POSITION],
        velocity_estimate=row.velocity_estimate,
        pressure_a=row.measured[PRESSURE_A],
        pressure_b=row.measured[PRESSURE_B],
        spool_position=row.measured[SPOOL_POSITION],
        previous_command=row.command,
        tracking_error=now - row.measured[POSITION],
        error_integral=row.error_integral,
        constant=1.0,
    )
    for place in range(observation.shape[0]):
        ahead = layout[place].preview
        value = reference[step + ahead] - now if ahead > 0 else values[layout[place].entry]
        observation[place] = min(max(value / layout[place].scale, -layout[place].limit), layout[place].limit)
