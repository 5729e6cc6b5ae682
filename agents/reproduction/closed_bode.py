"""Frequency response of the closed position loop, from reference to position, at several leaks."""

from __future__ import annotations

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from agents.controllers.sampled_loop import CONTROL_PERIOD, sampled_loop
from agents.reproduction.bode import LEAKS, decade_ticks, gain_above_phase
from agents.reproduction.closed_loop import GAIN_MARGIN, TIGHT, TIMING, bandwidth, sensible_gain
from agents.reproduction.drawing import ReproducedFigure, legend, panel_title, plain
from agents.reproduction.rig import Rig, with_leak

NYQUIST = 0.5 / CONTROL_PERIOD
FREQUENCIES = np.geomspace(1e-3, 0.999, 500) * NYQUIST


def closed_bode_table(rig: Rig) -> pd.DataFrame:
    """Gain and phase (degrees) from reference to position over frequency by leak, at the rig's place.

    Repeated in every row of a leak: ``gain_per_m`` (command per metre), ``largest_gain_per_m``, ``at_rest`` (m per m),
    ``bandwidth_hz`` (−3 dB from ``at_rest``), ``peak_hz`` and ``peak`` (largest gain).
    """
    gain, parts = sensible_gain(rig), []
    for leak in LEAKS:
        loop = sampled_loop(with_leak(rig.parameters, leak, "laminar"), rig.place)
        response = loop.response(gain, FREQUENCIES)
        size = np.abs(response)
        top = int(np.argmax(size))
        parts.append(
            pd.DataFrame(
                {
                    "leak_lpm": leak,
                    "frequency_hz": FREQUENCIES,
                    "gain": size,
                    "phase_deg": np.degrees(np.unwrap(np.angle(response))),
                    "gain_per_m": gain,
                    "largest_gain_per_m": loop.largest_stable_gain(),
                    "at_rest": loop.final_value(gain),
                    "bandwidth_hz": bandwidth(loop, gain),
                    "peak_hz": FREQUENCIES[top],
                    "peak": size[top],
                }
            )
        )
    return pd.concat(parts, ignore_index=True)


def oscillation_peaks(table: pd.DataFrame) -> pd.DataFrame:
    """Per leak the gain at the hump beyond the bandwidth, where the oil column oscillates; NaN where there is none."""
    rows = []
    for leak, part in table.groupby("leak_lpm"):
        size, hertz = part["gain"].to_numpy(), part["frequency_hz"].to_numpy()
        inner = np.flatnonzero((size[1:-1] > size[:-2]) & (size[1:-1] >= size[2:])) + 1
        beyond = [k for k in inner if not hertz[k] <= float(part["bandwidth_hz"].iloc[0])]
        top = max(beyond, key=lambda k: size[k], default=None)
        rows.append(
            {
                "leak_lpm": leak,
                "hump_hz": hertz[top] if top is not None else np.nan,
                "hump": size[top] if top is not None else np.nan,
            }
        )
    return pd.DataFrame(rows).set_index("leak_lpm")


def paint_closed_bode(figure: Figure, table: pd.DataFrame) -> None:
    """Gain above phase."""
    gain, phase = gain_above_phase(figure, table, "gain")
    gain.axhline(np.sqrt(0.5), color="#6b6b6b", linewidth=0.7, linestyle=(0, (4, 2)))
    gain.annotate("−3 dB", (FREQUENCIES[0], np.sqrt(0.5)), xytext=(3, -9), textcoords="offset points", fontsize=7.5)
    gain.set(xscale="log", yscale="log", ylabel="gain, mm per mm")
    decade_ticks(gain.yaxis)
    phase.set(xlabel="frequency, Hz", ylabel="phase, degrees")
    lowest = 90 * int(np.floor(table["phase_deg"].min() / 90))
    phase.set_yticks(range(lowest, 1, 90 if lowest >= -450 else 180))
    gain.set_xlim(FREQUENCIES[0], NYQUIST)
    decade_ticks(phase.xaxis)
    panel_title(gain, "From reference to position, loop closed")
    legend(gain, title="leak at 100 bar", loc="lower left")
    figure.align_ylabels()


def closed_bode_figure(rig: Rig) -> ReproducedFigure:
    """The closed-loop Bode plots with their words."""
    table = closed_bode_table(rig)
    told = table.drop_duplicates("leak_lpm").set_index("leak_lpm").join(oscillation_peaks(table))
    first, last = told.iloc[0], told.iloc[-1]
    found = [
        f"Bandwidth (−3 dB from the value at rest): {first['bandwidth_hz']:.1f} Hz with the tight seal, "
        f"{last['bandwidth_hz']:.1f} Hz at {LEAKS[-1]:g} l/min: with the same gain the leak "
        f"{_changes(last['bandwidth_hz'] / first['bandwidth_hz'])}.",
        f"Largest gain over all frequencies: {_peak(first)} when tight, {_peak(last)} at {LEAKS[-1]:g} l/min.",
    ]
    if np.isfinite(first["hump"]):
        left = f"{last['hump']:.2f}" if np.isfinite(last["hump"]) else "none"
        found.append(
            f"Beyond the bandwidth the oil column shows as a hump at {first['hump_hz']:.0f} Hz: {first['hump']:.2f} "
            f"when tight, {left} at {LEAKS[-1]:g} l/min."
        )
    droop = 100.0 * (1.0 - last["at_rest"])
    found.append(
        f"At rest a proportional loop leaves {plain(100.0 * (1.0 - first['at_rest']), 2)} % of a change of reference "
        f"when tight and {plain(droop, 2)} % at {LEAKS[-1]:g} l/min: oil that leaks must be replaced."
        if droop > 1e-3
        else "A change of reference is followed in full at every leak: nothing pushes back with the way, so that the "
        "leak stays the same. A constant error may be left all the same, see holding."
    )
    summary = pd.DataFrame(
        {
            "leak, l/min at 100 bar": [f"{leak:g}" for leak in told.index],
            "bandwidth, Hz": [f"{value:.2f}" for value in told["bandwidth_hz"]],
            "peak": [f"{row['peak']:.3f}" if _has_peak(row) else "none" for _, row in told.iterrows()],
            "at, Hz": [f"{row['peak_hz']:.2f}" if _has_peak(row) else "–" for _, row in told.iterrows()],
            "hump of the oil column": [f"{value:.3f}" if np.isfinite(value) else "–" for value in told["hump"]],
            "at rest": [f"{value:.4f}" for value in told["at_rest"]],
            "largest stable gain here, 1/m": [f"{value:.4g}" for value in told["largest_gain_per_m"]],
        }
    )
    return ReproducedFigure(
        table=table,
        paint=paint_closed_bode,
        height=4.8,
        paper="The paper's rig is a position loop; it calls the loop with a leak less controllable and better damped, "
        "without a frequency response.",
        how=f"Proportional controller, command = {first['gain_per_m']:.4g} per metre of error (1 = 10 V): the largest "
        f"gain that is stable over the whole reach with a tight seal ({TIGHT:g} l/min), divided by {GAIN_MARGIN:g}; "
        f"{TIMING}. Plant linearised at rest at {1e3 * rig.place:+.0f} mm, laminar leak, valve as assumed, no dry "
        f"friction; the sampled loop is exact at the sampling instants, and so drawn up to half the sampling "
        f"frequency, {NYQUIST:g} Hz.",
        found=found,
        summary=summary,
    )


def _has_peak(row: pd.Series) -> bool:
    return bool(row["peak"] >= 1.001 * row["at_rest"])


def _peak(row: pd.Series) -> str:
    if not _has_peak(row):
        return "that at rest (no peak)"
    return f"{row['peak']:.2f} at {row['peak_hz']:.1f} Hz"


def _changes(ratio: float) -> str:
    if not np.isfinite(ratio):
        return "leaves no bandwidth to compare"
    if abs(ratio - 1.0) < 0.03:
        return f"hardly changes it (factor {ratio:.3f})"
    return f"{'narrows' if ratio < 1.0 else 'widens'} it by a factor of {max(ratio, 1.0 / ratio):.2f}"
