"""A task on another rig: content of a rig's file, and settings of a task that follow from a rig."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

from hydro_env.errors import ConfigurationError, at
from hydro_env.files import ModelType, read_yaml, validate
from hydro_env.folders import config_file, config_folder
from hydro_env.plant.parameters import PlantParameters
from hydro_env.task.randomisation import (
    LEAKAGE_OF_THE_TASK,
    Distribution,
    Randomisation,
    check_draws,
    default_randomisation,
    own_value,
)
from hydro_env.task.sensors import SCALED_FIELDS, Sensors
from hydro_env.types import ByName

USUAL_RANGES = (100e5, 160e5, 250e5, 400e5, 600e5, 1000e5)  # Pa; upper ends of the ranges of pressure sensors on sale
SHARE_OF_ACCELERATION = 0.25  # of what the supply can give: largest acceleration of smooth references


Values = Mapping[str, Any]  # settings by name


class Rig(NamedTuple):
    """A rig: the parameters of its data sheet, ranges for the uncertain ones, and its sensors."""

    plant: PlantParameters
    randomisation: dict[str, Distribution]
    sensors: ByName  # settings in its file, by path: ``sensors.pressure_a.high``
    source: str  # for messages


class _RigFile(PlantParameters):
    """All that the file of a rig may hold."""

    randomisation: Randomisation = {}
    sensors: Sensors = Sensors()


def read_rig(given: str | Path, folder: Path | None = None) -> Rig:
    """A rig by its name in ``configs/rigs`` or by the path of its file, relative to ``folder``.

    Raises:
        ConfigurationError: the rig does not exist, or its file is unreadable or wrong (:func:`rig_from`).
    """
    file = config_file("rigs", given, folder)
    return rig_from(read_yaml(file), str(file))


def rig_from(values: Values, source: str) -> Rig:
    """A rig from the groups of its file.

    Raises:
        ConfigurationError: a key is unknown, a value is impossible, or the rig cannot work.
    """
    from hydro_env.plant.workable import refuse_unworkable  # compiled code, needed only for a rig from a file

    checked = validate(_RigFile, values, source)
    plant = PlantParameters(**{name: getattr(checked, name) for name in PlantParameters.model_fields})
    refuse_unworkable(plant, source)
    with at(source):
        check_draws(default_randomisation(plant) | checked.randomisation, plant)
    sensors: ByName = {}
    for name, given in values.get("sensors", {}).items():
        own = getattr(checked.sensors, name)
        if isinstance(given, Mapping):
            sensors |= {f"sensors.{name}.{field}": getattr(own, field) for field in given}
        else:
            sensors[f"sensors.{name}"] = own
    return Rig(plant, checked.randomisation, sensors, source)


DRAWN = ("plant", "control_period", "command_latency", "command_latency_range")  # a law draws them with the rig


def law_of(given: str | Path) -> ByName | None:
    """The law from which rigs are drawn: of a name in ``configs/laws``, or in a file; ``None``: it is one rig.

    Raises:
        ConfigurationError: the file does not exist or is unreadable, or holds a law and something else.
    """
    laws = {file.stem: file for file in (config_folder() / "laws").glob("*.yaml")}
    file = laws.get(str(given)) or config_file("rigs", given)
    values = read_yaml(file)
    if "law" not in values:
        return None
    if not isinstance(values["law"], Mapping) or len(values) > 1:
        raise ConfigurationError(f"{file}: a law is a mapping, and stands alone")
    return dict(values["law"])


def _at(values: Values, path: str) -> Any:
    """The value at a path ``group.field`` of nested groups."""
    value = values
    for part in path.split("."):
        value = value[part]
    return value


def task_from(
    model: type[ModelType],
    values: Values,
    source: str,
    folder: Path | None,
    rig: str | Path | None = None,
    overrides: Values | None = None,
    within: str = "",
) -> ModelType:
    """A task from its settings, on its own rig or adapted to another one.

    Args:
        model: ``TaskConfig``, which imports this function.
        values: settings by group; ``plant`` may be the name or the path of a rig.
        source: for messages.
        folder: base of relative paths in ``values``; default: the current folder.
        rig: name or path of another rig for the task.
        overrides: settings that come last.
        within: where in the source the settings stand.

    Raises:
        ConfigurationError: a key is unknown, a value is impossible, or the rig does not fit.
    """
    overrides = dict(overrides or {})
    own = values.get("plant")
    if isinstance(own, str | Path):
        rest = {key: value for key, value in values.items() if key != "plant"}
        values = merged(moved(model(), read_rig(own, folder)), rest)
    else:
        values = merged({"randomisation": model().model_dump()["randomisation"]}, values)
    for plant in (own, overrides.get("plant")):
        _refuse_drawn_leak(plant, source)
    if isinstance(overrides.get("plant"), str | Path):
        if rig is not None:
            raise ConfigurationError(
                f"task: rig = {str(rig)[:60]!r} and plant = {str(overrides['plant'])[:60]!r}: give one rig"
            )
        rig = overrides.pop("plant")
    if rig is not None:
        if not isinstance(rig, str | Path):
            raise ConfigurationError(f"task: rig = {str(rig)[:60]!r}: must be the name or the YAML file of a rig")
        law = law_of(rig)
        if law is None and overrides.get("law") is not None:
            raise ConfigurationError(f"task: rig = {str(rig)[:60]!r} is one rig, and law draws others: give one")
        task = validate(model, values, source, within)
        values = moved(task, read_rig(rig)) if law is None else task.model_dump() | {"law": law}
    values = merged(values, overrides)
    by_law = [name for name in DRAWN if name in overrides and values.get("law") is not None]
    if by_law:
        raise ConfigurationError(f"task: {by_law[0]}: the law draws it with each rig")
    task = validate(model, values, source, within)
    given, law = overrides.get("references"), getattr(task, "law", None)
    if law and law.preview_paces and isinstance(given, Mapping) and "preview_times" in given:
        raise ConfigurationError("task: references.preview_times: the law shows paces instead: law.preview_paces = []")
    return task


def _refuse_drawn_leak(plant: Any, source: str) -> None:
    """Refuse a leak among changes of a rig; a whole rig may state its own, with which nothing but the axis is computed.

    Raises:
        ConfigurationError: the changes hold a leak that each episode draws.
    """
    if not isinstance(plant, Mapping) or plant.keys() >= PlantParameters.model_fields.keys():
        return
    leak = plant.get("leakage")
    for path in LEAKAGE_OF_THE_TASK:
        if isinstance(leak, Mapping) and path.removeprefix("leakage.") in leak:
            raise ConfigurationError(
                f"{source}: plant.{path}: has no effect, because each episode draws its leak; give the task's group "
                "leakage (healthy_share, healthy_range, faulty_range), or reset(options={'leakage_flow_lpm': …})"
            )


def moved(task: Any, rig: Rig) -> ByName:
    """A task on another rig: settings that followed from the old rig follow from the new one; the user's settings stay.

    Sensor settings in the file of the new rig take precedence over those that follow from its size.

    Raises:
        ConfigurationError: the task draws a parameter from a range that does not contain the rig's own value.
    """
    defaults, result = type(task)().model_dump(), task.model_dump()
    before, after = _following(task.plant, defaults, {}), _following(rig.plant, defaults, rig.sensors) | rig.sensors
    for path, value in after.items():
        group, name = path.rsplit(".", 1)
        if _at(result, path) in (before.get(path), _at(defaults, path)):
            _at(result, group)[name] = value
    return result | {"plant": rig.plant.model_dump(), "randomisation": _moved_ranges(task, rig)}


def pressure_ranges(plant: PlantParameters) -> dict[str, float]:
    """Upper end in Pa of each pressure sensor's range: the next usual one above what the valve can bring about.

    The chamber behind the larger area reaches the supply pressure, the other one as much more as its area is smaller.
    """
    from hydro_env.plant.arrays import plant_coefficients  # compiled code

    c = plant_coefficients(plant)
    ratio = c.area_a / c.area_b
    reached = {"pressure_a": max(1.0, 1.0 / ratio), "pressure_b": max(1.0, ratio)}
    return {
        name: next((end for end in USUAL_RANGES if end > times * plant.supply.pressure), times * plant.supply.pressure)
        for name, times in reached.items()
    }


def _following(plant: PlantParameters, defaults: Values, own: Values) -> ByName:
    """Settings that follow from a rig and its own sensors, by path; for the paper's rig the defaults, bit for bit."""
    from hydro_env.plant.analysis import (  # compiled code
        closed_port_natural_frequency,
        force_limits,
        full_pressure_forces,
        speed_limits,
    )

    reach = pressure = speed = acceleration = force = 1.0  # relative to the paper's rig
    paper = PlantParameters()
    if plant != paper:
        reach = plant.cylinder.stroke / paper.cylinder.stroke
        pressure = plant.supply.pressure / paper.supply.pressure
        force = sum(full_pressure_forces(plant)) / sum(full_pressure_forces(paper))
        # At full opening, against the external force.
        speed = sum(speed_limits(plant, plant.load.external_force)) / sum(speed_limits(paper))
        frequency = closed_port_natural_frequency(plant) / closed_port_natural_frequency(paper)
        available = min(force_limits(plant)) / (plant.load.mass + plant.cylinder.piston_mass)
        # The speed in as many natural periods as there, but no more than the supply can give.
        acceleration = min(speed, speed * frequency, SHARE_OF_ACCELERATION * available / 4.0)
    factors = {
        "references.largest_amplitude": reach,
        "references.step_range": reach,
        "references.acceleration_limit": acceleration,
        "reward.error_scale": reach,
        "failure.end_stop_speed": speed,
        "failure.pressure_rating": max(pressure, 1.0),  # a weak supply makes no weak cylinder
        "disturbance.force_range": force,
    }
    ends = {} if plant == paper else pressure_ranges(plant)
    sizes = {"position": reach}
    for name in ("pressure_a", "pressure_b"):
        usual = _at(defaults, f"sensors.{name}.high")
        sizes[name] = own.get(f"sensors.{name}.high", ends.get(name, usual)) / usual
    for sensor, factor in sizes.items():
        factors |= {f"sensors.{sensor}.{name}": factor for name in SCALED_FIELDS}
    values = {}
    for path, factor in factors.items():
        value = _at(defaults, path)
        values[path] = tuple(factor * end for end in value) if isinstance(value, tuple) else factor * value
    return values


def _moved_ranges(task: Any, rig: Rig) -> ByName:
    """Randomisation of a task on another rig; a user's range must contain the new rig's value."""
    given, before = task.randomisation, default_randomisation(task.plant)
    after = default_randomisation(rig.plant) | rig.randomisation
    own = {path: draw for path, draw in given.items() if draw != before.get(path)}
    for path, draw in own.items():
        value = own_value(rig.plant, path)
        low, high = draw.bounds(value)
        if draw.times:
            low, high = (end * own_value(rig.plant, draw.times) for end in (low, high))
        if not (draw.relative or low <= value <= high or value == draw.otherwise):
            raise ConfigurationError(
                f"{rig.source}: {path} = {value:g}: the task draws it from {low:g} to {high:g}, the range of another "
                f"rig; give randomisation.{path} a 'factor' there, or leave it out"
            )
    # A task that does not draw parameters of its rig does not draw them on the new one.
    result = after | own if before.keys() <= given.keys() else {p: own.get(p, after.get(p, given[p])) for p in given}
    return {path: draw.model_dump() for path, draw in result.items()}


def merged(base: Values, changes: Values) -> ByName:
    """``base`` updated by ``changes``, group by group, each distribution of ``randomisation`` as a whole.

    ``references.weights`` is replaced as a whole, and so is ``randomisation`` by an empty group, which draws nothing,
    or by one that names every parameter of the base: draws depend on their order.
    """
    result = dict(base)
    for key, value in changes.items():
        old = result.get(key)
        if not isinstance(old, Mapping) or not isinstance(value, Mapping) or key == "weights":
            result[key] = value
        elif key == "randomisation":
            result[key] = {**old, **value} if value and old.keys() - value.keys() else value
        else:
            result[key] = merged(old, value)
    return result
