"""The closed position loop: a sensible gain, the frequency response, and runs of the nonlinear plant."""

import contextlib
import math
from functools import cache

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from hydro_agents.controllers.sampled_loop import CONTROL_PERIOD, SampledLoop, places_in_reach, sampled_loop
from hydro_env import HydroError
from hydro_env.types import Floats
from paper.rig import LEAKS, PLACE, PLANT, TIGHT, with_leak

GAIN_MARGIN = 2.0  # gain margin: largest stable gain over the gain in use
NYQUIST = 0.5 / CONTROL_PERIOD
FREQUENCIES = np.geomspace(1e-3, 0.999, 500) * NYQUIST


@cache
def sensible_gain() -> float:
    """Gain (command per metre, 1 = 10 V): the largest stable one over the reach with a tight seal, over a margin."""
    plant, limits = with_leak(PLANT, TIGHT, "laminar"), []
    for place in places_in_reach(plant):
        with contextlib.suppress(HydroError):  # a place that cannot be held
            limits.append(sampled_loop(plant, place).largest_stable_gain())
    return min(limits) / GAIN_MARGIN


def response(loop: SampledLoop, gain: float, frequencies: Floats) -> NDArray[np.complex128]:
    """Reference to position of the closed loop at frequencies in Hz, shape (n,), complex, m per m.

    Exact at the sampling instants, up to half the sampling frequency: T = g P(z) / (1 + g P(z)),
    P(z) = c (z − Φ)⁻¹ (Γ_new + Γ_old / z) z^(−late) and z = exp(j 2π f · period) (Åström & Wittenmark 1997,
    section 2.6).
    """
    n = len(loop.input_new)
    z = np.exp(2j * np.pi * np.asarray(frequencies, dtype=np.float64) * loop.control_period)[:, None]
    matrices = z[:, :, None] * np.eye(n) - loop.transition
    states = np.linalg.solve(matrices, (loop.input_new + loop.input_old / z)[:, :, None])
    opened = gain * loop.position_size * states[:, 0, 0] / z[:, 0] ** loop.late
    closed = opened / (1.0 + opened)
    return np.asarray(closed, dtype=np.complex128)


def final_value(loop: SampledLoop, gain: float) -> float:
    """Final position of a stable closed loop in m per m of reference; below 1 with a leak."""
    matrix, n = loop.closed(gain), len(loop.input_new)
    drive = np.zeros(len(matrix))
    drive[n] = gain
    if not loop.late:
        drive[:n] = loop.input_new * gain
    return float(np.linalg.solve(np.eye(len(matrix)) - matrix, drive)[0] * loop.position_size)


def bandwidth(loop: SampledLoop, gain: float) -> float:
    """Frequency in Hz where the gain from reference to position first falls 3 dB below its value at rest, or NaN."""
    nyquist = 0.5 / loop.control_period
    frequencies = np.geomspace(1e-4, 0.999, 1200) * nyquist
    size = np.abs(response(loop, gain, frequencies)) / final_value(loop, gain)
    below = np.flatnonzero(size < np.sqrt(0.5))
    if len(below) == 0 or below[0] == 0:
        return float("nan")
    last = below[0] - 1
    share = (size[last] - np.sqrt(0.5)) / (size[last] - size[last + 1])
    return float(frequencies[last] * (frequencies[last + 1] / frequencies[last]) ** share)


def closed_bode_table() -> pd.DataFrame:
    """Gain and phase (degrees) from reference to position over frequency by leak.

    Repeated in every row of a leak: ``gain_per_m`` (command per metre), ``largest_gain_per_m``, ``at_rest`` (m per m),
    ``bandwidth_hz`` (−3 dB from ``at_rest``), ``peak_hz`` and ``peak`` (largest gain).
    """
    gain, parts = sensible_gain(), []
    for leak in LEAKS:
        loop = sampled_loop(with_leak(PLANT, leak, "laminar"), PLACE)
        answer = response(loop, gain, FREQUENCIES)
        size = np.abs(answer)
        columns = {"leak_lpm": leak, "frequency_hz": FREQUENCIES, "gain": size}
        columns |= {"phase_deg": np.degrees(np.unwrap(np.angle(answer))), "gain_per_m": gain}
        columns |= {"largest_gain_per_m": loop.largest_stable_gain(), "at_rest": final_value(loop, gain)}
        top = int(np.argmax(size))
        columns |= {"bandwidth_hz": bandwidth(loop, gain), "peak_hz": FREQUENCIES[top], "peak": size[top]}
        parts.append(pd.DataFrame(columns))
    return pd.concat(parts, ignore_index=True)


def closed_bode_summary(table: pd.DataFrame) -> pd.DataFrame:
    """One row per leak with the repeated columns, and the second peak above the bandwidth, due to the oil column.

    ``hump_hz`` and ``hump`` (its gain) are NaN where there is none.
    """
    rows = {}
    for leak, part in table.groupby("leak_lpm"):
        size, hertz = part["gain"].to_numpy(), part["frequency_hz"].to_numpy()
        inner = np.flatnonzero((size[1:-1] > size[:-2]) & (size[1:-1] >= size[2:])) + 1
        beyond = [k for k in inner if not hertz[k] <= float(part["bandwidth_hz"].iloc[0])]
        top = max(beyond, key=lambda k: size[k], default=None)
        rows[leak] = {"hump_hz": hertz[top] if top is not None else math.nan}
        rows[leak]["hump"] = size[top] if top is not None else math.nan
    repeated = table.drop_duplicates("leak_lpm").set_index("leak_lpm")
    return repeated.join(pd.DataFrame.from_dict(rows, orient="index").rename_axis("leak_lpm"))
