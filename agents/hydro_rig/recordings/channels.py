"""Checks of each single channel: missing, constant, stuck, saturated, and impossible values; a set point as command."""

import numpy as np

from hydro_agents.detection.damaged_signals import FEWEST, SHORTEST
from hydro_env import TaskConfig
from hydro_env.plant.analysis import speed_limits
from hydro_env.task.sensors import COMMAND, POSITION, PRESSURE_A, PRESSURE_B, SPOOL, Sensor
from hydro_env.types import Floats, Mask
from hydro_rig.recordings.columns import MEASURED, UNITS
from hydro_rig.recordings.findings import MOST_SPIKES, Finding, Weight, finding_of, missing_weight, runs_of, severe_if
from hydro_rig.recordings.sampling import Sampled

LONGEST_LAG = 0.3  # s, by which a position may follow its set point
SPEED_OVER = 0.02  # s, half of the time over which the speed is taken
LEAST_ALIKE, MOST_FLOWING = 0.97, 0.7
"""Least correlation of a set point with the position, and largest with the speed: of references 0.91 to 1 and at most
0.4, but for fast sines, which remain unnoticed; no command of PID and PPO has both."""

Found = tuple[Mask, str, Weight]
MOST_AT_AN_END = 0.6  # largest share of a channel at an end of its range: a cavitating pressure stays at zero
ACTIVE_COMMAND = 0.01  # range of the command, as a fraction of full command, over which the spool must move
FEWEST_STEPS = 20.0  # change of another channel that a sensor cannot miss, in steps of its readings
LEAST_TRAVEL = 2e-3  # m; travel that the oil through the valve would cause
LEAST_PRESSURE_CHANGE = 0.02  # of the other chamber, as a share of the supply pressure
DROP = 0.1  # smallest fall of a reading, as a fraction of the sensor's range, when its current loop breaks
FEWEST_DROPS = 3  # smallest number of falls of a broken loop; a chamber may cavitate once or twice
LOWEST_PRESSURE = -1.2e5  # Pa; lowest gauge pressure: vacuum minus the error of a transducer
LEAST_USED = 0.05  # smallest used fraction of a signal's range
LEAST_PRESSURE = 0.2  # fraction of the supply pressure that at least one of the two chambers reaches
CURRENTS = (3.6, 21.0)  # mA, of a sensor's signal of 4 to 20 mA, as NAMUR NE 43 has it
LEAST_BESIDE_CURRENTS = 0.25  # the same where both read like such currents
OVERRANGE = 1.05  # readings may exceed the rig's limits by 5 %


def check_channels(samples: Sampled, config: TaskConfig) -> tuple[list[Finding], Mask]:
    """Findings about each single channel, and (5, T) which readings are invalid: stuck, lost, saturated, impossible."""
    findings = []
    bad = np.zeros(samples.signals.shape, bool)

    def found(row: int, mask: Mask, what: str, weight: Weight) -> None:
        if mask.any():
            bad[row] |= mask
            findings.append(finding_of(mask, samples.time, MEASURED[row], what, weight))

    for row, signal in enumerate(MEASURED):
        values = samples.signals[row]
        known = np.isfinite(values)
        if not known.any():
            continue  # not recorded, or no numbers: already reported
        found(row, ~known, "lacks readings", missing_weight(signal, 1.0 - known.mean()))
        if signal != "command" and np.nanmin(values) == np.nanmax(values):
            findings.append(Finding(signal, f"is constant at {_shown(signal, values[known][0])}", Weight.SEVERE))
            continue
        beyond = _out_of_range(values, samples, signal, config)
        found(row, *beyond)
        if signal != "command" and beyond[2] is not Weight.SEVERE:
            values = np.where(bad[row], np.nan, values)
            sensor = getattr(config.sensors, signal)
            lost = _lost(values, samples, signal, sensor)
            found(row, *lost)
            found(row, *_saturated(np.where(lost[0], np.nan, values), samples, signal, sensor))
            found(row, *_stuck(values, samples, signal, sensor, config))
    return [*findings, *_too_low_pressures(samples, config)], bad


def _largest(signal: str, config: TaskConfig) -> float:
    """Largest possible size on the rig, SI."""
    if signal == "position":
        return 0.5 * config.plant.cylinder.stroke
    if "pressure" not in signal:
        return 1.0
    return max(config.failure.pressure_rating, 1.5 * config.plant.supply.pressure)


def _out_of_range(values: Floats, samples: Sampled, signal: str, config: TaskConfig) -> Found:
    """Impossible values; if there are many, with a unit that would fit."""
    largest = _largest(signal, config)
    both_ways = "pressure" not in signal or config.sensors.differential_pressure
    lowest = -largest if both_ways else LOWEST_PRESSURE
    beyond = np.isfinite(values) & ((values > OVERRANGE * largest) | (values < OVERRANGE * lowest))
    few = beyond.mean() <= MOST_SPIKES
    if few and signal != "command":  # a command is no reading: no sensor has spikes there
        what = f"has single values from {_shown(signal, np.nanmin(values))} to {_shown(signal, np.nanmax(values))}, "
        return beyond, what + "which are impossible on this rig", Weight.NOTE
    low, high = np.nanquantile(values, [0.0, 1.0] if few else [0.005, 0.995])
    what = f"reads {_shown(signal, low)} to {_shown(signal, high)}, but the rig has "
    what += f"{_shown(signal, lowest)} to {_shown(signal, largest)}"
    if signal == "position" and largest < high <= 2.2 * largest and low >= -0.1 * largest:
        what += "; zero seems to be at the end of the stroke: mid-stroke is 0, so an offset of "
        what += f"{_shown(signal, -largest)} would fit"
    else:
        what += _fitting_units(signal, max(abs(low), abs(high)), LEAST_USED * largest, largest, samples)
    return beyond, what, Weight.SEVERE


def _too_low_pressures(samples: Sampled, config: TaskConfig) -> list[Finding]:
    """Both pressures are far below the supply: the unit is wrong, or they are the raw currents of the sensors."""
    pressures = samples.signals[[PRESSURE_A, PRESSURE_B]]
    ends = [np.nanquantile(values, [0.005, 0.995]) for values in pressures if np.isfinite(values).any()]
    if not ends or config.sensors.differential_pressure:
        return []
    lowest, highest = np.min(ends), np.max(ends)
    supply, sensor = config.plant.supply.pressure, config.sensors.pressure_a
    unit = UNITS["pressure_a"][samples.units.get("pressure_a", "bar")]
    raw = CURRENTS[0] * unit <= lowest and highest <= CURRENTS[1] * unit
    least = (LEAST_BESIDE_CURRENTS if raw else LEAST_PRESSURE) * supply
    if highest > least:
        return []
    what = f"read at most {_shown('pressure_a', highest)}, but the supply has {_shown('pressure_a', supply)}"
    if raw:
        gain = (sensor.high - sensor.low) / unit / 16.0
        what += (
            f"; raw signals of 4 to 20 mA would fit: for sensors of {_shown('pressure_a', sensor.low)} to "
            f"{_shown('pressure_a', sensor.high)} write gain: {gain:.5g}, offset: {sensor.low / unit - 4.0 * gain:.5g} "
            "in the map"
        )
    what += _fitting_units("pressure_a", highest, least, _largest("pressure_a", config), samples)
    return [Finding("pressures", what, Weight.SEVERE)]


def _fitting_units(signal: str, size: float, least: float, largest: float, samples: Sampled) -> str:
    """Phrase with the units in which values of this size (SI) would fit the rig; empty if there are none."""
    units = UNITS[signal]
    unit = samples.units.get(signal, next(iter(units)))
    fitting = [name for name in units if name != unit and least <= size * units[name] / units[unit] <= 1.2 * largest]
    if not fitting:
        return ""
    return f"; values in {' or '.join(fitting[:2])} instead of {unit} would fit"


def _lost(values: Floats, samples: Sampled, signal: str, sensor: Sensor) -> Found:
    """Readings that jump to the lower end of the range and back, like those of a broken 4–20 mA loop."""
    at_low = (values <= sensor.low + _half_step(sensor)) & ~_under_full_command(samples, signal)
    lost, times = np.zeros(len(values), bool), 0
    beside = np.pad(values, 1, constant_values=np.inf)  # of nothing
    for begin, end in zip(*runs_of(at_low), strict=True):
        fall = min(beside[begin], beside[end + 1]) - sensor.low
        if DROP * (sensor.high - sensor.low) < fall < np.inf:
            lost[begin:end] = True
            times += 1
    what = f"loses readings: it falls {times} times to {_shown(signal, sensor.low)} and returns"
    return lost & (times >= FEWEST_DROPS), what, Weight.FAULT


def _saturated(values: Floats, samples: Sampled, signal: str, sensor: Sensor) -> Found:
    at_end = _at_end(values, sensor) & ~_under_full_command(samples, signal)
    what = f"is at the end of the sensor's range ({_shown(signal, sensor.low)} to {_shown(signal, sensor.high)})"
    return at_end, what, severe_if(at_end.mean() > MOST_AT_AN_END)


def _under_full_command(samples: Sampled, signal: str) -> Mask:
    """Samples in which the spool may be at the end of its stroke."""
    return (np.abs(samples.signals[COMMAND]) > 0.8) & (signal == "spool_position")


def _half_step(sensor: Sensor) -> float:
    return 0.6 * max(sensor.resolution, 1e-6 * (sensor.high - sensor.low))


def _at_end(values: Floats, sensor: Sensor) -> Mask:
    step = _half_step(sensor)
    return (values >= sensor.high - step) | (values <= sensor.low + step)


def _stuck(values: Floats, samples: Sampled, signal: str, sensor: Sensor, config: TaskConfig) -> Found:
    """Runs of equal readings while another channel shows that this one must have changed.

    Equal readings alone are no fault: an encoder repeats its value while the axis rests, and a position that leaves
    its highest or lowest reading again was at the end of the sensor's range or of the stroke.
    """
    same = np.append(False, (np.diff(values) == 0.0) & (np.diff(samples.place) == 1)) & ~_at_end(values, sensor)
    shortest = max(FEWEST, round(SHORTEST / samples.period))
    changes = np.abs(np.diff(values))
    step = max(sensor.resolution, np.min(changes, where=changes > 0.0, initial=np.inf))
    stuck, ended, runs = np.zeros_like(same), np.zeros_like(same), 0
    extremes = (np.nanmin(values), np.nanmax(values)) if np.isfinite(values).any() else ()
    for begin, end in zip(*runs_of(same), strict=True):
        if end - begin < shortest:
            continue
        if signal == "position" and values[begin] in extremes and end < len(values):
            ended[begin - 1 : end] = True
        elif _must_change(samples.signals[:, begin - 1 : end], signal, FEWEST_STEPS * step, samples, config):
            stuck[begin - 1 : end] = True
            runs += 1
    levels = np.unique(values[stuck])
    cut = runs > 1 and len(levels) == 1 and levels[0] in extremes
    if not runs and ended.any():
        ends = " and ".join(_shown(signal, end) for end in extremes if end in values[ended])
        return ended, f"rests at {ends}, the end of its readings: left out there", Weight.NOTE
    return stuck | ended, f"is cut off at {_shown(signal, levels[0])}" if cut else "is stuck at one value", Weight.FAULT


def stands_still(signal: str, samples: Sampled, config: TaskConfig) -> bool:
    """Whether all readings of a measured signal are equal while the other channels show that it must have changed."""
    values = samples.signals[MEASURED.index(signal)]
    equal = signal != "command" and len(np.unique(values[np.isfinite(values)])) == 1
    return equal and _must_change(samples.signals, signal, 0.0, samples, config)


def _must_change(during: Floats, signal: str, least: float, samples: Sampled, config: TaskConfig) -> bool:
    """Whether the other channels (5, n) of a stretch show a motion that ``signal`` cannot miss.

    ``least`` is the change that its readings show in any case, although they are rounded or held within a dead band.
    The spool follows the command. The piston follows the oil through the valve, whatever constant part of it a shifted
    null or a leak takes. A pressure changes with that of the other chamber; if that was not recorded, with the command.
    """
    command = during[COMMAND]
    swing = np.ptp(command[np.isfinite(command)]) if np.isfinite(command).any() else 0.0
    if signal == "spool_position":
        return swing > max(ACTIVE_COMMAND, least)
    if signal == "position":
        spool = during[SPOOL] if np.isfinite(during[SPOOL]).all() else command
        if not np.isfinite(spool).all():
            return False
        travel = np.cumsum(spool - spool.mean()) * samples.period * np.mean(speed_limits(config.plant))
        return np.ptp(travel) > max(LEAST_TRAVEL, least)
    other = PRESSURE_A if signal == "pressure_b" else PRESSURE_B
    known = during[other][np.isfinite(during[other])]
    if len(known) < 2:
        return swing > ACTIVE_COMMAND
    noise = 1.05 * np.median(np.abs(np.diff(known)))  # of one reading: 1.483 / √2 of that of a difference
    low, high = np.quantile(known, [0.05, 0.95])
    return high - low > max(10.0 * noise, LEAST_PRESSURE_CHANGE * config.plant.supply.pressure, least)


def _shown(signal: str, value: float) -> str:
    unit = {"position": "mm", "pressure_a": "bar", "pressure_b": "bar"}.get(signal, "%")
    return f"{value / UNITS[signal][unit]:.4g} {unit}"


def check_set_point(signals: Floats, period: float) -> Finding | None:
    """Find a command that is the position's set point, from signals (5, T) without gaps in motion.

    The position equals its set point a little later. Under the command of a valve the speed does so.
    """
    command, position, half = signals[COMMAND], signals[POSITION], max(round(SPEED_OVER / period), 1)
    lags = np.arange(0, min(round(LONGEST_LAG / period), len(command) // 2), max(half // 2, 1))
    alike = [_correlation(command[: len(command) - lag], position[lag:]) for lag in lags]
    speed = position[2 * half :] - position[: -2 * half]
    commands = [command[first : first + len(speed)] for first in (0, half)]  # at the time of the speed, and before
    flowing = max(_correlation(values, speed) for values in commands)
    if max(alike, default=0.0) < LEAST_ALIKE or flowing > MOST_FLOWING:
        return None
    late = 1e3 * period * lags[np.argmax(alike)]
    what = f"is the set point of the position, which follows it by {late:.2g} ms: the command to the valve is another"
    return Finding("command", f"{what} column; map that one", Weight.SEVERE)


def _correlation(one: Floats, other: Floats) -> float:
    """Size of the correlation of two signals (T,); 0 if one is constant."""
    one, other = one - one.mean(), other - other.mean()
    return abs(float(one @ other)) / max(float(np.sqrt((one @ one) * (other @ other))), 1e-300)
