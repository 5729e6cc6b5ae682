"""The plan of a leak test, steps of the valve opening from which a leak can be read, and its reading.

The axis is pressed against its stops at several openings, stands there with the valve closed, and makes short moves off
the stop. At a stop all oil that enters a chamber leaks: past the seal, whose flow changes its direction from one stop
to the other, and past the edges of the valve, whose flow changes with the opening. All steps run in open loop.

The largest opening is the one at which simulated axes with worn valves keep the limits; the Cramér–Rao bound
(:mod:`hydro_rig.estimation.known_windows`) says how exactly the leak can be read from them.

The reading is one fit of the simulator to the whole recording, with an unknown wear of the valve: all windows share
leak, plant and wear; each has its own start. The verdict follows the rules of ``hydro diagnose``.
"""

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from hydro_agents.detection.detector import HALF_WIDTH, Cause, Reading, Why, Windows
from hydro_agents.rigs.check import resting_place
from hydro_agents.running.seeds import LEARNING
from hydro_agents.running.statistics import Interval
from hydro_agents.running.tasks import own_reference
from hydro_agents.running.text import number
from hydro_env import ConfigurationError, TaskConfig, task_config
from hydro_env.plant.analysis import speed_limits
from hydro_env.task.randomisation import Distribution, own_value
from hydro_env.task.sensors import POSITION, PRESSURE_A, PRESSURE_B
from hydro_env.types import Floats, Mask
from hydro_rig.diagnosis.diagnose import Diagnosis, Read, diagnosed
from hydro_rig.estimation.estimate import SURE
from hydro_rig.estimation.estimator import WEAR, healthy_range
from hydro_rig.estimation.known_windows import KnownWindows, known_windows, leak_cases
from hydro_rig.estimation.known_windows import bound as smallest_deviation
from hydro_rig.estimation.unknowns import LEAKAGE, Prior, priors_of
from hydro_rig.identification.common_fit import WELL_FITTED, Common, common_fit
from hydro_rig.identification.fit import COVERAGE, measured_in, spread_of, unknowns_of
from hydro_rig.recordings.columns import ColumnMap
from hydro_rig.recordings.recording import read_recording
from hydro_rig.recordings.sampling import Sampled, cut

MOVE = 0.5  # s, of each part of a short move
RAMP = 2.0  # full strokes per second with which the opening changes: a sudden change makes the axis swing
SHARES = (0.3, 0.1)  # of the largest opening, one after the other at each stop, before the valve is closed
MOVES = 2  # short moves off each stop
STOPS = {"both": (1.0, -1.0), "extended": (1.0,), "retracted": (-1.0,)}

WORN = {
    "valve.null_shift": Distribution(uniform=(-0.02, 0.02)),
    "valve.underlap": Distribution(uniform=(0.0, 0.04)),
    "supply.tank_pressure": Distribution(uniform=(-0.5e5, 4e5)),
    "valve.rated_flow": Distribution(factor=(0.75, 1.25)),
    "valve.edge_ratio": Distribution(factor=(0.85, 1.18)),
}
"""What wear and a clogged return line add to a parameter, SI, or by what they multiply it."""

LARGEST_OPENING = 0.3  # of full stroke
PLANTS = 6  # simulated ones, of the training seeds
ARRIVED = 0.9  # share of the way to where the axis comes to rest, at which it counts as arrived
MOST_TRAVEL_TIME = 0.7  # largest share of the test that the axis may need to reach the stops
SAFETY = 0.95  # of the limit of speed, which the largest opening reaches
SIMULATED_LEAK = 0.01  # l/min at 100 bar, of the simulated axes
ATTEMPTS = 5  # to find the largest opening
UNLIMITED = {"end_stop_speed": 100.0, "pressure_rating": 2e8}  # of a simulation whose peaks are to be measured
WINDOW = 4.0  # s; the windows share all unknowns but their start
MOST_WINDOWS = 30  # of a longer recording those at its end
Quantities = dict[str, Interval]
"""By unknown its value with the 90 % interval: the leak in l/min at 100 bar, what wears in SI units."""


class Step(NamedTuple):
    """A constant opening."""

    opening: float  # of full stroke; positive extends the axis
    seconds: float
    what: str


class Plan(NamedTuple):
    """The test, and how N simulated axes run it."""

    task: TaskConfig  # with a worn valve
    steps: Sequence[Step]
    bound: Floats  # (N,), smallest standard deviation of the leak, l/min at 100 bar
    signals: Floats  # (N, 5, T), measured
    speed: float  # m/s, the largest

    @property
    def commands(self) -> Floats:
        """Openings, one per control period, (T,)."""
        return commands_of(self.steps, self.task.control_period)

    def line(self) -> str:
        """The plan in one sentence."""
        seconds = sum(step.seconds for step in self.steps)
        largest = 100 * max(abs(step.opening) for step in self.steps)
        reach = number(HALF_WIDTH * self.bound.max(), digits=2)
        return (
            f"a test of {seconds:.0f} s, the valve at most {largest:.2g} % open; 90 % interval of the leak at the "
            f"bound ±{reach} l/min at 100 bar"
        )


def plan(config: TaskConfig, duration: float = 60.0, speed: float | None = None, stop: str = "both") -> Plan:
    """The test of ``duration`` s on the rig of a task, within limits; ``stop``: a name in :data:`STOPS`.

    ``speed``: m/s, the largest one, also against an end stop; default: that of the task.

    Raises:
        ConfigurationError: no test is possible within the limits.
    """
    task, signs = worn_task(config), STOPS[stop]
    exact = task_config(task, sensors={"enabled": False})
    speed = config.failure.end_stop_speed if speed is None else speed
    opening = min(LARGEST_OPENING, speed / max(speed_limits(task.plant)))
    for _ in range(ATTEMPTS):
        travel = _travel_times(exact, signs, duration, opening)
        steps = steps_of(task, dict(zip(signs, travel, strict=True)), duration, opening)
        true = simulated(exact, steps, PLANTS).signals
        fastest = np.abs(np.gradient(true[:, POSITION], task.control_period, axis=1)).max()
        if fastest <= speed:
            break
        opening *= SAFETY * speed / fastest
    else:
        raise ConfigurationError(
            f"--speed {1e3 * speed:g} mm/s: some simulated axes are faster even with the valve nearly closed; "
            "raise --speed"
        )
    highest, rating = true[:, [PRESSURE_A, PRESSURE_B]].max(), config.failure.pressure_rating
    if not highest <= rating:
        raise ConfigurationError(
            f"leak-test: a simulated axis reaches {1e-5 * highest:.0f} bar, and the rig is made for "
            f"{1e-5 * rating:.0f} bar: lower --speed, or test another --stop"
        )
    windows = simulated(task, steps, PLANTS)
    fitted = np.array([sensor.fitted for sensor in task.sensors.in_order])
    bound = smallest_deviation(task, windows, priors_of_test(task, fitted))
    return Plan(task, steps, bound, windows.signals, fastest)


def worn_task(config: TaskConfig) -> TaskConfig:
    """The task with a valve that may be worn and a return line that may be clogged; wider ranges of the rig stay."""
    ranges = {path: drawn.model_dump(exclude_none=True) for path, drawn in config.randomisation.items()}
    for path, wear in WORN.items():
        own = own_value(config.plant, path)
        drawn = config.randomisation.get(path, Distribution(uniform=(own, own)))
        if drawn.times:
            continue
        low, high = drawn.bounds(own)
        ends = [end if wear.relative else own + end for end in wear.bounds(own)]
        least = max(min(low, *ends), -0.5 if path == "valve.null_shift" else 0.0)
        ranges[path] = {"uniform": (least, max(high, *ends))}
    return task_config(config, randomisation=ranges)


def priors_of_test(config: TaskConfig, measured: Mask) -> dict[str, Prior]:
    """The unknowns of a test and their priors; ``config``: the :func:`worn_task`; ``measured``: the sensors, (4,)."""
    return priors_of(config, unknowns_of(config, config.randomisation, measured))


def commands_of(steps: Sequence[Step], period: float) -> Floats:
    """Openings, one per control period, (T,); each step begins with a ramp from the opening before."""
    ends = np.round(np.cumsum([step.seconds for step in steps]) / period).astype(int)
    openings, before, begin = np.zeros(ends[-1]), 0.0, 0
    for step, end in zip(steps, ends, strict=True):
        most = RAMP * period * np.arange(end - begin + 1)
        course = before + np.clip(step.opening - before, -most, most)
        openings[begin:end], before, begin = course[:-1], course[-1], end
    return openings


def steps_of(task: TaskConfig, travel: Mapping[float, float], duration: float, opening: float) -> list[Step]:
    """The steps of the test; shares of the opening count from the end of the valve's dead band.

    ``travel``: s, to each stop by the sign of the opening; ``opening``: the largest one.
    """
    period, dead = task.control_period, task.plant.valve.overlap
    if dead >= opening:
        dead = 0.0
    rest = (duration - sum(travel.values())) / len(travel) - 2 * MOVE * MOVES
    each = rest / (len(SHARES) + 2)  # with the largest and the closed opening
    steps = []

    def add(size: float, seconds: float, what: str) -> None:  # whole control periods, and openings of four decimals
        whole = max(round(seconds / period), 1) * period
        steps.append(Step(round(size, 4), float(f"{whole:.9g}"), what))

    for sign, seconds in travel.items():
        name = "extended" if sign > 0.0 else "retracted"
        add(sign * opening, seconds + each, f"press against the {name} stop")
        for share in SHARES:
            add(sign * (dead + share * (opening - dead)), each, "press less")
        add(0.0, each, "valve closed")
        for _ in range(MOVES):
            add(-0.5 * sign * opening, MOVE, "move off the stop")
            add(0.5 * sign * opening, MOVE, "back")
    return steps


class Played:
    """Plays openings (T,), one per call, on all axes."""

    def __init__(self, openings: Floats) -> None:
        self.openings, self._step = openings, 0

    def predict(self, observation: Any, *_: Any, **__: Any) -> Any:
        """The next opening; after the last one the valve is closed."""
        opening = self.openings[self._step] if self._step < len(self.openings) else 0.0
        self._step += 1
        return np.full((len(observation), 1), opening, np.float32), None


def simulated(
    task: TaskConfig, steps: Sequence[Step], plants: int, leak: float = SIMULATED_LEAK, seeds: range | None = None
) -> KnownWindows:
    """Signals of simulated axes during a test, those of the plan or of other seeds."""
    openings = commands_of(steps, task.control_period)
    loose = task_config(task, failure=UNLIMITED)
    standing = own_reference(loose, np.full(len(openings) + 1, resting_place(task.plant)))
    cases = leak_cases(LEARNING.take(plants) if seeds is None else seeds, plants, leak)
    return known_windows(standing, Played(openings), cases, 0.0, (len(openings) - 2) * task.control_period)


def _travel_times(task: TaskConfig, signs: Sequence[float], duration: float, opening: float) -> Sequence[float]:
    """Seconds that the slowest simulated axis with exact sensors needs to each stop of the test, in order."""
    steps = [Step(sign * opening, duration, "trial") for sign in signs]
    position = simulated(task, steps, PLANTS).signals[:, POSITION]
    length = round(duration / task.control_period)
    times = []
    for place in range(len(signs)):
        part = position[:, place * length : (place + 1) * length]
        way = np.abs(part - part[:, :1])
        arrived = way >= ARRIVED * way[:, -1:]
        times.append(task.control_period * arrived.argmax(axis=1).max())
    needed = sum(times) / MOST_TRAVEL_TIME
    if needed > duration:
        raise ConfigurationError(
            f"--duration {duration:g} s: the axis needs {sum(times):.0f} s to reach the stops at an opening "
            f"of {100 * opening:.2g} %; allow {math.ceil(needed)} s, raise --speed, or test one --stop"
        )
    return times


def read_leak_test(path: Path, config: TaskConfig, columns: ColumnMap | None = None) -> tuple[Diagnosis, Quantities]:
    """Read the recording of a leak test: verdict, and what wears; nothing of the latter without a reading.

    The valve of the task's rig is healthy. Columns as of :func:`~hydro_rig.recordings.recording.read_recording`.

    Raises:
        ConfigurationError: the recording cannot be read at all.
    """
    found = {}

    def read(windows: Windows, config: TaskConfig) -> Read:
        if len(windows) < 2:
            return Reading.of(np.full(len(windows), np.nan), why=Why.FEW_WINDOWS), None
        task = worn_task(config)
        common = common_fit(windows, task, priors_of_test(task, measured_in(windows)))
        found.update(quantities(common))
        return _reading(common, found, config), None

    return diagnosed(read_recording(path, columns), config, _windows, read), found


def _windows(samples: Sampled) -> Windows:
    """The last windows with all commands."""
    total = samples.place[-1] + 1 if len(samples.place) else 0
    count = max(round(total * samples.period / WINDOW), 1)
    windows = cut(samples, max(total // count, 2))  # to the last move
    return windows.part(np.flatnonzero(windows.commanded)[-MOST_WINDOWS:])


def quantities(common: Common) -> Quantities:
    """The leak and what wears, by unknown."""
    joint, model = common.joint, common.model
    reach = HALF_WIDTH / COVERAGE * spread_of(joint).reach
    found = {}
    for place, value, error in zip(joint.shared, joint.common, reach, strict=True):
        name = model.names[place]
        if name == LEAKAGE or name in WEAR or name.startswith("valve."):
            found[name] = Interval(*model.priors[name].value(value + error * np.array([0.0, -1.0, 1.0])).tolist())
    return found


def _reading(common: Common, found: Quantities, config: TaskConfig) -> Reading:
    """The test as the reading of a detector: every window shares the leak, and may contradict the model."""
    faults, causes = [], []
    for name, wear in WEAR.items():
        if name in found:
            value, below, above = found[name]
            low, high = healthy_range(config, name)
            if max(low - value, value - high) > SURE * (above - below) / (2.0 * HALF_WIDTH):
                faults.append(wear.sized(value))
                causes.append(wear.cause)
    holds, leak = common.misfit < WELL_FITTED, found[LEAKAGE]
    return Reading.of(
        np.full(len(holds), leak.value / (leak.high - leak.low)),
        np.where(holds, causes[0] if causes else Cause.NONE, Cause.UNKNOWN),
        flow_lpm=leak.value,
        low_lpm=leak.low,
        high_lpm=leak.high,
        fault=" and ".join(faults),
        why=np.where(holds, Why.ANSWERED, Why.MISFIT),
    )
