"""The plan of a leak test: steps of the valve opening, within limits, from which the leak is read most exactly.

The axis is pressed against its stops at several openings, stands there with the valve closed, and makes short moves off
the stop. At a stop all oil that enters a chamber leaks: past the seal, whose flow changes its direction from one stop
to the other, and past the edges of the valve, whose flow changes with the opening. All steps run in open loop.

Several tests of this form are simulated on plants with worn valves. The plan is the one with the lowest Cramér–Rao
bound (:mod:`hydro_rig.estimation.information`).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from hydro_agents.rigs.check import resting_place
from hydro_agents.running.seeds import LEARNING
from hydro_agents.running.tasks import own_reference
from hydro_env import ConfigurationError, TaskConfig
from hydro_env.plant.analysis import speed_limits
from hydro_env.task.configuration import task_config
from hydro_env.task.randomisation import Distribution, own_value
from hydro_env.task.sensors import COMMAND, POSITION, PRESSURE_A, PRESSURE_B, SENSORS
from hydro_env.types import Floats
from hydro_rig.diagnosis.leak_test_steps import (
    FORMS,
    STOPS,
    Form,
    LeakTestSettings,
    Step,
    commands_of,
    rounded,
    steps_of,
)
from hydro_rig.estimation.information import bound as smallest_deviation
from hydro_rig.estimation.known_windows import KnownWindows, known_windows, leak_cases
from hydro_rig.estimation.replay import Commands, Rows, replay
from hydro_rig.estimation.unknowns import Prior, priors_of
from hydro_rig.identification.fit import unknowns_of

Progress = Callable[[str, int, int], None]

WEAR = {
    "valve.null_shift": (-0.02, 0.02),
    "valve.underlap": (0.0, 0.04),
    "supply.tank_pressure": (-0.5e5, 4e5),
}
"""What wear and a clogged return line add to a parameter, SI."""

WEAR_FACTORS = {"valve.rated_flow": (0.75, 1.25), "valve.edge_ratio": (0.85, 1.18)}
"""By what wear of the edges multiplies a parameter."""

ARRIVED = 0.9  # share of the way to where the axis comes to rest, at which it counts as arrived
MOST_TRAVEL_TIME = 0.7  # largest share of the test that the axis may need to reach the stops
SAFETY = 0.95  # of the limit of speed, which the largest opening reaches
SIMULATED_LEAK = 0.01  # l/min at 100 bar, of the simulated axes
ATTEMPTS = 5  # to find the largest opening
UNLIMITED = {"end_stop_speed": 100.0, "pressure_rating": 2e8}  # of a trial whose peaks are still to be measured
FIND, MISS = 2.326, 1.645  # quantiles of the normal distribution: 1 % false alarms, and 95 % found


@dataclass(frozen=True)
class Trial:
    """A form of the test, and how the simulated axes run it."""

    form: Form
    steps: tuple[Step, ...]
    bound: Floats  # (plants,), smallest standard deviation of the leak, l/min at 100 bar
    signals: Floats  # (plants, 5, T), measured
    position: Floats  # (plants, T), m, without noise
    pressures: Floats  # (plants, 2, T), Pa
    speed: float  # m/s, the largest
    beyond: int  # axes that went beyond a limit

    @property
    def mean_bound(self) -> float:
        """Geometric mean of the bound over the axes, l/min at 100 bar."""
        return float(np.exp(np.log(self.bound).mean()))

    @property
    def largest_bound(self) -> float:
        """The bound on the worst simulated axis, l/min at 100 bar."""
        return float(self.bound.max())


class Plan(NamedTuple):
    """The test."""

    task: TaskConfig  # with a worn valve
    settings: LeakTestSettings
    trials: Sequence[Trial]
    best: Trial

    @property
    def commands(self) -> Floats:
        """Openings, one per control period, (T,)."""
        return commands_of(self.best.steps, self.task.control_period)

    @property
    def smallest(self) -> float:
        """The leak that an estimate at the bound finds in 95 % of the tests at 1 % false alarms, l/min at 100 bar."""
        return (FIND + MISS) * self.best.largest_bound


def worn_task(config: TaskConfig) -> TaskConfig:
    """The task with a valve that may be worn and a return line that may be clogged; wider ranges of the rig stay."""
    ranges: dict[str, Any] = {path: drawn.model_dump(exclude_none=True) for path, drawn in config.randomisation.items()}
    for path in (*WEAR, *WEAR_FACTORS):
        own = own_value(config.plant, path)
        drawn = config.randomisation.get(path, Distribution(uniform=(own, own)))
        if drawn.times is not None:
            continue
        low, high = drawn.bounds(own)
        ends = [own + end for end in WEAR[path]] if path in WEAR else [own * end for end in WEAR_FACTORS[path]]
        lowest = -0.5 if path == "valve.null_shift" else 0.0
        ranges[path] = {"uniform": (max(min(low, ends[0]), lowest), max(high, ends[1]))}
    return task_config(config, randomisation=ranges)


def priors_of_test(config: TaskConfig, measured: NDArray[np.bool_]) -> dict[str, Prior]:
    """The unknowns of a test and their priors; ``config``: the :func:`worn_task`; ``measured``: the sensors, (4,)."""
    return priors_of(config, unknowns_of(config, config.randomisation, measured))


class Played:
    """Plays openings (T,), one per call, on all axes."""

    def __init__(self, openings: Floats) -> None:
        self.openings, self._step = openings, 0

    def predict(
        self, observation: Any, state: Any = None, episode_start: Any = None, deterministic: bool = True
    ) -> tuple[NDArray[np.float32], Any]:
        """The next opening; after the last one the valve is closed."""
        opening = self.openings[self._step] if self._step < len(self.openings) else 0.0
        self._step += 1
        return np.full((len(observation), 1), opening, dtype=np.float32), state


def plan(config: TaskConfig, settings: LeakTestSettings, progress: Progress | None = None) -> Plan:
    """The test with the lowest bound within the limits.

    Args:
        config: the task of the rig.
        settings: the limits.
        progress: called with phase, done, total.

    Raises:
        ConfigurationError: no test is possible within the limits.
    """
    task = worn_task(config)
    _check_positions(task, settings)
    report = progress or (lambda phase, done, total: None)
    report("plan", 0, len(FORMS) + 1)
    opening, travel = _largest_opening(task, settings)
    trials = []
    for number, form in enumerate(FORMS, 1):
        report("plan", number, len(FORMS) + 1)
        trials.append(_tried(task, settings, form, opening, travel))
    report("plan", len(FORMS) + 1, len(FORMS) + 1)
    within = [trial for trial in trials if not trial.beyond]
    if not within:
        least = min(trials, key=lambda trial: trial.beyond)
        lowest, highest = 1e3 * least.position.min(), 1e3 * least.position.max()
        raise ConfigurationError(
            f"leak-test: {least.beyond} of {len(least.position)} simulated axes go beyond a limit in every test; they "
            f"reach {lowest:.0f} to {highest:.0f} mm, {1e-5 * least.pressures.max():.0f} bar: widen --between or "
            "--pressure, lower --opening or --duration, or test another --stop"
        )
    return Plan(task, settings, trials, min(within, key=lambda trial: trial.mean_bound))


def _tried(task: TaskConfig, settings: LeakTestSettings, form: Form, opening: float, travel: Sequence[float]) -> Trial:
    """A form of the test on simulated axes."""
    steps = rounded(steps_of(form, task.plant, settings, opening, travel), task.control_period)
    windows = simulated(task, steps, settings.plants)
    position, pressures = _true_course(task, windows)
    fitted = np.array([getattr(task.sensors, name).fitted for name in SENSORS])
    bound = smallest_deviation(task, windows, priors_of_test(task, fitted))
    try:
        limits = {"end_stop_speed": settings.speed, "pressure_rating": settings.pressure}
        kept = simulated(task, steps, settings.plants, limits=limits).case
    except ConfigurationError:  # not one reaches the end
        kept = np.zeros(0, np.int64)
    speeds = _speeds(task, position)
    within = np.isin(np.arange(len(position)), kept) & (speeds <= settings.speed)
    within &= (position.min(axis=1) >= settings.low) & (position.max(axis=1) <= settings.high)
    return Trial(
        form=form,
        steps=steps,
        bound=bound,
        signals=windows.signals,
        position=position,
        pressures=pressures,
        speed=float(speeds.max()),
        beyond=int((~within).sum()),
    )


def simulated(
    task: TaskConfig,
    steps: Sequence[Step],
    plants: int,
    leak: float = SIMULATED_LEAK,
    seeds: range | None = None,
    limits: Mapping[str, float] = UNLIMITED,
) -> KnownWindows:
    """Signals of simulated axes during a test, those of the plan or of other seeds; ``limits`` end it."""
    openings = commands_of(steps, task.control_period)
    loose = task_config(task, failure=dict(limits))
    standing = own_reference(loose, np.full(len(openings) + 1, resting_place(task.plant)))
    cases = leak_cases(LEARNING.take(plants) if seeds is None else seeds, plants, leak)
    return known_windows(standing, Played(openings), cases, 0.0, (len(openings) - 2) * task.control_period)


def _true_course(task: TaskConfig, windows: KnownWindows) -> tuple[Floats, Floats]:
    """Position (plants, T) and pressures (plants, 2, T) of simulated axes, without noise."""
    commands, rows = Commands(windows.signals[:, COMMAND]), np.arange(len(windows.signals))
    read = replay(task, commands, Rows(rows, windows.physical, windows.start, windows.latency))
    return read[:, POSITION], read[:, [PRESSURE_A, PRESSURE_B]]


def _speeds(task: TaskConfig, position: Floats) -> Floats:
    """Largest speed of each axis, m/s, (plants,)."""
    return np.asarray(np.abs(np.gradient(position, task.control_period, axis=1)).max(axis=1))


def _check_positions(task: TaskConfig, settings: LeakTestSettings) -> None:
    """Check that the allowed positions lie within the stroke, and the start between them."""
    half, start = 0.5 * task.plant.cylinder.stroke, resting_place(task.plant)
    for name, place in (("low", settings.low), ("high", settings.high)):
        if np.isfinite(place) and not -half <= place <= half:
            raise ConfigurationError(
                f"--between: {name} end {1e3 * place:g} mm: must be within the stroke, {-1e3 * half:g} to "
                f"{1e3 * half:g} mm"
            )
    if not settings.low < start < settings.high:
        raise ConfigurationError(f"--between: {1e3 * start:g} mm, where the axis rests, must lie between its ends")


def _largest_opening(task: TaskConfig, settings: LeakTestSettings) -> tuple[float, Sequence[float]]:
    """The largest opening with which no simulated axis is too fast, and the times of :func:`_travel_times`."""
    opening = min(settings.opening, settings.speed / max(speed_limits(task.plant)))
    for _ in range(ATTEMPTS):
        travel = _travel_times(task, settings, opening)
        # The last form moves fastest: off a stop, the pressures of both chambers drive the axis.
        steps = steps_of(FORMS[-1], task.plant, settings, opening, travel)
        position, _ = _true_course(task, simulated(task, steps, settings.plants))
        fastest = float(_speeds(task, position).max())
        if fastest <= settings.speed:
            return opening, travel
        opening *= SAFETY * settings.speed / fastest
    raise ConfigurationError(
        f"--speed {1e3 * settings.speed:g} mm/s: some simulated axes are faster even with the valve nearly closed; "
        "raise --speed"
    )


def _travel_times(task: TaskConfig, settings: LeakTestSettings, opening: float) -> Sequence[float]:
    """Seconds that the slowest simulated axis needs to each stop of the test, in order."""
    signs = STOPS[settings.stop]
    steps = [Step(sign * opening, settings.duration, "trial") for sign in signs]
    position, _ = _true_course(task, simulated(task, steps, settings.plants))
    length = round(settings.duration / task.control_period)
    times = []
    for number in range(len(signs)):
        part = position[:, number * length : (number + 1) * length]
        way = np.abs(part - part[:, :1])
        arrived = way >= ARRIVED * way[:, -1:]
        times.append(task.control_period * float(arrived.argmax(axis=1).max()))
    needed = sum(times) / MOST_TRAVEL_TIME
    if needed > settings.duration:
        stops, one = ("stop", "") if len(signs) == 1 else ("stops", ", or test one stop (--stop extended)")
        raise ConfigurationError(
            f"--duration {settings.duration:g} s: the axis needs {sum(times):.0f} s to reach the {stops} at an opening "
            f"of {100 * opening:.2g} %; allow {np.ceil(needed):.0f} s, raise --speed or --opening{one}"
        )
    return times
