"""A task as numbers for compiled code, under the names of the configuration's fields."""

import math
from collections.abc import Sequence
from typing import Any, Literal, get_args, get_origin

import numpy as np

from hydro_env.errors import ConfigurationError
from hydro_env.files import Group
from hydro_env.plant.parameters import PARAMETER_PATHS, PlantParameters
from hydro_env.task.configuration import TaskConfig
from hydro_env.task.faults import FAULT_KINDS, FAULTS, KIND_OF_FAULT, SIGNED_KINDS, Faults, SensorFault
from hydro_env.task.randomisation import own_value
from hydro_env.task.record import numbers, table
from hydro_env.task.reference_signals import REFERENCE_FAMILIES
from hydro_env.task.sensors import CHANNELS, Sensor
from hydro_env.types import Array

ERROR_INTEGRAL_TIME = 0.5  # s; time constant of the observed leaky integral of the error
ERROR_INTEGRAL_LIMIT = 0.010  # m s; the observed integral saturates here


def _kind_of(annotation: Any) -> Any:
    """Type that stores a field of the configuration: a number, the index of a choice, a group; None if not stored."""
    if isinstance(annotation, type) and issubclass(annotation, Group):
        return None if annotation in (PlantParameters, Faults) else _kind_of_group(annotation)
    if annotation is float:
        return "f8"
    if annotation is bool or get_origin(annotation) is Literal:
        return "i8"
    entries = get_args(annotation) if get_origin(annotation) is tuple else ()
    return ("f8", (len(entries),)) if entries and Ellipsis not in entries else None


def _kind_of_group(group: type[Group]) -> np.dtype[Any]:
    kinds = {name: _kind_of(info.annotation) for name, info in group.model_fields.items()}
    return np.dtype([(name, kind) for name, kind in kinds.items() if kind is not None])


def _values_of(settings: Group, kind: np.dtype[Any]) -> tuple[Any, ...]:
    values = []
    for name in kind.names or ():
        value = getattr(settings, name)
        if isinstance(value, str):
            value = choice(type(settings), name, value)
        values.append(_values_of(value, kind[name]) if isinstance(value, Group) else value)
    return tuple(values)


def choice(group: type[Group], field: str, value: str) -> int:
    """Index of a choice of a field, by which compiled code identifies it."""
    return get_args(group.model_fields[field].annotation).index(value)


FAULT_TABLE = np.dtype(
    [
        *numbers("probability", "low", "high"),
        ("signed", "i8"),
        ("schedule", "i8"),
        *numbers("start_low", "start_high"),
        ("first", "i8"),  # indices of FAULTS: from the first of this kind to before the last
        ("last", "i8"),
        ("sensors", "f8"),  # number of sensors that may fail, 1 for other faults
        ("allowed", "f8", (len(CHANNELS),)),
    ]
)
"""One kind of fault."""

_TASK, _SENSOR = _kind_of_group(TaskConfig), _kind_of_group(Sensor)
_DERIVED = np.dtype(
    [
        ("steps", "f8"),
        ("samples", "i8"),  # of the reference, preview included
        ("class_limits", "f8", (3,)),  # l/min at 100 bar; a leak's class is the number of limits that it exceeds
        ("latency_range", "f8", (2,)),  # s
        *numbers(
            "start_bias_share",  # fraction of the position sensor's bias as initial offset from the reference
            "reward_bias_share",  # fraction of that bias that the reward does not count as error
        ),
        ("error_scales", "f8", (len(REFERENCE_FAMILIES),)),  # m, error that costs 1, of each family
        ("channels", _SENSOR, (len(CHANNELS),)),  # the sensors in the order of CHANNELS
        ("fault_table", FAULT_TABLE, (len(FAULT_KINDS),)),
        *numbers(
            "pressure_decay",  # exp(−T/τ) of the transducers
            "pressure_lag",  # τ/T
            "velocity_blend",  # T/(T + τ)
            "integral_time",
            "integral_limit",
        ),
    ]
)
SETTINGS = np.dtype(_TASK.descr + _DERIVED.descr)  # every number, choice and range of TaskConfig, and derived values


def settings_of(config: TaskConfig) -> Array:
    """The numbers of a task, shape (1,), fields as in :data:`SETTINGS`."""
    period, sensors = config.control_period, config.sensors
    # The 10–90 % rise of a first-order lag is τ ln 9. Exact sensors have no lag.
    rise = sensors.pressure_rise_time / math.log(9.0) if sensors.enabled else 0.0
    derived = {
        "steps": config.steps,
        "samples": config.steps + 1 + max(config.preview_samples, default=0),
        # Conversion from a resistance rounds a flow, which may then exceed the bound of its class slightly.
        "class_limits": np.array(config.leakage.class_bounds) * (1 + 1e-9),
        "latency_range": config.command_latency_range or (config.command_latency,) * 2,
        "start_bias_share": config.start == "measured",
        "reward_bias_share": config.reward.frame == "sensor",
        "error_scales": [
            config.reward.error_scale * config.reward.family_scale.get(name, 1.0) for name in REFERENCE_FAMILIES
        ],
        "channels": [_values_of(getattr(sensors, channel), _SENSOR) for channel in CHANNELS],
        "fault_table": [_fault_row(config.faults, kind) for kind in FAULT_KINDS],
        "pressure_decay": math.exp(-period / rise) if rise > 0.0 else 0.0,
        "pressure_lag": rise / period,
        "velocity_blend": period / (period + sensors.velocity_filter_time),
        "integral_time": ERROR_INTEGRAL_TIME,
        "integral_limit": ERROR_INTEGRAL_LIMIT,
    }
    settings = table(1, SETTINGS)
    for name, value in zip(_TASK.names or (), _values_of(config, _TASK), strict=True):
        settings[name] = value
    for name in _DERIVED.names or ():
        settings[name] = np.array(derived[name], _DERIVED[name].base)
    return settings


def _fault_row(faults: Faults, kind: str) -> tuple[Any, ...]:
    fault = getattr(faults, kind)
    entries = [index for index, name in enumerate(FAULTS) if KIND_OF_FAULT[name] == kind]
    hit = [name in fault.sensors if isinstance(fault, SensorFault) else name == CHANNELS[0] for name in CHANNELS]
    return (
        fault.probability,
        *fault.range,
        kind in SIGNED_KINDS,
        choice(type(fault), "schedule", fault.schedule),
        *fault.start_range,
        entries[0],
        entries[-1] + 1,
        sum(hit),
        hit,
    )


DRAW = np.dtype(
    [
        ("parameter", "i8"),  # index into PARAMETER_PATHS
        ("logarithmic", "i8"),
        *numbers("low", "high"),
        ("times", "i8"),  # index of the parameter that multiplies the draw, −1 for none
        *numbers("otherwise", "otherwise_probability"),
    ]
)
"""Distribution of one parameter of the plant."""


def padded_draws(tasks: Sequence[TaskConfig]) -> Array:
    """The rows of :func:`draws_of` of each task, (tasks, most drawn parameters); parameter −1 ends a shorter list."""
    rows = [draws_of(task) for task in tasks]
    padded = table(len(rows) * max(map(len, rows)), DRAW).reshape(len(rows), -1)
    padded["parameter"] = -1
    for number, row in enumerate(rows):
        padded[number, : len(row)] = row
    return padded


def draws_of(config: TaskConfig) -> Array:
    """One row (:data:`DRAW`) per randomised parameter; a parameter that multiplies another comes before it.

    Raises:
        ConfigurationError: parameters multiply each other in a circle.
    """
    pending = dict(config.randomisation)
    order = []
    while pending:
        ready = [path for path, d in pending.items() if d.times not in pending or d.times == path]
        if not ready:
            raise ConfigurationError("task: randomisation: 'times' runs in a circle")
        order += ready
        for path in ready:
            del pending[path]
    rows = table(len(order), DRAW)
    for row, path in enumerate(order):
        d = config.randomisation[path]
        low, high = d.bounds(own_value(config.plant, path))
        rows[row] = (
            PARAMETER_PATHS.index(path),
            d.logarithmic and low > 0.0,  # any multiple of 0 is 0
            low,
            high,
            PARAMETER_PATHS.index(d.times) if d.times else -1,
            d.otherwise or 0.0,
            d.otherwise_probability,
        )
    return rows
