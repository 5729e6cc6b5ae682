"""Experiments about the task alone, as parts of a robustness protocol: frequency response, stiffness, rest under noise.

Each is a list of steps: a controller on the same plants at several leaks.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from functools import partial
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from hydro_agents.controllers.base import Controller, Observation
from hydro_agents.evaluation.conditions import Cell, columns_of
from hydro_agents.evaluation.participants import Participants, split_name
from hydro_agents.evaluation.robustness_protocol import RobustnessProtocol
from hydro_agents.running.cases import Cases, Rollout, run_cases
from hydro_agents.running.jobs import Columns, Job, fingerprint
from hydro_agents.running.seeds import EXPERIMENT_AXES
from hydro_agents.running.tasks import noiseless, own_reference
from hydro_env import PlantParameters, TaskConfig
from hydro_env.plant.analysis import force_limits, reachable_range, speed_limits
from hydro_env.task.configuration import task_config
from hydro_env.task.signals import observation_layout
from hydro_env.types import Floats

LEAKS = (0.01, 1.0, 4.0)  # l/min at 100 bar: a tight seal, the bound between moderate and severe, a severe leak

PLACE = 0.3
"""Working position: share of the range that the supply of the nominal rig can hold, outwards from mid-stroke.

There a spring pushes against the piston; its pressure difference drives the leak.
"""


def working_place(plant: PlantParameters, share: float = PLACE) -> float:
    """Position in m at a share (−1 to 1) of the range that the supply of the nominal rig can hold."""
    low, high = reachable_range(plant)
    return share * high if share > 0.0 else -share * low


def full_speed(plant: PlantParameters, position: float) -> float:
    """The smaller of the two steady speeds of the nominal rig at full command at a position (m), m/s."""
    return min(speed_limits(plant, plant.load.spring_stiffness * position + plant.load.external_force))


Play = Callable[..., Rollout]
"""Runs the controller of an experiment in a task; with ``hidden=True`` it does not see the preview."""


class Experiment(NamedTuple):
    """An experiment with a controller in the loop, on the same plants at every leak."""

    steps: Callable[[TaskConfig, Play], Iterable[Mapping[str, Any]]]  # columns of each step, each (N,) or one value
    leaks: Sequence[float] = LEAKS  # l/min at 100 bar
    plants: int = 4

    def __call__(self, config: TaskConfig, controller: Controller) -> pd.DataFrame:
        """Run the controller on the same plants at every leak.

        Args:
            config: the task, for its plants, sensors and timing.
            controller: the controller.

        Returns:
            One row per step, leak and plant: leakage_flow_lpm, seed, and the columns of the experiment.

        Raises:
            ControllerError: the controller raises an exception or returns no finite commands.
        """
        seeds, leaks = EXPERIMENT_AXES.take(self.plants), np.repeat(self.leaks, self.plants)
        cases = Cases(np.tile(seeds, len(self.leaks)), leaks)

        def play(task: TaskConfig, hidden: bool = False) -> Rollout:
            return run_cases(task, HiddenPreview(controller, config) if hidden else controller, cases)

        known = {"leakage_flow_lpm": leaks, "seed": cases.seeds}
        return pd.concat([pd.DataFrame({**known, **step}) for step in self.steps(config, play)], ignore_index=True)


def sine_fit(values: Observation, time: Floats, frequency: float) -> tuple[NDArray[np.complex128], Floats]:
    """Least-squares fit of offset + drift · t + Re(amplitude · exp(j 2π f t)) to rows of samples.

    Args:
        values: (N, T).
        time: (T,), s.
        frequency: Hz.

    Returns:
        Complex amplitudes (N,), and the root mean square of the residual (N,).
    """
    angle = 2.0 * np.pi * frequency * time
    basis = np.stack([np.cos(angle), np.sin(angle), np.ones_like(time), time - time.mean()], axis=1)
    rows = np.asarray(values, dtype=np.float64)
    fit, *_ = np.linalg.lstsq(basis, rows.T, rcond=None)
    rest: Floats = np.sqrt(np.mean((rows - (basis @ fit).T) ** 2, axis=1))
    return fit[0] - 1j * fit[1], rest


class HiddenPreview:
    """A controller without preview: each previewed value equals the present reference."""

    def __init__(self, controller: Controller, config: TaskConfig) -> None:
        self.controller = controller
        self.hidden = [name.startswith("reference_preview_") for name in observation_layout(config)[0]]

    def predict(
        self, observation: Observation, state: Any = None, episode_start: Any = None, deterministic: bool = True
    ) -> tuple[NDArray[np.float32], Any]:
        """Commands of the controller; see :class:`~hydro_agents.controllers.base.Controller`."""
        return self.controller.predict(
            np.where(self.hidden, 0.0, observation).astype(observation.dtype), state, episode_start, deterministic
        )


# Frequency response ---------------------------------------------------------------------------------------------------

FREQUENCIES = (0.5, 1.0, 2.0, 3.0, 4.5, 6.5, 9.0, 12.0, 16.0, 22.0, 30.0, 40.0, 55.0)
"""Hz; frequencies from a third of the sampling frequency upwards are left out."""

AMPLITUDE_SHARE = 0.01  # amplitude of the sines as a share of the range of positions that the supply can hold

SPEED_SHARE = 0.15
"""Largest speed of the sines, as a share of the speed at full command; it keeps the valve far from its limits."""

SETTLING, WATCHED = 0.5, 0.5
"""s: time until the response is steady (and two cycles), and length of the fit (at least three cycles)."""


def sine_references(config: TaskConfig, play: Play) -> Iterator[dict[str, Any]]:
    """Sines of the reference about the working position, with the preview and with the preview hidden.

    Columns: preview (whether the controller sees it), frequency_hz, amplitude_mm, gain (1), phase_deg, rest (root mean
    square of the residual, as a share of the amplitude). The amplitude is smaller where the speed would be too high.
    """
    centre = working_place(config.plant)
    low, high = reachable_range(config.plant)
    for frequency in FREQUENCIES:
        if 3.0 * frequency * config.control_period > 1.0:
            continue
        largest = SPEED_SHARE * full_speed(config.plant, centre) / (2.0 * np.pi * frequency)
        size = min(AMPLITUDE_SHARE * (high - low), largest)
        time, first = _samples(frequency, config.control_period)
        task = own_reference(config, centre + size * np.sin(2.0 * np.pi * frequency * time))
        for preview in (True, False) if config.references.preview_times else (False,):
            rollout = play(task, hidden=not preview)
            answer, rest = sine_fit(rollout.position[:, first:], rollout.time[first:], frequency)
            asked, _ = sine_fit(rollout.reference[:, first:], rollout.time[first:], frequency)
            yield {
                "preview": preview,
                "frequency_hz": frequency,
                "amplitude_mm": 1e3 * size,
                "gain": np.abs(answer / asked),
                "phase_deg": np.angle(answer / asked, deg=True),
                "rest": rest / size,
            }


def _samples(frequency: float, period: float) -> tuple[Floats, int]:
    """Times of all samples in s, and the first sample of the fit; the fit covers whole cycles."""
    settling = max(SETTLING, 2.0 / frequency)
    cycles = max(int(np.ceil(WATCHED * frequency)), 3)
    first = round(settling / period)
    last = first + round(cycles / (frequency * period))
    return period * np.arange(last + 1, dtype=np.float64), first


def bandwidths(table: pd.DataFrame) -> pd.DataFrame:
    """Frequencies at which the gain falls below −3 dB and the phase below −90°, and the highest gain.

    Args:
        table: of the experiment ``frequency``, with the column ``controller``.

    Returns:
        Per controller, preview and leak: minus_3_db_hz, minus_90_deg_hz (medians of the plants; infinity: beyond the
        sweep), the lowest value of all plants (``_lowest``), and peak_gain (highest of all plants and frequencies).
    """
    rows, by = [], ["controller", "preview", "leakage_flow_lpm"]
    for key, frame in table.assign(gain_db=20.0 * np.log10(table["gain"])).groupby(by, sort=False):
        row: dict[str, Any] = dict(zip(by, key, strict=True))
        for name, column, level in (("minus_3_db_hz", "gain_db", -3.0), ("minus_90_deg_hz", "phase_deg", -90.0)):
            plants = frame.groupby("seed", sort=False)
            crossings = [crossing(own["frequency_hz"].to_numpy(), own[column].to_numpy(), level) for _, own in plants]
            row |= {name: float(np.median(crossings)), f"{name}_lowest": min(crossings)}
        rows.append(row | {"peak_gain": float(frame["gain"].max())})
    return pd.DataFrame(rows)


def crossing(frequency: Floats, values: NDArray[np.floating], level: float) -> float:
    """First frequency at which values fall below a level, interpolated over log f; infinity if they never do."""
    below = np.flatnonzero(np.asarray(values) < level)
    if len(below) == 0:
        return float("inf")
    i = int(below[0])
    if i == 0:
        return float(frequency[0])
    share = (values[i - 1] - level) / (values[i - 1] - values[i])
    return float(frequency[i - 1] * (frequency[i] / frequency[i - 1]) ** share)


# Stiffness ------------------------------------------------------------------------------------------------------------

FORCE_SHARE = 0.2  # amplitude of the force as a share of the force that the supply of the nominal rig gives

BEFORE, AFTER, JUDGED = 1.0, 2.0, 0.5
"""s: time before the force step, time after it, and last part of each, over which the position is averaged."""

RECOVERED = 0.1  # recovery band as a share of the peak deviation; at least one step of the position sensor


def sudden_force(config: TaskConfig, play: Play) -> Iterator[dict[str, Any]]:
    """A sudden external force of drawn sign on an axis at rest, without sensor noise, which would hide the recovery.

    Columns: force_n, peak_mm (largest deviation), recovery_s (until the deviation stays within a tenth of the peak
    about its final value; NaN if not by the end, as in a limit cycle), remaining_mm (deviation at the end, absolute),
    static_mm_per_kn and dynamic_mm_per_kn (remaining and largest deviation per force).
    """
    newtons, begin = FORCE_SHARE * min(force_limits(config.plant)), BEFORE / (BEFORE + AFTER)
    task = _with_force(noiseless(config), newtons, BEFORE + AFTER, kind="step", start_range=(begin, begin))
    period = config.control_period
    first, judged = round(BEFORE / period), round(JUDGED / period)
    position = play(task).position.astype(np.float64)
    deviation = position - position[:, first - judged : first].mean(axis=1, keepdims=True)
    peak, remaining = np.abs(deviation[:, first:]).max(axis=1), deviation[:, -judged:].mean(axis=1)
    band = np.maximum(RECOVERED * peak, config.sensors.position.resolution)
    outside = np.abs(deviation[:, first:] - remaining[:, None]) > band[:, None]
    recovered = outside.shape[1] - np.argmax(outside[:, ::-1], axis=1)  # samples until the last one outside
    lasting = outside[:, -judged:].any(axis=1)
    yield {
        "force_n": newtons,
        "peak_mm": 1e3 * peak,
        "recovery_s": np.where(lasting, np.nan, period * np.where(outside.any(axis=1), recovered, 0)),
        "remaining_mm": 1e3 * np.abs(remaining),
        "static_mm_per_kn": 1e6 * np.abs(remaining) / newtons,
        "dynamic_mm_per_kn": 1e6 * peak / newtons,
    }


def _with_force(config: TaskConfig, newtons: float, duration: float, **disturbance: Any) -> TaskConfig:
    """The task of holding the working position for some time (s) against an external force (N)."""
    force = {"force_range": (newtons, newtons), "force_share": (0.0, 0.0), **disturbance}
    return task_config(_holding(config, working_place(config.plant), duration), disturbance=force)


# Standstill under noise -----------------------------------------------------------------------------------------------

STANDSTILL_LEAKS = (0.01, 0.3, 1.0, 4.0, 8.0)  # l/min at 100 bar
PLACES = (0.0, 0.3, -0.3)  # held positions: shares of the range that the supply can hold
REST, HELD = 2.0, 6.0  # s from the start to the evaluation, and length of the evaluation


def standstills(config: TaskConfig, play: Play) -> Iterator[dict[str, Any]]:
    """A held position with the noise of the sensors.

    Columns: place_mm, unrest_um (root mean square of the position's motion), offset_um (mean of |reference − reading|,
    frame of the sensor), valve_travel_per_s (full strokes), failed.
    """
    judged = slice(-round(HELD / config.control_period), None)
    for place in PLACES:
        position = working_place(config.plant, place)
        rollout = play(_holding(config, position, REST + HELD))
        held, spool = (values[:, judged].astype(np.float64) for values in (rollout.position, rollout.spool))
        yield {
            "place_mm": 1e3 * position,
            "unrest_um": 1e6 * held.std(axis=1),
            "offset_um": 1e6 * np.abs(held.mean(axis=1) + rollout.position_bias - position),
            "valve_travel_per_s": np.abs(np.diff(spool, axis=1)).sum(axis=1) / HELD,
            "failed": rollout.failed_at >= 0,
        }


def _holding(config: TaskConfig, position: float, seconds: float) -> TaskConfig:
    """The task of holding a position (m)."""
    return own_reference(config, np.full(round(seconds / config.control_period) + 1, position))


# Parts of a protocol --------------------------------------------------------------------------------------------------

EXPERIMENTS = {
    "frequency": Experiment(sine_references),
    "force_step": Experiment(sudden_force, plants=8),
    "hold": Experiment(standstills, STANDSTILL_LEAKS, plants=8),
}
"""Experiments by the names of their parts."""


def _cells(experiment: str, protocol: RobustnessProtocol, chosen: Participants) -> Iterator[Cell]:
    """An experiment on every controller of a protocol; of several training seeds the first takes part."""
    controllers: dict[str, Controller] = {}
    for name, controller in chosen.controllers.items():
        controllers.setdefault(split_name(name)[0], controller)
    for name, controller in controllers.items():
        job = Job(measured, controller, (protocol.task, experiment), fingerprint(controller))
        yield Cell(name, known={"controller": name}, jobs=(job,))


def measured(controller: Controller, config: TaskConfig, experiment: str) -> Columns:
    """The table of an experiment on a controller.

    Raises:
        ControllerError: the controller raises an exception or returns no finite commands.
    """
    table = EXPERIMENTS[experiment](config, controller)
    if experiment == "frequency":  # a continuous phase
        parts = table.groupby(["preview", "leakage_flow_lpm", "seed"], sort=False)
        table["phase_deg"] = parts["phase_deg"].transform(lambda phase: np.unwrap(phase, period=360.0))
    return columns_of(table)


frequency, force_step, hold = (partial(_cells, name) for name in EXPERIMENTS)
