"""The tables of the page of an identification."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np

from hydro_agents.running.text import Table, listed, number
from hydro_env.task.sensors import POSITION
from hydro_rig.estimation.unknowns import BIASES, EXTERNAL_LEAKAGE, GAINS, LEAKAGE
from hydro_rig.identification.found_rig import TIMING, hull, path_of, share_in_words, shown
from hydro_rig.identification.held_back import PRESSURES, HeldBack
from hydro_rig.identification.identify import Identification

MOST_COMBINATIONS = 6  # rows of the table of singular values, the least determined first


def unknowns_table(found: Identification) -> Table:
    """Each unknown: its range before, its value, its interval, and whether it is determined."""
    rows = []
    fit, plant = found.fit, found.config.plant
    for name, value, low, high, known, side in zip(
        fit.names, fit.values, fit.low, fit.high, fit.determined, fit.side.tolist(), strict=True
    ):
        look, before = shown(name, plant), range_before(found, name)
        width = look.value(float(value), float(high - low)), look.interval(float(low), float(high), side)
        span = look.span(*before) if before is not None else "–"
        rows.append((look.words, look.unit, span, *width, "yes" if known else "no"))
    header = ("Unknown", "Unit", "Range before", "Found", "95 % interval", "Determined")
    return Table("", header, rows, style="words", folded=False)


def range_before(found: Identification, name: str) -> tuple[float, float] | None:
    """Range of an unknown before the recording, in its unit; ``None``: it has none of its own (leaks, timing)."""
    if name in (LEAKAGE, EXTERNAL_LEAKAGE, *TIMING, *GAINS):
        return None
    if name in BIASES:
        bias = getattr(found.config.sensors, name.removesuffix("_bias")).bias
        return -bias, bias
    path = path_of(name)
    return hull(found.config.plant, found.plant, path, found.rig.randomisation[path])


def open_table(found: Identification) -> Table | None:
    """The undetermined unknowns, each with a motion that would determine it; ``None`` if all are determined."""
    rows = []
    for name, advice in found.advice.items():
        before = f"{100 * found.fit.remaining[found.fit.names.index(name)]:.0f} %"
        words = shown(name, found.config.plant).words
        if advice is None:
            rows.append((words, before, "none of the candidates", "–"))
        else:
            left = f"{100 * advice.remaining:.0f} %"
            rows.append((words, before, advice.motion, left if advice.enough else f"{left}, not enough alone"))
    header = ("Unknown", "Uncertainty left", "Most informative motion", "Left after 8 s of it")
    return Table("", header, rows, style="words") if rows else None


def combinations_table(found: Identification) -> Table:
    """The least determined combinations of unknowns."""
    rows = []
    for one in found.combinations[:MOST_COMBINATIONS]:
        parts = [
            f"{number(weight, 2, signed=True)} × {shown(name, found.config.plant).words}" for name, weight in one.parts
        ]
        rows.append((number(one.singular_value, digits=3), listed(parts) if parts else "many, none of them large"))
    return Table("", ("Singular value", "Combination"), rows, style="words")


def forecasts_table(found: Identification) -> Table:
    """Errors and shares of variance over times from a measured state, and over the whole parts."""
    rows = []
    for over, forecast in found.tested.items():
        sizes = (1e3 * forecast.error[POSITION], 1e3 * forecast.speed_error, *(1e-5 * forecast.error[list(PRESSURES)]))
        shares = ["–" if math.isnan(share) else share_in_words(share) for share in forecast.share.tolist()]
        name = f"{over:g} s" if math.isfinite(over) else "the whole part"
        rows.append((name, *(number(float(size), digits=2) for size in sizes), *shares))
    words = ("position", "pressure a", "pressure b", "spool")
    errors = ("Position, mm", "Speed, mm/s", "Pressure a, bar", "Pressure b, bar")
    return Table(
        "How the error grows: root mean square error, and share of the variance explained",
        ("Simulated for", *errors, *(f"Share: {word}" for word in words)),
        rows,
        style="words",
    )


def place_of_part(found: Identification, part: HeldBack) -> str:
    """Recording and time of a held-back part."""
    name = f"{Path(found.recordings[part.recording].source).name}, " if len(found.recordings) > 1 else ""
    return f"{name}{part.begin:g} to {part.begin + float(part.time[-1]):.4g} s"


def errors_table(found: Identification) -> Table:
    """Errors of each held-back part in mm, mm/s and bar."""
    rows = []
    for part in found.held_back:
        out, back = (
            f"{number(100 * ratio, 1, signed=True)} %" if ratio == ratio else "–" for ratio in part.speed_ratios
        )
        error = part.error
        sizes = (1e3 * error[POSITION], 1e3 * part.speed_error, *(1e-5 * error[row] for row in PRESSURES))
        position, speed, *pressures = (number(float(size), digits=2) for size in sizes)
        rows.append((place_of_part(found, part), position, speed, out, back, *pressures))
    header = ("Held back", "Position, mm", "Speed, mm/s", "Speed out", "Speed in", "Pressure a, bar", "Pressure b, bar")
    return Table("Root mean square errors; median of simulated over measured speed", header, rows, style="words")


def repeats_tables(found: Identification) -> list[Table]:
    """Spread of each unknown over the recordings, and all values."""
    spreads, values = [], []
    for one, common in zip(found.repeats, found.fit.values.tolist(), strict=True):
        look, known = shown(one.name, found.config.plant), one.determined
        if known.any():
            own = one.values[known]
            width = float(np.median((one.high - one.low)[known]))
            cells = [look.value(value, width) for value in (common, float(own.min()), float(own.max()), one.spread)]
            holds = f"{int(one.inside[known].sum())} of {int(known.sum())}"
            spreads.append((look.words, look.unit, *cells, holds))
        for recording, value, low, high, sure in zip(one.recordings, one.values, one.low, one.high, known, strict=True):
            name = Path(found.recordings[recording].source).name
            interval = look.span(float(low), float(high))
            row = (
                look.words,
                look.unit,
                name,
                look.value(float(value), float(high - low)),
                interval,
                "yes" if sure else "no",
            )
            values.append(row)
    first = ("Unknown", "Unit", "All together", "Lowest", "Highest", "Standard deviation", "Intervals that hold it")
    second = ("Unknown", "Unit", "Recording", "Value", "95 % interval", "Determined")
    return [
        Table("", first, spreads, style="words", folded=False),
        Table("Every recording", second, values, style="words", folded=True),
    ]
