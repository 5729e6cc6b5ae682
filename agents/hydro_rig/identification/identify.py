"""``hydro identify``: from a recording and a rig file to the identified rig."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np

from hydro_env import ConfigurationError, TaskConfig
from hydro_env.task.randomisation import Distribution
from hydro_env.task.rig import Rig
from hydro_env.task.sensors import COMMAND, POSITION
from hydro_rig.estimation.unknowns import LATENCY, RISE_TIME
from hydro_rig.identification.data_sheet import off_the_sheet
from hydro_rig.identification.fit import Fit, Unknown, fit_windows
from hydro_rig.identification.found_rig import beyond_range, found_plant, share_in_words, shown
from hydro_rig.identification.held_back import (
    JUDGED_OVER,
    Forecast,
    HeldBack,
    errors_in_words,
    forecast,
    simulate_held_back,
    whole_parts,
)
from hydro_rig.recordings.columns import ColumnMap, matching
from hydro_rig.recordings.findings import Findings
from hydro_rig.recordings.parts import Parts, parts_of
from hydro_rig.recordings.quality import Checked, check_recording
from hydro_rig.recordings.recording import Recording, read_recording
from hydro_rig.recordings.sampling import on_grid

LEAST_EXPLAINED = 0.9  # of the position's variance on the held-back part, by a model that describes the axis
RATED_FLOW, KNEE_OPENING = "valve.rated_flow", "valve.knee_opening"
BENDS_FROM = 3  # amplitudes of the command
BEND = (0.7, 1.4)  # range of the opening at the knee, relative to that of a straight valve
UNEXPLAINED = (
    "no window is explained: a number of the rig file without a range is wrong, or the model lacks a property of the "
    "axis, and the intervals may not hold"
)


@dataclass(frozen=True)
class Identification:
    """All results of an identification."""

    recordings: list[Recording]
    checked: list[Checked]  # by recording
    rig: Rig
    config: TaskConfig
    parts: Parts
    fit: Fit
    held_back: list[HeldBack]

    @cached_property
    def whole(self) -> Forecast:
        """The test on each held-back part as a whole."""
        return whole_parts(self.held_back)

    @cached_property
    def ahead(self) -> Forecast | None:
        """The test over JUDGED_OVER from measured states of the held-back parts; ``None``: they are too short."""
        return forecast(self.held_back)

    @property
    def decisive(self) -> Forecast:
        """The test that decides: each part as a whole if the model explains that; otherwise the forecasts.

        Nothing holds an axis under control in place once it is simulated with the commands alone: the smallest error of
        the null adds up.
        """
        whole, ahead = self.whole, self.ahead
        if ahead and whole.share[POSITION] < LEAST_EXPLAINED <= ahead.share[POSITION]:
            return ahead
        return whole

    @property
    def share(self) -> float:
        """Share of the position's variance that is explained on the held-back part; NaN if the axis stood still."""
        return self.decisive.share[POSITION]

    @property
    def findings(self) -> Findings:
        """All findings; with several recordings each begins with the name of its file."""
        found = []
        for recording, checked, changes in zip(self.recordings, self.checked, self.parts.findings, strict=True):
            name = f"{Path(recording.source).name}: " if len(self.recordings) > 1 else ""
            found += [one._replace(signal=name + one.signal) for one in (*checked.findings, *changes)]
        return found

    @property
    def describes(self) -> bool:
        """Whether the model describes the axis."""
        if math.isnan(self.share) or self.beyond:
            return self.fit.explained.mean() >= 0.5 and not self.share < LEAST_EXPLAINED
        return self.share >= LEAST_EXPLAINED

    @property
    def unexplained(self) -> bool:
        """Whether the model explains no window within the sensors' noise: its values and intervals are doubtful."""
        return not self.fit.explained.any()

    @property
    def undetermined(self) -> list[Unknown]:
        """The unknowns that the recordings do not determine."""
        return [one for one in self.fit.unknowns if not self.fit.knows(one)]

    @cached_property
    def beyond(self) -> list[str]:
        """Parameters with values outside their ranges, as text."""
        return [shown(name).words for name in beyond_range(self.fit, self.config, self.rig.randomisation)]

    @property
    def noted(self) -> list[str]:
        """Notes about the fit for the user, as sentences."""
        fit, config, notes = self.fit, self.config, []
        if not self.rig.randomisation:
            notes.append(
                "The rig file gives no ranges: only the leak and the sensors' offsets were fitted. Write a range for "
                "each unknown value in its group randomisation."
            )
        own = fit.own()
        latency = own.get(LATENCY, config.command_latency)
        rise_time = own.get(RISE_TIME, config.sensors.pressure_rise_time)
        odd = off_the_sheet(latency, rise_time, fit.noise, config)
        notes += [f"{signal} {what}: used." for signal, what in odd]
        if self.beyond:
            notes.append(f"Outside the range of the rig file: {', '.join(self.beyond)}. Check the range in that file.")
        if self.beyond == [shown(RATED_FLOW).words]:
            notes.append(
                "Only the rated flow over the root of the rated pressure drop acts: a wrong drop in the file gives "
                "another flow, and no other value changes. Check both against the valve's data sheet."
            )
        if fit.explained.mean() < 0.5:
            widening = np.median([one.widening for one in fit.unknowns])
            notes.append(
                f"The model explains {fit.explained.sum()} of {len(fit.misfit)} windows to within the sensors' noise. "
                f"The intervals are wider (factor {widening:.2g}), but may still be too narrow."
            )
        return notes

    def verdict(self) -> str:
        """The result in one sentence."""
        return "; ".join(self._success() if self.describes else self._failure())

    def _failure(self) -> list[str]:
        if math.isnan(self.share):
            what = f"explains {self.fit.explained.sum()} of {len(self.fit.misfit)} windows"
        elif self.share >= LEAST_EXPLAINED:
            what = f"fits it only with values outside the rig file's ranges ({', '.join(self.beyond)}); wrong ranges"
        else:
            what = f"explains {share_in_words(self.share)} of the position's variance on the held-back part"
        return [
            f"the model does not describe this axis: it {what}",
            "another machine, a wrong sign or unit, or a fault",
        ]

    def _success(self) -> list[str]:
        count = len(self.fit.unknowns)
        outcome = f"{share_in_words(self.share)} of the position's variance explained on the held-back part"
        if math.isnan(self.share):
            outcome = "the axis stood still on the held-back part"
        if self.decisive is self.ahead:
            outcome += f" over {JUDGED_OVER:g} s from a measured state (over all of it the errors add up)"
        errors = errors_in_words(self.decisive)
        phrases = [f"{count - len(self.undetermined)} of {count} unknowns determined", outcome]
        if self.unexplained:
            phrases.insert(0, UNEXPLAINED)
        if errors:
            phrases.append(f"root mean square error there {errors}")
        return phrases


def identify(
    paths: Sequence[Path],
    config: TaskConfig,
    rig: Rig,
    maps: Sequence[ColumnMap | None] | None = None,
    hold_back: Sequence[str] = (),
) -> Identification:
    """Read recordings of one axis, check them, fit the unknowns of the rig file, and test the fit on held-back parts.

    Each recording may have its own sensors, and a map (as of :func:`~hydro_rig.recordings.recording.read_recording`);
    all share the unknowns, which the ranges of the rig define. ``hold_back``: patterns of names of recordings that test
    the fit instead of being used for it; default: chosen by motion and amplitude
    (:func:`~hydro_rig.recordings.parts.parts_of`).

    Raises:
        ConfigurationError: a recording cannot be read, contradicts the rig, or carries no information.
    """
    sources = [str(path) for path in paths]
    for source in sources:
        if sources.count(source) > 1:
            raise ConfigurationError(f"{source}: is given twice")
    apart = {path for pattern in hold_back for path in matching(paths, pattern, "--hold-back")}
    if len(apart) == len(paths):
        raise ConfigurationError("--hold-back: matches every recording; nothing is left for the fit")
    whole = {number for number, path in enumerate(paths) if path in apart}
    recordings = [read_recording(path, own) for path, own in zip(paths, maps or [None] * len(paths), strict=True)]
    checked = _on_one_grid(recordings, config)
    for source, one in zip(sources, checked, strict=True):
        if one.severe:
            raise ConfigurationError(f"{source}: {one.severe[0].line()}")
    config = on_grid(config, checked[0].samples.period)
    parts = parts_of([one.samples for one in checked], sources, whole)
    config, rig = _with_bent_valve(config, rig, parts)
    fit = fit_windows(parts.fitted, config, rig.randomisation, parts.recording)
    try:
        plant = found_plant(fit, config)
    except ConfigurationError as error:
        raise ConfigurationError(
            f"{sources[0]}: the model does not describe this axis: the fit ends at an impossible rig ({error})"
        ) from None
    held_back = [simulate_held_back(part, config, plant, fit.own()) for part in parts.held_back]
    return Identification(recordings, checked, rig, config, parts, fit, held_back)


def _with_bent_valve(config: TaskConfig, rig: Rig, parts: Parts) -> tuple[TaskConfig, Rig]:
    """Task and rig whose valve's flow over its opening may bend at half the largest command.

    Only several amplitudes show the bend; a bend that the rig file describes stays as it is.
    """
    valve = config.plant.valve
    described = valve.knee_position != valve.knee_opening or KNEE_OPENING in rig.randomisation
    if parts.amplitudes < BENDS_FROM or described:
        return config, rig
    largest = np.nanmax(np.abs(parts.fitted.signals[:, COMMAND]))
    knee = round(0.5 * min(largest, 1.0), 3)
    plant = config.plant.replace(valve={"knee_position": knee, "knee_opening": knee})
    low, high = (knee * factor for factor in BEND)
    ranges = rig.randomisation | {KNEE_OPENING: Distribution(uniform=(low, high))}
    return config.changed(plant=plant), rig._replace(randomisation=ranges)


def _on_one_grid(recordings: Sequence[Recording], config: TaskConfig) -> list[Checked]:
    """The checked recordings with one sample time: the control period, or that of the logs where one lacks it."""
    checked = [check_recording(recording, config) for recording in recordings]
    if len({one.samples.period for one in checked if not one.severe}) > 1:
        checked = [check_recording(recording, config, own_grid=True) for recording in recordings]
    first = checked[0].samples.period
    for recording, one in zip(recordings, checked, strict=True):
        if one.samples.period != first and not any(each.severe for each in checked):
            raise ConfigurationError(
                f"{recording.source}: has one sample every {1e3 * one.samples.period:.4g} ms, {recordings[0].source} "
                f"every {1e3 * first:.4g} ms; recordings that are identified together need the same sample time"
            )
    return checked
