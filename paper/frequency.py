"""The linearised axis: natural frequency and damping over stroke and leak, frequency responses open and closed."""

from __future__ import annotations

import math

import numpy as np
import pandas as pd

from hydro_agents.controllers.sampled_loop import CONTROL_PERIOD, sampled_loop
from hydro_agents.report.leaks import LINES, SEVERE, TIGHT
from hydro_env import HydroError
from hydro_env.plant.linearisation import linearise
from hydro_env.plant.states import STATE_NAMES
from paper.closed_loop import bandwidth, sensible_gain
from paper.rig import Rig, simplified, with_leak

MAP_POSITIONS = np.linspace(-0.95, 0.95, 21)
"""Positions as fractions of half the stroke."""

MAP_LEAKS = np.geomspace(TIGHT, SEVERE, 17)

LOWEST, HIGHEST = 0.01, 200.0
"""Hz; the upper end is higher for an axis that oscillates faster than a third of it."""

NYQUIST = 0.5 / CONTROL_PERIOD
FREQUENCIES = np.geomspace(1e-3, 0.999, 500) * NYQUIST


def map_table(rig: Rig) -> pd.DataFrame:
    """Natural frequency (Hz) and damping ratio at rest; laminar leak, no friction, no spring, with null leakage.

    Without the spring the whole stroke can be held. NaN if the linearised axis does not oscillate, or if the supply
    cannot feed the leak.

    Raises:
        ArithmeticError: the axis is overdamped everywhere.
    """
    springless = simplified(rig.parameters, "none", True).replace(load={"spring_stiffness": 0.0})
    rows = []
    for leak in MAP_LEAKS:
        plant = with_leak(springless, float(leak), "laminar")
        for position in 0.5 * rig.parameters.cylinder.stroke * MAP_POSITIONS:
            frequency = damping = math.nan
            try:
                mode = linearise(plant, position=float(position)).hydraulic_mode
                frequency, damping = mode.natural_frequency / (2 * math.pi), mode.damping_ratio
            except (ArithmeticError, HydroError):  # overdamped, or more leak than the supply can feed
                pass
            row = {"position_mm": 1e3 * position, "leak_lpm": leak}
            rows.append(row | {"natural_frequency_hz": frequency, "damping_ratio": damping})
    table = pd.DataFrame(rows)
    if table[table["leak_lpm"] == MAP_LEAKS[0]]["damping_ratio"].isna().all():
        raise ArithmeticError("the axis oscillates nowhere: it is overdamped")
    return table


def tight_frequency(rig: Rig) -> float:
    """Natural frequency in Hz at the rig's place with a tight seal, without friction."""
    plant = with_leak(simplified(rig.parameters, "none", True), TIGHT, "laminar")
    return linearise(plant, position=rig.place).hydraulic_mode.natural_frequency / (2 * math.pi)


def bode_table(rig: Rig) -> pd.DataFrame:
    """Gain (mm/V) and phase (degrees) over frequency; laminar leak, no friction, at the rig's place."""
    frequencies = np.geomspace(LOWEST, max(HIGHEST, 3.0 * tight_frequency(rig)), 400)
    row, unit, parts = STATE_NAMES.index("position"), np.eye(len(STATE_NAMES)), []
    for leak in LINES:
        axis = linearise(with_leak(simplified(rig.parameters, "none", True), leak, "laminar"), position=rig.place)
        solved = [np.linalg.solve(2j * math.pi * hertz * unit - axis.a, axis.b)[row] for hertz in frequencies]
        parts.append(_response(leak, frequencies, np.array(solved), "gain_mm_per_v", 1e3))
    return pd.concat(parts, ignore_index=True)


def _response(leak: float, frequencies: np.ndarray, response: np.ndarray, column: str, unit: float) -> pd.DataFrame:
    return pd.DataFrame(
        {
            "leak_lpm": leak,
            "frequency_hz": frequencies,
            column: unit * np.abs(response),
            "phase_deg": np.degrees(np.unwrap(np.angle(response))),
        }
    )


def closed_bode_table(rig: Rig) -> pd.DataFrame:
    """Gain and phase (degrees) from reference to position over frequency by leak, at the rig's place.

    Repeated in every row of a leak: ``gain_per_m`` (command per metre), ``largest_gain_per_m``, ``at_rest`` (m per m),
    ``bandwidth_hz`` (−3 dB from ``at_rest``), ``peak_hz`` and ``peak`` (largest gain).
    """
    gain, parts = sensible_gain(rig), []
    for leak in LINES:
        loop = sampled_loop(with_leak(rig.parameters, leak, "laminar"), rig.place)
        part = _response(leak, FREQUENCIES, loop.response(gain, FREQUENCIES), "gain", 1.0)
        top = int(np.argmax(part["gain"]))
        parts.append(
            part.assign(
                gain_per_m=gain,
                largest_gain_per_m=loop.largest_stable_gain(),
                at_rest=loop.final_value(gain),
                bandwidth_hz=bandwidth(loop, gain),
                peak_hz=FREQUENCIES[top],
                peak=part["gain"][top],
            )
        )
    return pd.concat(parts, ignore_index=True)


def closed_bode_summary(table: pd.DataFrame) -> pd.DataFrame:
    """One row per leak with the repeated columns, and the second peak above the bandwidth, due to the oil column.

    ``hump_hz`` and ``hump`` (its gain) are NaN where there is none; ``has_peak``: whether any gain exceeds the gain at
    rest.
    """
    rows = {}
    for leak, part in table.groupby("leak_lpm"):
        size, hertz = part["gain"].to_numpy(), part["frequency_hz"].to_numpy()
        inner = np.flatnonzero((size[1:-1] > size[:-2]) & (size[1:-1] >= size[2:])) + 1
        beyond = [k for k in inner if not hertz[k] <= float(part["bandwidth_hz"].iloc[0])]
        top = max(beyond, key=lambda k: size[k], default=None)
        hump_hz, hump = (hertz[top], size[top]) if top is not None else (math.nan, math.nan)
        rows[leak] = {"hump_hz": hump_hz, "hump": hump}
    repeated = table.drop_duplicates("leak_lpm").set_index("leak_lpm")
    summary = repeated.join(pd.DataFrame.from_dict(rows, orient="index").rename_axis("leak_lpm"))
    return summary.assign(has_peak=summary["peak"] >= 1.001 * summary["at_rest"])
