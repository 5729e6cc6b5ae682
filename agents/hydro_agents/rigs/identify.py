"""``hydro identify``: from a recording and a rig file to the identified rig."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from hydro_agents.estimation.estimate import usable_readings
from hydro_agents.estimation.model import LONG_STEP, Model
from hydro_agents.estimation.solver import equations_of, prior_belief, without
from hydro_agents.estimation.unknowns import EXTERNAL_LEAKAGE, LEAKAGE, priors_of, starts_of
from hydro_agents.recordings.columns import ColumnMap
from hydro_agents.recordings.quality import AXIS, Checked, check_recording
from hydro_agents.recordings.recording import Recording, read_recording
from hydro_agents.rigs.fit import DETERMINED, Combination, Fit, Progress, combinations, fit_windows
from hydro_agents.rigs.found_rig import beyond_range, found_biases, found_plant, share_in_words, shown
from hydro_agents.rigs.parts import POSITION, HeldBack, Parts, parts_of, simulate_held_back
from hydro_env import ConfigurationError, HydroError, PlantParameters, TaskConfig, __version__
from hydro_env.plant.analysis import reachable_range, speed_limits
from hydro_env.plant.arrays import equilibrium
from hydro_env.task.rig import Rig
from hydro_env.task.sensors import SENSORS

Array = NDArray[np.float64]

LEAST_SHARE = 0.9  # smallest share of the position's variance on the held-back part of a model that describes the axis


DURATION = 8.0  # s, of each candidate motion

LEAST_GAIN = 0.8
"""A motion is recommended if it lowers the standard deviation to less than this share of the present one."""


class Advice(NamedTuple):
    """The most informative motion for an unknown."""

    motion: str
    remaining: float  # standard deviation after it, as a share of the range's
    enough: bool  # whether the unknown is then determined


class Identification(NamedTuple):
    """All results of an identification."""

    recording: Recording
    checked: Checked
    rig: Rig
    config: TaskConfig
    parts: Parts
    fit: Fit
    plant: PlantParameters
    held_back: HeldBack
    combinations: list[Combination]
    advice: dict[str, Advice | None]

    @property
    def share(self) -> float:
        """Share of the position's variance that is explained on the held-back part; NaN if the axis stood still."""
        return float(self.held_back.share[POSITION])

    @property
    def describes(self) -> bool:
        """Whether the model describes the axis."""
        explained = bool(self.fit.explained.mean() >= 0.5)
        if math.isnan(self.share) or self.beyond:
            return explained and not self.share < LEAST_SHARE
        return self.share >= LEAST_SHARE

    @property
    def beyond(self) -> list[str]:
        """Parameters with values outside their ranges, as text."""
        names = beyond_range(self.fit, self.config, self.rig.randomisation)
        return [shown(name, self.config.plant).words for name in names]

    @property
    def noted(self) -> list[str]:
        """Notes about the fit for the user, as sentences."""
        count, explained = len(self.fit.misfit), int(self.fit.explained.sum())
        left_out = int(np.isinf(self.fit.misfit).sum())
        notes = []
        if not self.rig.randomisation:
            notes.append(
                "The rig file gives no ranges: only the leak and the sensors' offsets were fitted. Write a range for "
                "each unknown value in its group randomisation."
            )
        if left_out:
            notes.append(
                f"Left out, because the model fits them far worse than the others: {left_out} of {count} windows."
            )
        if not {"pressure_a_bias", "pressure_b_bias"} & set(self.fit.names) and self.config.sensors.enabled:
            notes.append("No pressure was recorded: the intervals are too narrow (docs/identify.md). Record pressures.")
        if self.beyond:
            notes.append(f"Outside the range of the rig file: {', '.join(self.beyond)}. Check the range in that file.")
        if explained < 0.5 * count:
            notes.append(
                "The readings differ from the model by more than the sensors' noise. The intervals are therefore wider "
                f"(factor {self.fit.widening:.2g}), but may still be too narrow."
            )
        return notes

    def verdict(self) -> str:
        """The result in one sentence."""
        known, count = int(self.fit.determined.sum()), len(self.fit.names)
        if not self.describes:
            what = f"explains {share_in_words(self.share)} of the position's variance on the held-back part"
            if math.isnan(self.share):
                what = f"explains {int(self.fit.explained.sum())} of {len(self.fit.misfit)} windows"
            elif self.share >= LEAST_SHARE:
                what = f"fits it only with values outside the rig file's ranges ({', '.join(self.beyond)})"
            return "; ".join(
                [
                    f"the model does not describe this axis: it {what}",
                    "another machine, a wrong sign or unit, or a fault",
                    *_driven(self.checked),
                ]
            )
        outcome = "the axis stood still on the held-back part"
        if not math.isnan(self.share):
            outcome = f"{share_in_words(self.share)} of the position's variance explained on the held-back part"
        return "; ".join([f"{known} of {count} unknowns determined", outcome, *_driven(self.checked)])


def _driven(checked: Checked) -> list[str]:
    """That the axis oscillates or its valve saturates, as phrases."""
    return [finding.line() for finding in checked.findings if finding.signal == AXIS]


def identify(
    path: Path, config: TaskConfig, rig: Rig, columns: ColumnMap | None = None, progress: Progress | None = None
) -> Identification:
    """Read a recording, check it, fit the unknowns of the rig file, and test the fit on the held-back part.

    Args:
        path: the recording.
        config: the task on this rig.
        rig: the rig; its ranges define the unknown parameters.
        columns: the signal of each column; default: the names that ``hydro record`` writes.
        progress: called with phase, done, total.

    Raises:
        ConfigurationError: the recording cannot be read, contradicts the rig, or carries no information.
    """
    recording = read_recording(path, columns)
    checked = check_recording(recording, config)
    if checked.severe:
        raise ConfigurationError(f"{path}: {'; '.join([checked.severe[0].line(), *_driven(checked)])}")
    parts = parts_of(checked.samples, str(path))
    fit = fit_windows(parts.fitted.signals, config, rig.randomisation, progress)
    try:
        plant = found_plant(fit, config)
    except ConfigurationError as error:
        raise ConfigurationError(
            f"{path}: the model does not describe this axis: the fit ends at an impossible rig ({error})"
        ) from None
    held_back = simulate_held_back(parts.held_back, parts.begin, config, plant, found_biases(fit))
    advice = advise(fit, config, plant)
    return Identification(recording, checked, rig, config, parts, fit, plant, held_back, combinations(fit), advice)


def as_json(found: Identification, command: str) -> dict[str, Any]:
    """The result for programs; SI units, leaks in l/min at 100 bar; ``null`` if there is no number."""
    fit = found.fit

    def plain(value: float) -> float | None:
        return float(value) if math.isfinite(value) else None

    unknowns = {}
    for place, name in enumerate(fit.names):
        advice = found.advice.get(name)
        unknowns[name] = {
            "value": plain(fit.values[place]),
            "low": plain(fit.low[place]),
            "high": plain(fit.high[place]),
            "unit": "l/min at 100 bar" if name in (LEAKAGE, EXTERNAL_LEAKAGE) else "SI",
            "remaining": float(fit.remaining[place]),
            "determined": bool(fit.determined[place]),
            "motion_that_helps": advice.motion if advice is not None else None,
        }
    return {
        "command": command,
        "hydro_env": __version__,
        "recording": found.recording.source,
        "rig": found.rig.source,
        "describes": found.describes,
        "verdict": found.verdict(),
        "share_of_variance": {n: plain(s) for n, s in zip(SENSORS, found.held_back.share, strict=True)},
        "held_back_from_s": found.parts.begin,
        "windows": len(fit.misfit),
        "windows_explained": int(fit.explained.sum()),
        "widening": fit.widening,
        "unknowns": unknowns,
        "singular_values": [{"value": one.singular_value, "parts": dict(one.parts)} for one in found.combinations],
        "findings": [finding.line() for finding in [*found.checked.findings, *found.parts.findings]],
        "notes": found.noted,
    }


# Motions that would determine the undetermined unknowns ------------------------------------------------------------
#
# Each candidate is a voltage over some seconds from rest, in open loop, simulated on the identified rig. The
# derivatives of its readings give the information about every unknown, together with the recording.


class _Travel(NamedTuple):
    """Limits of the axis."""

    reach: float  # m, from end to end
    out: float  # m/s at full opening
    back: float  # m/s
    hold: float  # command that holds the middle position


def _commands(time: Array, can: _Travel) -> dict[str, Array]:
    """Commands (T,) of each candidate by name; each returns to its start."""

    def moves(share: float, travel: float, rest: float) -> Array:
        """Out and back at a share of the speed, with a rest at either end."""
        slowest = min(can.out, can.back)
        duration = travel * can.reach / (share * slowest)
        phase = np.mod(time, 2.0 * (duration + rest))
        out, back = phase < duration, (phase >= duration + rest) & (phase < 2.0 * duration + rest)
        return np.asarray(can.hold + share * slowest * (out / can.out - back / can.back))

    sweep = np.sin(2.0 * math.pi * (0.5 * time + 0.5 * (15.0 - 0.5) / time[-1] * time**2))
    return {
        "standing still": np.full_like(time, can.hold),
        "slow moves with reversals (5 % of full speed)": moves(0.05, 0.02, 0.0),
        "moves at half speed with rests of 0.5 s": moves(0.5, 0.2, 0.5),
        "fast moves with reversals (80 % of full speed)": moves(0.8, 0.2, 0.0),
        "full stroke out and back": moves(0.4, 0.7, 0.3),
        "a sine from 0.5 to 15 Hz at 20 % of full command": can.hold + 0.2 * sweep,
    }


def advise(fit: Fit, config: TaskConfig, plant: PlantParameters) -> dict[str, Advice | None]:
    """For each undetermined unknown, the most informative motion of the identified plant; ``None`` if none helps."""
    wanted = [name for name, known in zip(fit.names, fit.determined, strict=True) if not known]
    if not wanted:
        return {}
    try:
        low, high = reachable_range(plant)
        middle = 0.5 * (low + high)
        state, voltage = equilibrium(plant, middle)
        speeds = speed_limits(plant, plant.load.external_force + plant.load.spring_stiffness * middle)
    except HydroError:
        return dict.fromkeys(wanted)
    can = _Travel(high - low, speeds.extending, speeds.retracting, voltage / 10.0)
    if not min(can.reach, can.out, can.back) > 0.0:
        return dict.fromkeys(wanted)
    time = config.control_period * np.arange(round(DURATION / config.control_period), dtype=np.float64)
    commands = _commands(time, can)
    information = _information(np.clip(list(commands.values()), -1.0, 1.0), fit, config, state)
    # The recording is weighted by its widened intervals.
    present = fit.information / fit.widening**2 + np.eye(len(fit.names))
    after = np.sqrt(np.einsum("mii->mi", np.linalg.inv(present + information / fit.widening**2)))
    advice: dict[str, Advice | None] = {}
    for name in wanted:
        place = fit.names.index(name)
        best = int(after[:, place].argmin())
        left = float(after[best, place])
        helps = left < LEAST_GAIN * fit.remaining[place]
        advice[name] = Advice(list(commands)[best], left, left <= DETERMINED) if helps else None
    return advice


def _information(commands: Array, fit: Fit, config: TaskConfig, state: dict[str, float]) -> Array:
    """Information of each candidate about the unknowns, (motions, p, p), with an unknown start."""
    starts = starts_of(config)
    priors = fit.priors | priors_of(config, starts)
    model = Model(config, priors, commands)
    values = [*fit.values, *(state[name.removeprefix("start.")] for name in starts)]
    scaled = model.scaled(np.tile(values, (len(commands), 1)))
    shared = np.arange(len(fit.names))
    precision = np.tile(np.eye(len(priors)), (len(commands), 1, 1))
    precision[:, shared[:, None], shared] += fit.information / fit.widening**2
    linear = model.linearise(scaled, None, model.directions(precision, LONG_STEP))
    measured = linear.readings * model.noise[:, None]
    for row, channel in enumerate(SENSORS):  # absent sensors give no information
        if f"{channel}_bias" not in fit.names and config.sensors.enabled:
            measured[:, row] = np.nan
    signals = np.concatenate([measured, commands[:, None]], axis=1)
    known = np.isfinite(usable_readings(signals, config, model))
    jacobian = np.where(known[:, None], linear.jacobian, 0.0).reshape(len(commands), len(priors), -1)
    ones = np.ones((len(commands), jacobian.shape[2]))
    prior = without(prior_belief(model, model.count).precision, shared)
    return equations_of(0.0 * ones, jacobian, ones, scaled, prior, shared).information
