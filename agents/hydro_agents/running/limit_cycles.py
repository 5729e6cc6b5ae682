"""Limit cycles: oscillations that continue at a constant reference.

With sensor noise every stiff loop moves a little, which looks like a limit cycle. The axis therefore runs without
noise: a small step of the reference and back excites it, then it must come to rest.
"""

from typing import NamedTuple

import numpy as np
import pandas as pd

from hydro_agents.controllers.base import Controller
from hydro_agents.running.cases import Cases, Rollout, run_cases
from hydro_agents.running.seeds import SeedRange
from hydro_agents.running.tasks import noiseless, own_reference
from hydro_agents.running.text import number
from hydro_env import TaskConfig
from hydro_env.types import Array, ByName, Floats

LEAST_CYCLES = 3  # smallest number of cycles in the evaluated time; a slower motion is drift
LASTING = 0.5  # an oscillation whose last third has less than this share of its amplitude is decaying

BEFORE, KICK, SETTLING, JUDGED = 0.1, 0.4, 1.0, 3.0  # s: rest, step, time to rest after its return, evaluated time
NOISES = 2.0  # an amplitude beyond so many standard deviations of the position sensor's noise can be seen

_DRIFT = 2 * LEAST_CYCLES - 1  # degree of the polynomial that follows a drift of fewer cycles


class LimitCycle(NamedTuple):
    """The oscillation in a stretch, and whether it is a limit cycle."""

    amplitude: float  # m; √2 times the root mean square
    frequency: float  # Hz, the strongest one
    sustained: bool


def find_limit_cycle(position: Array, period: float, floor: float) -> LimitCycle:
    """The oscillation of an axis that should be at rest; slow drift does not count.

    The position is true, while the reference is constant, (T,), m; T ≥ 18. A limit cycle has an amplitude above the
    ``floor`` (m), and does not decay within the run.
    """
    values = np.asarray(position, float)
    time = np.linspace(-1.0, 1.0, len(values))
    motion = values - np.polyval(np.polyfit(time, values, _DRIFT), time)
    amplitude, last = (np.sqrt(2.0) * np.std(part) for part in (motion, motion[-(len(motion) // 3) :]))
    cycles = int(np.argmax(np.abs(np.fft.rfft(np.hanning(len(motion)) * motion))))
    sustained = amplitude > floor and last > LASTING * amplitude and cycles >= LEAST_CYCLES
    return LimitCycle(amplitude, cycles / (len(values) * period), sustained)


def standstill_task(config: TaskConfig) -> TaskConfig:
    """The task without noise, with constant force and leak, and with a small step about mid-stroke and back.

    The step is as small as the task's steps can be.
    """
    begin, end, last = (round(time / config.control_period) for time in np.cumsum([BEFORE, KICK, SETTLING + JUDGED]))
    steps = np.repeat([0.0, config.references.step_range[0], 0.0], [begin, end - begin, last + 1 - end])
    return own_reference(noiseless(config), steps)


def standstill_metrics(rollout: Rollout, config: TaskConfig) -> dict[str, Floats]:
    """Of every case, arrays (N,): limit_cycle (1: it oscillates without noise), amplitude_um, frequency_hz, failed.

    A limit cycle is larger than one step of the position sensor.
    """
    floor, judged = config.sensors.position.resolution, round(JUDGED / config.control_period)
    found = [find_limit_cycle(row, config.control_period, floor) for row in rollout.position[:, -judged:]]
    amplitude, frequency, sustained = np.array(found, float).T
    return {
        "limit_cycle": sustained,
        "amplitude_um": 1e6 * amplitude,
        "frequency_hz": np.where(sustained == 1.0, frequency, np.nan),
        "failed": (rollout.failed_at >= 0).astype(float),
    }


# Counted per controller ---------------------------------------------------------------------------------------------


def counted(rows: pd.DataFrame) -> dict[str, float]:
    """The standstills of one controller, counted; one per row, with the columns of :func:`standstill_metrics`.

    ``largest_amplitude_um`` is 0 and ``frequency_hz`` NaN without a limit cycle.
    """
    cycles = rows[rows["limit_cycle"].astype(bool)].sort_values("amplitude_um")
    amplitude, frequency = 0.0, np.nan
    if len(cycles):
        amplitude, frequency = cycles[["amplitude_um", "frequency_hz"]].iloc[-1].astype(float)
    return {
        "limit_cycles": len(cycles),
        "standstills": len(rows),
        "failures": int(rows["failed"].sum()),
        "largest_amplitude_um": amplitude,
        "frequency_hz": frequency,
    }


def counted_at_rest(
    controller: Controller, config: TaskConfig, seeds: SeedRange, count: int, leakage_flow_lpm: float | None = None
) -> dict[str, float]:
    """The same for a controller of a task, on plants that the task draws, with a leak or those that it draws.

    ``ringing`` counts those that still move by more than twice the noise of the position sensor, or by its resolution,
    a second after the step, sustained or not.

    Raises:
        ControllerError: the controller failed.
    """
    task = standstill_task(config)
    leaks = None if leakage_flow_lpm is None else np.full(count, leakage_flow_lpm)
    rollout = run_cases(task, controller, Cases(np.array(seeds.take(count)), leaks))
    rows = pd.DataFrame(standstill_metrics(rollout, task))
    sensor = config.sensors.position
    loud = 1e6 * max(NOISES * sensor.noise, sensor.resolution)
    return counted(rows) | {"ringing": (rows["amplitude_um"] > loud).sum()}


def comes_to_rest(counts: ByName) -> bool:
    """Whether all standstills of :func:`counted` are without a limit cycle and without a failure."""
    return counts["limit_cycles"] == 0 and counts["failures"] == 0


def rest_text(counts: ByName) -> str:
    """What :func:`counted` found, as a phrase: limit cycle at 14 of 16 standstills, up to 7.9 mm."""
    places, parts = f"of {counts['standstills']} standstills", []
    if counts["limit_cycles"]:
        largest = counts["largest_amplitude_um"]
        size = f"{number(largest / 1e3, digits=2)} mm" if largest >= 1e3 else f"{number(largest, 0)} µm"
        parts.append(f"limit cycle at {counts['limit_cycles']} {places}, up to {size}")
    if counts["failures"]:
        parts.append(f"failure at {counts['failures']} {places}")
    return " and ".join(parts) or f"no limit cycle at {places.removeprefix('of ')}"


def rest_warning(controller: str, counts: ByName, baseline: bool) -> str:
    """One line about a controller that does not come to rest; empty for one that does."""
    if comes_to_rest(counts):
        return ""
    warning = f"{controller}: {rest_text(counts)}"
    if baseline:
        warning += ": ratios to it compare with a controller that does not come to rest"
    return warning
