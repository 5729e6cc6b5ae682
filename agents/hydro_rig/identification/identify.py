"""``hydro identify``: from a recording and a rig file to the identified rig."""

from __future__ import annotations

import math
from collections.abc import Sequence
from fnmatch import fnmatch
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from hydro_env import ConfigurationError, PlantParameters, TaskConfig, __version__
from hydro_env.task.randomisation import Distribution
from hydro_env.task.rig import Rig
from hydro_env.task.sensors import COMMAND, POSITION, SENSORS
from hydro_rig.estimation.unknowns import EXTERNAL_LEAKAGE, LATENCY, LEAKAGE, RISE_TIME
from hydro_rig.identification.advice import Advice, advise
from hydro_rig.identification.data_sheet import LATENCY_CHANGE, RISE_TIME_CHANGE
from hydro_rig.identification.fit import Combination, Fit, Progress, combinations, fit_windows
from hydro_rig.identification.found_rig import (
    beyond_range,
    found_biases,
    found_gains,
    found_plant,
    found_timing,
    share_in_words,
    shown,
)
from hydro_rig.identification.held_back import (
    HORIZONS,
    JUDGED_OVER,
    Forecast,
    HeldBack,
    errors_in_words,
    forecast_over,
    simulate_held_back,
    whole_parts,
)
from hydro_rig.identification.repeatability import Repeat, repeats_of, share_inside, widened
from hydro_rig.recordings.columns import ColumnMap
from hydro_rig.recordings.driving import AXIS
from hydro_rig.recordings.findings import Finding
from hydro_rig.recordings.parts import Parts, parts_of
from hydro_rig.recordings.quality import Checked, check_recording
from hydro_rig.recordings.recording import Recording, read_recording
from hydro_rig.recordings.sampling import on_grid

LEAST_SHARE = 0.9  # smallest share of the position's variance on the held-back part of a model that describes the axis

RATED_FLOW = "valve.rated_flow"
KNEE_OPENING = "valve.knee_opening"
BENDS_FROM = 3  # amplitudes of the command
BEND = (0.7, 1.4)  # range of the opening at the knee, relative to that of a straight valve
UNEXPLAINED = (
    "no window is explained: a number of the rig file without a range is wrong, or the model lacks a property of the "
    "axis, and the intervals may not hold"
)


class Identification(NamedTuple):
    """All results of an identification."""

    recordings: list[Recording]
    checked: list[Checked]  # by recording
    rig: Rig
    config: TaskConfig
    parts: Parts
    fit: Fit
    plant: PlantParameters
    held_back: list[HeldBack]
    combinations: list[Combination]
    advice: dict[str, Advice | None]
    repeats: list[Repeat]

    @property
    def tested(self) -> dict[float, Forecast]:
        """The test on the held-back parts by time in s from a measured state; infinite: each part as a whole."""
        ahead = {seconds: forecast_over(self.held_back, seconds) for seconds in HORIZONS}
        found = {seconds: forecast for seconds, forecast in ahead.items() if forecast is not None}
        return found | {math.inf: whole_parts(self.held_back)}

    @property
    def judged_over(self) -> float:
        """Time in s that decides: infinite, each part as a whole, if the model explains that; otherwise 2 s.

        Nothing holds an axis under control in place once it is simulated with the commands alone: the smallest error of
        the null adds up.
        """
        shares = {over: float(forecast.share[POSITION]) for over, forecast in self.tested.items()}
        better = shares[math.inf] < LEAST_SHARE <= shares.get(JUDGED_OVER, 0.0)
        return JUDGED_OVER if better else math.inf

    @property
    def share(self) -> float:
        """Share of the position's variance that is explained on the held-back part; NaN if the axis stood still."""
        return float(self.tested[self.judged_over].share[POSITION])

    @property
    def source(self) -> str:
        """The recordings in a few words."""
        first = self.recordings[0].source
        return first if len(self.recordings) == 1 else f"{first} and {len(self.recordings) - 1} more"

    @property
    def findings(self) -> list[Finding]:
        """All findings; with several recordings each begins with the name of its file."""
        named = len(self.recordings) > 1
        return [
            finding._replace(signal=f"{Path(recording.source).name}: {finding.signal}") if named else finding
            for recording, checked, changes in zip(self.recordings, self.checked, self.parts.findings, strict=True)
            for finding in [*checked.findings, *changes]
        ]

    @property
    def describes(self) -> bool:
        """Whether the model describes the axis."""
        explained = bool(self.fit.explained.mean() >= 0.5)
        if math.isnan(self.share) or self.beyond:
            return explained and not self.share < LEAST_SHARE
        return self.share >= LEAST_SHARE

    @property
    def unexplained(self) -> bool:
        """Whether the model explains no window within the sensors' noise: its values and intervals are doubtful."""
        return not self.fit.explained.any()

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
        usual = {
            LATENCY: (self.config.command_latency, LATENCY_CHANGE * self.config.control_period, LATENCY),
            RISE_TIME: (self.config.sensors.pressure_rise_time, RISE_TIME_CHANGE, f"sensors.{RISE_TIME}"),
        }
        for name, value in found_timing(self.fit).items():
            assumed, least, field = usual[name]
            if abs(value - assumed) > least:
                notes.append(
                    f"The {shown(name, self.config.plant).words} is {1e3 * value:.2g} ms in the recording, and not "
                    f"{1e3 * assumed:.2g} ms ({field} of the task): used."
                )
        if left_out:
            notes.append(
                f"Left out, because the model fits them far worse than the others: {left_out} of {count} windows."
            )
        if self.one_sided:
            notes.append(
                "Only one end is known, because no motion of the recording reached the limit: "
                f"{'; '.join(self.one_sided)}. The rig file keeps its value where that is possible."
            )
        if self.fit.second:
            others = [
                f"{shown(name, self.config.plant).words} {shown(name, self.config.plant).value(value, 0.01 * value)}"
                for name, value in self.fit.second.items()
            ]
            notes.append(f"Other values explain the recording as well: {', '.join(others)}. A richer motion decides.")
        if self.beyond:
            notes.append(f"Outside the range of the rig file: {', '.join(self.beyond)}. Check the range in that file.")
        if self.beyond == [shown(RATED_FLOW, self.config.plant).words]:
            notes.append(
                "Only the rated flow over the root of the rated pressure drop acts: a wrong drop in the file gives "
                "another flow, and no other value changes. Check both against the valve's data sheet."
            )
        if explained < 0.5 * count:
            notes.append(
                "The readings differ from the model by more than the sensors' noise. The intervals are therefore wider "
                f"(factor {float(np.median(self.fit.widening)):.2g}), but may still be too narrow."
            )
        return notes

    @property
    def one_sided(self) -> list[str]:
        """Parameters of which only one end of the interval is known, as text: ``valve: slew limit at least 98``."""
        fit, plant = self.fit, self.config.plant
        sides = zip(fit.names, fit.low.tolist(), fit.high.tolist(), fit.side.tolist(), strict=True)
        looks = [(shown(name, plant), low, high, side) for name, low, high, side in sides if side]
        return [f"{look.words} {look.interval(*ends)} {look.unit}".rstrip() for look, *ends in looks]

    def verdict(self) -> str:
        """The result in one sentence."""
        known, count = int(self.fit.determined.sum()), len(self.fit.names)
        if not self.describes:
            what = f"explains {share_in_words(self.share)} of the position's variance on the held-back part"
            if math.isnan(self.share):
                what = f"explains {int(self.fit.explained.sum())} of {len(self.fit.misfit)} windows"
            elif self.share >= LEAST_SHARE:
                what = (
                    f"fits it only with values outside the rig file's ranges ({', '.join(self.beyond)}); wrong ranges"
                )
            return "; ".join(
                [
                    f"the model does not describe this axis: it {what}",
                    "another machine, a wrong sign or unit, or a fault",
                    *self._driven,
                ]
            )
        outcome = "the axis stood still on the held-back part"
        if not math.isnan(self.share):
            outcome = f"{share_in_words(self.share)} of the position's variance explained on the held-back part"
        if math.isfinite(self.judged_over):
            outcome += f" over {self.judged_over:g} s from a measured state (over all of it the errors add up)"
        errors = errors_in_words(self.tested[self.judged_over])
        errors = f"root mean square error there {errors}" if errors else ""
        doubt = UNEXPLAINED if self.unexplained else ""
        known_words = f"{known} of {count} unknowns determined"
        return "; ".join(filter(None, [doubt, known_words, outcome, errors, *self._driven]))

    @property
    def _driven(self) -> list[str]:
        return [line for checked in self.checked for line in driven(checked)]


def driven(checked: Checked) -> list[str]:
    """That the axis oscillates or its valve saturates, as phrases."""
    return [finding.line() for finding in checked.findings if finding.signal == AXIS]


def identify(
    paths: Path | Sequence[Path],
    config: TaskConfig,
    rig: Rig,
    columns: ColumnMap | Sequence[ColumnMap | None] | None = None,
    progress: Progress | None = None,
    hold_back: Sequence[str] = (),
) -> Identification:
    """Read recordings of one axis, check them, fit the unknowns of the rig file, and test the fit on held-back parts.

    Args:
        paths: the recording, or several; each may have its own sensors. All share the unknowns of the rig.
        config: the task on this rig.
        rig: the rig; its ranges define the unknown parameters.
        columns: the signal of each column, one map for all or one for each; default: the names that ``hydro record``
            writes.
        progress: called with phase, done, total.
        hold_back: patterns of names of recordings that test the fit instead of being used for it; default: chosen by
            motion and amplitude (:func:`~hydro_rig.recordings.parts.parts_of`).

    Raises:
        ConfigurationError: a recording cannot be read, contradicts the rig, or carries no information.
    """
    paths = [paths] if isinstance(paths, Path) else list(paths)
    maps = [columns] * len(paths) if columns is None or isinstance(columns, ColumnMap) else list(columns)
    sources = [str(path) for path in paths]
    for source in sources:
        if sources.count(source) > 1:
            raise ConfigurationError(f"{source}: is given twice")
    whole = _matching(paths, hold_back)
    recordings = [read_recording(path, own) for path, own in zip(paths, maps, strict=True)]
    checked = _on_one_grid(recordings, config)
    for source, one in zip(sources, checked, strict=True):
        if one.severe:
            raise ConfigurationError(f"{source}: {'; '.join([one.severe[0].line(), *driven(one)])}")
    config = on_grid(config, checked[0].samples.period)
    parts = parts_of([one.samples for one in checked], sources, whole)
    config, rig = _with_bent_valve(config, rig, parts)
    fit = widened(fit_windows(parts.fitted, config, rig.randomisation, progress), parts.recording)
    try:
        plant = found_plant(fit, config)
    except ConfigurationError as error:
        raise ConfigurationError(
            f"{sources[0]}: the model does not describe this axis: the fit ends at an impossible rig ({error})"
        ) from None
    biases, timing = found_biases(fit), found_timing(fit) | found_gains(fit)
    held_back = [simulate_held_back(part, config, plant, biases, timing) for part in parts.held_back]
    advice, repeats = advise(fit, config, plant), repeats_of(fit, parts.recording)
    found = combinations(fit)
    return Identification(recordings, checked, rig, config, parts, fit, plant, held_back, found, advice, repeats)


def _with_bent_valve(config: TaskConfig, rig: Rig, parts: Parts) -> tuple[TaskConfig, Rig]:
    """Task and rig whose valve's flow over its opening may bend at half the largest command.

    Only several amplitudes show the bend; a bend that the rig file describes stays as it is.
    """
    valve = config.plant.valve
    described = valve.knee_position != valve.knee_opening or KNEE_OPENING in rig.randomisation
    if parts.amplitudes < BENDS_FROM or described:
        return config, rig
    largest = float(np.nanmax(np.abs(parts.fitted.signals[:, COMMAND])))
    knee = round(0.5 * min(largest, 1.0), 3)
    plant = config.plant.replace(valve={"knee_position": knee, "knee_opening": knee})
    low, high = (knee * factor for factor in BEND)
    ranges = rig.randomisation | {KNEE_OPENING: Distribution(uniform=(low, high))}
    return config.model_copy(update={"plant": plant}), rig._replace(randomisation=ranges)


def _matching(paths: Sequence[Path], patterns: Sequence[str]) -> set[int]:
    """Numbers of the paths whose name, or which as a whole, match one of the patterns."""
    found: set[int] = set()
    for pattern in patterns:
        own = {k for k, path in enumerate(paths) if fnmatch(path.name, pattern) or fnmatch(str(path), pattern)}
        if not own:
            raise ConfigurationError(f"--hold-back {pattern}: matches none of the recordings, such as {paths[0].name}")
        found |= own
    if len(found) == len(paths):
        raise ConfigurationError("--hold-back: matches every recording; nothing is left for the fit")
    return found


def _on_one_grid(recordings: Sequence[Recording], config: TaskConfig) -> list[Checked]:
    """The checked recordings with one sample time: the control period, or that of the logs where one lacks it."""
    checked = [check_recording(recording, config, None) for recording in recordings]
    if len({one.samples.period for one in checked}) > 1:
        checked = [
            one
            if one.severe or one.samples.period != config.control_period
            else check_recording(recording, config, True)
            for recording, one in zip(recordings, checked, strict=True)
        ]
    periods = {one.samples.period: recording.source for recording, one in zip(recordings, checked, strict=True)}
    if len(periods) > 1 and not any(one.severe for one in checked):
        (first, one), (second, other) = list(periods.items())[:2]
        raise ConfigurationError(
            f"{other}: has one sample every {1e3 * second:.4g} ms, {one} every {1e3 * first:.4g} ms; "
            "recordings that are identified together need the same sample time"
        )
    return checked


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
            "known_ends": {0: "both", 1: "low", -1: "high"}[int(fit.side[place])],
            "widening": float(fit.widening[place]),
            "motion_that_helps": advice.motion if advice is not None else None,
        }
    return {
        "command": command,
        "hydro_env": __version__,
        "recordings": [recording.source for recording in found.recordings],
        "rig": found.rig.source,
        "describes": found.describes,
        "verdict": found.verdict(),
        "share_of_variance": {n: plain(s) for n, s in zip(SENSORS, found.tested[math.inf].share, strict=True)},
        "forecasts": [
            {"over_s": plain(over), "speed_rms": plain(forecast.speed_error)}
            | {f"{n}_share_of_variance": plain(s) for n, s in zip(SENSORS, forecast.share, strict=True)}
            | {f"{n}_rms": plain(e) for n, e in zip(SENSORS, forecast.error, strict=True)}
            for over, forecast in found.tested.items()
        ],
        "held_back": {"why": found.parts.reason, "parts": [_part_as_json(found, part) for part in found.held_back]},
        "repeatability": {
            one.name: [
                {
                    "recording": found.recordings[number].source,
                    "value": plain(value),
                    "low": plain(low),
                    "high": plain(high),
                    "determined": bool(known),
                }
                for number, value, low, high, known in zip(
                    one.recordings, one.values, one.low, one.high, one.determined, strict=True
                )
            ]
            for one in found.repeats
        },
        "repeats_inside_their_intervals": plain(share_inside(found.repeats)),
        "windows": len(fit.misfit),
        "windows_explained": int(fit.explained.sum()),
        "another_minimum": dict(fit.second),
        "unknowns": unknowns,
        "singular_values": [{"value": one.singular_value, "parts": dict(one.parts)} for one in found.combinations],
        "findings": [finding.line() for finding in found.findings],
        "notes": found.noted,
    }


def _part_as_json(found: Identification, part: HeldBack) -> dict[str, Any]:
    """Errors of a held-back part, SI."""
    values = dict(zip([f"{name}_rms" for name in SENSORS], part.error.tolist(), strict=True))
    values |= {"speed_rms": part.speed_error}
    values |= dict(zip(("speed_out", "speed_in"), part.speed_ratios, strict=True))
    return {
        "recording": found.recordings[part.recording].source,
        "from_s": part.begin,
        "to_s": part.begin + float(part.time[-1]),
        "share_of_variance": {
            name: share if math.isfinite(share) else None
            for name, share in zip(SENSORS, part.share.tolist(), strict=True)
        },
    } | {name: value if math.isfinite(value) else None for name, value in values.items()}
