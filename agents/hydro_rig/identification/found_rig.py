"""The identified rig: its plant, its narrowed ranges, its YAML file, and how a person reads its numbers."""

import math
from collections.abc import Mapping
from typing import Any, NamedTuple

import yaml

from hydro_agents.rigs.rig_file import unit_in_file
from hydro_agents.running.text import decimals_for, number
from hydro_env import PlantParameters, TaskConfig, flow_from_resistance, resistance_from_flow
from hydro_env.plant.parameters import grouped
from hydro_env.plant.parts.leakage import LEAK_LAWS, leak_past_piston
from hydro_env.task.randomisation import Distribution, own_value
from hydro_env.task.rig import merged
from hydro_env.types import ByName
from hydro_env.units import FACTORS
from hydro_rig.estimation.unknowns import (
    BIASES,
    EXTERNAL_LEAKAGE,
    EXTERNAL_RESISTANCE,
    GAINS,
    LATENCY,
    LEAKAGE,
    PATHS,
    RISE_TIME,
)
from hydro_rig.identification.fit import Fit, Ranges, hull, within_bounds

DIGITS = 6  # significant, of the numbers in the file
_BIAS_UNITS = {"position": (1e3, "mm"), "spool_position": (100.0, "%")}


def found_values(fit: Fit, config: TaskConfig) -> dict[str, float]:
    """Values of the rig's parameters by path, within the bounds of each field; a negative leak becomes none."""
    values = {}
    for name, value in fit.own().items():
        if name == LEAKAGE:
            own = LEAK_LAWS[config.leakage.law].parameter
            for field, size in leak_past_piston(max(value, 0.0), config.leakage.law).items():
                if field == own or size != getattr(config.plant.leakage, field):
                    values[f"leakage.{field}"] = size
        elif name == EXTERNAL_LEAKAGE:
            values[EXTERNAL_RESISTANCE] = resistance_from_flow(value)
        elif name in PATHS:
            values[name] = within_bounds(name, value)
    breakaway, coulomb = "friction.breakaway_force", "friction.coulomb_force"
    least = values.get(coulomb, own_value(config.plant, coulomb))
    if breakaway in values or least > own_value(config.plant, breakaway):
        values[breakaway] = max(values.get(breakaway, 0.0), least)
    return values


def found_plant(fit: Fit, config: TaskConfig) -> PlantParameters:
    """The plant with the most probable values."""
    return config.plant.replace(**grouped(found_values(fit, config)))


def narrowed(fit: Fit, config: TaskConfig, ranges: Ranges) -> dict[str, ByName]:
    """The range of each parameter in the new rig file: its 95 % interval, within the given range.

    An undetermined parameter keeps its range. The leak, which a task draws, keeps its range too.
    """
    result = {}
    plant = found_plant(fit, config)
    for one in fit.unknowns:
        path = EXTERNAL_RESISTANCE if one.name == EXTERNAL_LEAKAGE else one.name
        if path not in ranges:
            continue
        given = ranges[path]
        if not fit.knows(one):
            result[path] = _undetermined(config.plant, path, given)
        elif one.name == EXTERNAL_LEAKAGE:
            result[path] = _external(one.low, one.high, given)
        else:
            least, most = hull(config.plant, plant, path, given)
            inside = max(one.low, least), min(one.high, most)  # the whole interval if it lies outside
            low, high = inside if inside[0] <= inside[1] else (one.low, one.high)
            low, high = (within_bounds(path, end) for end in (low, high))
            if given.times:  # a ratio is never below the old one: breakaway stays above Coulomb friction
                factor, least = own_value(plant, given.times), given.bounds(1.0)[0]
                low, high = max(low / factor, least), max(high / factor, least)
            result[path] = {"uniform": [low, high]} | ({"times": given.times} if given.times else {})
    return result


def beyond_range(fit: Fit, config: TaskConfig, ranges: Ranges) -> list[str]:
    """Names of the parameters whose whole interval lies outside the range of the rig file."""
    plant, beyond = found_plant(fit, config), []
    for one in fit.unknowns:
        if one.name in ranges:
            low, high = hull(config.plant, plant, one.name, ranges[one.name])
            if one.high < low or one.low > high:
                beyond.append(one.name)
    return beyond


def _undetermined(plant: PlantParameters, path: str, given: Distribution) -> ByName:
    """The old range; factors become values in SI, because the rig's own value changes."""
    if not given.relative:
        return given.model_dump(exclude_defaults=True)
    form = "log_uniform" if given.logarithmic else "uniform"
    rest = given.model_dump(exclude_defaults=True, exclude={"factor", "log_factor"})
    return {form: list(given.bounds(own_value(plant, path))), **rest}


def _external(low: float, high: float, given: Distribution) -> ByName:
    """Range of the resistance of the leak past the rod seal; ``low``, ``high`` in l/min at 100 bar."""
    least, most = sorted(given.bounds(1.0))
    ends = tuple(resistance_from_flow(max(flow, 0.0)) for flow in (high, low))
    if ends[0] > most:  # tight
        return {"log_uniform": [least, most], "otherwise": math.inf, "otherwise_probability": 1.0}
    if ends[1] >= least:  # else it leaks more than the old range allows
        ends = max(ends[0], least), min(ends[1], most)
    found: ByName = {"log_uniform": list(ends)}
    if low <= 0.0 and given.otherwise is not None:  # it may be tight
        found |= {"otherwise": given.otherwise, "otherwise_probability": given.otherwise_probability}
    return found


def rig_yaml(rig: ByName, fit: Fit, config: TaskConfig, ranges: Ranges, notes: list[str]) -> str:
    """The given rig file with the identified values and the narrowed ranges; the notes stand at its top."""
    found = found_values(fit, config)
    values = merged(rig, grouped({path: _with_unit(path, value) for path, value in found.items()}))
    if "valve.knee_opening" in found:
        values["valve"]["knee_position"] = config.plant.valve.knee_position
    # The parameters stay in their groups; the narrowed ranges replace the old ones.
    values["randomisation"] = narrowed(fit, config, ranges)
    for path, entry in values["randomisation"].items():
        for key, value in entry.items():
            ratio = "times" in entry or key.endswith("probability")
            entry[key] = _with_unit("" if ratio else path, value)
    lines = [f"# {' '.join(note.split())}" for note in notes]
    for key, content in values.items():
        if not isinstance(content, Mapping):
            lines.append(_line(key, content))
            continue
        lines.append(f"{key}:")
        for field, value in content.items():
            mark, size = "", found.get(f"{key}.{field}")
            if size is not None:
                mark = "  # found"
                if field.endswith("_resistance"):
                    mark += f": {flow_from_resistance(size):.3g} l/min at 100 bar"
            lines.append(f"  {_line(field, value)}{mark}")
    return "\n".join(lines) + "\n"


def _with_unit(path: str, value: Any) -> Any:
    """A number in SI, or a list of two, as text in the unit of data sheets; words and infinity as they are."""
    if isinstance(value, list):
        return [_with_unit(path, end) for end in value]
    if not isinstance(value, float) or math.isinf(value):
        return value
    unit = unit_in_file(path) if path else ""
    number = float(f"{value / FACTORS.get(unit, 1.0):.{DIGITS}g}")
    return f"{number:.{DIGITS}g} {unit}" if unit else number


def _line(key: str, value: Any) -> str:
    """One entry of a YAML mapping in one line."""
    text = yaml.safe_dump({key: value}, sort_keys=False, allow_unicode=True, default_flow_style=True, width=math.inf)
    return text.strip()[1:-1]


class Shown(NamedTuple):
    """Display of an unknown: name, factor, unit."""

    words: str
    factor: float
    unit: str

    def span(self, low: float, high: float) -> str:
        """Two values with enough digits to distinguish them: two of their difference, or four of a single value."""
        decimals = self._decimals(high - low)
        return f"{number(self.factor * low, decimals, 4)} to {number(self.factor * high, decimals, 4)}"

    def value(self, value: float, uncertainty: float) -> str:
        """A value with the digits that its uncertainty allows; both in the unknown's unit."""
        return number(self.factor * value, self._decimals(uncertainty), 4)

    def _decimals(self, uncertainty: float) -> int | None:
        size = abs(self.factor * uncertainty)
        return decimals_for(size, 2) if 0.0 < size < math.inf else None


def shown(name: str) -> Shown:
    """Display of an unknown of :mod:`hydro_rig.estimation.unknowns`."""
    if name in _SHOWN:
        return _SHOWN[name]
    channel = name.rpartition("_")[0]
    if name in BIASES:
        return Shown(f"offset of the sensor: {channel.replace('_', ' ')}", *_BIAS_UNITS.get(channel, (1e-5, "bar")))
    if name in GAINS:
        return Shown(f"gain of the sensor: {channel.replace('_', ' ')}", 1.0, "1")
    unit = unit_in_file(name)
    return Shown(name.replace(".", ": ").replace("_", " "), 1.0 / FACTORS.get(unit, 1.0), unit or "1")


_SHOWN = {
    LEAKAGE: Shown("leak past the piston", 1.0, "l/min at 100 bar"),
    EXTERNAL_LEAKAGE: Shown("leak past the rod seal", 1.0, "l/min at 100 bar"),
    LATENCY: Shown("latency of the command", 1e3, "ms"),
    RISE_TIME: Shown("rise time of the pressure transducers", 1e3, "ms"),
}


def share_in_words(share: float) -> str:
    """A share of variance as text; a simulation with errors larger than the signal's variation explains nothing."""
    return f"{100 * share:.2f} %" if share > 0.0 else "nothing"
