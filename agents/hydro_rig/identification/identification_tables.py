"""The numbers of an identification: for programs, and as tables of its page."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
from pydantic_core import to_jsonable_python

from hydro_agents.running.text import Table, listed, number
from hydro_env import __version__
from hydro_env.task.sensors import POSITION, SENSORS
from hydro_env.types import Floats
from hydro_rig.estimation.unknowns import BIASES, EXTERNAL_LEAKAGE, GAINS, LATENCY, LEAKAGE, RISE_TIME
from hydro_rig.identification.fit import combinations
from hydro_rig.identification.found_rig import path_of, share_in_words, shown
from hydro_rig.identification.held_back import PRESSURES, Forecast, HeldBack
from hydro_rig.identification.identify import Identification
from hydro_rig.identification.intervals import hull
from hydro_rig.identification.repeatability import share_inside

ERRORS = ("Position, mm", "Speed, mm/s", "Pressure a, bar", "Pressure b, bar")
MOST_COMBINATIONS = 6  # rows of the table of singular values, the least determined first


def as_json(found: Identification, command: str) -> Any:
    """The result for programs; SI units, leaks in l/min at 100 bar; ``None`` if there is no number."""
    fit, sources = found.fit, [recording.source for recording in found.recordings]

    def by_sensor(values: Floats, what: str = "") -> dict[str, float]:
        return {f"{name}{what}": value for name, value in zip(SENSORS, values.tolist(), strict=True)}

    unknowns, repeats = {}, {}
    for one in fit.unknowns:
        advice = found.advice.get(one.name)
        unknowns[one.name] = {
            "value": one.value,
            "low": one.low,
            "high": one.high,
            "unit": "l/min at 100 bar" if one.name in (LEAKAGE, EXTERNAL_LEAKAGE) else "SI",
            "remaining": one.remaining,
            "determined": fit.knows(one),
            "known_ends": {0: "both", 1: "low", -1: "high"}[one.side],
            "widening": one.widening,
            "motion_that_helps": advice.motion if advice is not None else None,
        }
    keys = ("value", "low", "high", "determined")
    for repeat in found.repeats:
        rows = zip(repeat.recordings, repeat.values, repeat.low, repeat.high, repeat.determined, strict=True)
        repeats[repeat.name] = [
            {"recording": sources[number], **dict(zip(keys, row, strict=True))} for number, *row in rows
        ]
    parts = [
        {
            "recording": sources[part.recording],
            "from_s": part.begin,
            "to_s": part.begin + float(part.time[-1]),
            "share_of_variance": by_sensor(part.share),
            **by_sensor(part.error, "_rms"),
            "speed_rms": part.speed_error,
            **dict(zip(("speed_out", "speed_in"), part.speed_ratios, strict=True)),
        }
        for part in found.held_back
    ]
    forecasts = [
        {"over_s": over, "speed_rms": forecast.speed_error}
        | by_sensor(forecast.share, "_share_of_variance")
        | by_sensor(forecast.error, "_rms")
        for over, forecast in found.tested.items()
    ]
    whole = {
        "command": command,
        "hydro_env": __version__,
        "recordings": sources,
        "rig": found.rig.source,
        "describes": found.describes,
        "verdict": found.verdict(),
        "share_of_variance": by_sensor(found.tested[math.inf].share),
        "forecasts": forecasts,
        "held_back": {"why": found.parts.reason, "parts": parts},
        "repeatability": repeats,
        "repeats_inside_their_intervals": share_inside(found.repeats),
        "windows": len(fit.misfit),
        "windows_explained": int(fit.explained.sum()),
        "another_minimum": dict(fit.second),
        "unknowns": unknowns,
        "singular_values": [one._asdict() for one in combinations(fit)],
        "findings": [finding.line() for finding in found.findings],
        "notes": found.noted,
    }
    return to_jsonable_python(whole, inf_nan_mode="null", fallback=lambda value: value.tolist())


def unknowns_table(found: Identification) -> Table:
    """Each unknown: its range before, its value, its interval, and whether it is determined."""
    rows = []
    for one in found.fit.unknowns:
        look, before = shown(one.name, found.config.plant), range_before(found, one.name)
        span = look.span(*before) if before is not None else "–"
        value, interval = look.value(one.value, one.high - one.low), look.interval(one.low, one.high, one.side)
        rows.append((look.words, look.unit, span, value, interval, "yes" if found.fit.knows(one) else "no"))
    header = ("Unknown", "Unit", "Range before", "Found", "95 % interval", "Determined")
    return Table("", header, rows, style="words", folded=False)


def range_before(found: Identification, name: str) -> tuple[float, float] | None:
    """Range of an unknown before the recording, in its unit; ``None``: it has none of its own (leaks, timing)."""
    if name in (LEAKAGE, EXTERNAL_LEAKAGE, LATENCY, RISE_TIME, *GAINS):
        return None
    if name in BIASES:
        bias = getattr(found.config.sensors, name.removesuffix("_bias")).bias
        return -bias, bias
    path = path_of(name)
    return hull(found.config.plant, found.plant, path, found.rig.randomisation[path])


def open_table(found: Identification) -> Table | None:
    """The undetermined unknowns, each with a motion that would determine it; ``None`` if all are determined."""
    rows = []
    for one in found.undetermined:
        motion, left = "none of the candidates", "–"
        if one.name in found.advice:
            motion, after, enough = found.advice[one.name]
            left = f"{100 * after:.0f} %{'' if enough else ', not enough alone'}"
        rows.append((shown(one.name, found.config.plant).words, f"{100 * one.remaining:.0f} %", motion, left))
    header = ("Unknown", "Uncertainty left", "Most informative motion", "Left after 8 s of it")
    return Table("", header, rows, style="words") if rows else None


def combinations_table(found: Identification) -> Table:
    """The least determined combinations of unknowns."""
    rows = []
    for value, weights in combinations(found.fit)[:MOST_COMBINATIONS]:
        parts = [
            f"{number(weight, 2, signed=True)} × {shown(name, found.config.plant).words}"
            for name, weight in weights.items()
        ]
        rows.append((number(value, digits=3), listed(parts) if parts else "many, none of them large"))
    return Table("", ("Singular value", "Combination"), rows, style="words")


def forecasts_table(found: Identification) -> Table:
    """Errors and shares of variance over times from a measured state, and over the whole parts."""
    rows = []
    for over, forecast in found.tested.items():
        shares = ["–" if math.isnan(share) else share_in_words(share) for share in forecast.share.tolist()]
        name = f"{over:g} s" if math.isfinite(over) else "the whole part"
        rows.append((name, *_sizes(forecast), *shares))
    shares = [f"Share: {word}" for word in ("position", "pressure a", "pressure b", "spool")]
    caption = "How the error grows: root mean square error, and share of the variance explained"
    return Table(caption, ("Simulated for", *ERRORS, *shares), rows, style="words")


def place_of_part(found: Identification, part: HeldBack) -> str:
    """Recording and time of a held-back part."""
    name = f"{Path(found.recordings[part.recording].source).name}, " if len(found.recordings) > 1 else ""
    return f"{name}{part.begin:g} to {part.begin + float(part.time[-1]):.4g} s"


def errors_table(found: Identification) -> Table:
    """Errors of each held-back part in mm, mm/s and bar."""
    rows = []
    for part in found.held_back:
        ratios = [number(100 * ratio, 1, signed=True) for ratio in part.speed_ratios]
        out, back = (ratio if ratio == "–" else f"{ratio} %" for ratio in ratios)
        position, speed, *pressures = _sizes(part)
        rows.append((place_of_part(found, part), position, speed, out, back, *pressures))
    header = ("Held back", *ERRORS[:2], "Speed out", "Speed in", *ERRORS[2:])
    return Table("Root mean square errors; median of simulated over measured speed", header, rows, style="words")


def _sizes(errors: HeldBack | Forecast) -> list[str]:
    """Errors in the units of :data:`ERRORS`."""
    position, pressures = 1e3 * errors.error[POSITION], 1e-5 * errors.error[list(PRESSURES)]
    return [number(float(size), digits=2) for size in (position, 1e3 * errors.speed_error, *pressures)]


def repeats_table(found: Identification) -> Table:
    """Spread of each unknown over the recordings that determine it."""
    rows = []
    for one, common in zip(found.repeats, found.fit.own().values(), strict=True):
        look, known = shown(one.name, found.config.plant), one.determined
        if known.any():
            width = float(np.median((one.high - one.low)[known]))
            values = (common, float(one.values[known].min()), float(one.values[known].max()), one.spread)
            holds = f"{int(one.inside[known].sum())} of {int(known.sum())}"
            rows.append((look.words, look.unit, *(look.value(value, width) for value in values), holds))
    header = ("Unknown", "Unit", "All together", "Lowest", "Highest", "Standard deviation", "Intervals that hold it")
    return Table("", header, rows, style="words", folded=False)
