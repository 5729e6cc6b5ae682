"""Section 4 of the paper: the four terms of dF/dt (24) along a move and along a stop, and leakage's share of them."""

from functools import cache
from itertools import pairwise

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from hydro_env import Trajectory, equilibrium, resistance_from_flow, simulate
from hydro_env.plant.arrays import coefficient_array, derivative_array, plant_coefficients
from hydro_env.plant.equations import Coefficients
from hydro_env.plant.parts.chambers import chamber_volumes, pressure_rate
from hydro_env.plant.parts.leakage import external_leakage, internal_leakage
from hydro_env.plant.states import STATE_NAMES, State
from paper.rig import FEW_LEAKS, LAWS, PLANT, SAMPLE_TIME, START, VOLTAGE, Law, count, simplified, with_leak

DRAWN = 1.0  # l/min at 100 bar; the leak of the picture
EXTERNAL_LEAK = 0.1  # l/min at 100 bar past the rod seal; without this leak the fourth term would be zero
TERMS = {
    "valve_n_s": "flow through the valve",
    "motion_n_s": "motion of the piston",
    "internal_leakage_n_s": "internal leakage",
    "external_leakage_n_s": "external leakage",
}
DRIVE, HELD, WATCH = 0.15, 0.02, 0.25
WINDOWS = {"move": (0.0, DRIVE), "stop": (DRIVE, DRIVE + 0.15)}  # s after the command to move
BINS = 8
FEWEST = 10  # smallest number of samples in a bin of pressure differences


def force_rate_terms(run: Trajectory) -> NDArray[np.float64]:
    """The four terms of (24) in N/s, with the corrected volume of chamber b, along a run of n + 1 samples: (4, n + 1).

    Flow through the valve, motion, internal leakage, external leakage; they add up to dF/dt.
    """
    c = plant_coefficients(run.parameters)
    rows = []
    for sample in range(len(run)):
        s = State(*run.states[sample])
        volume_a, volume_b = chamber_volumes(s.position, c)
        per_flow_a = c.area_a * pressure_rate(1.0, volume_a, c.wall_compliance_a, s.pressure_a, c)
        per_flow_b = c.area_b * pressure_rate(1.0, volume_b, c.wall_compliance_b, s.pressure_b, c)
        valve = per_flow_a * run.flow_a[sample] + per_flow_b * run.flow_b[sample]
        motion = -(per_flow_a * c.area_a + per_flow_b * c.area_b) * s.velocity
        inside = -(per_flow_a + per_flow_b) * internal_leakage(s.pressure_a, s.pressure_b, c)
        rows.append((valve, motion, inside, per_flow_b * external_leakage(s.pressure_b, c)))
    return np.array(rows).T


@cache
def force_rate_table(law: Law) -> pd.DataFrame:
    """The four terms over time for each leak, their sum, and dF/dt from the two chambers (23) as a check."""
    parts = []
    for leak in FEW_LEAKS:
        plant = with_leak(simplified(PLANT, "none", True), leak, law)
        plant = plant.replace(leakage={"external_resistance": resistance_from_flow(EXTERNAL_LEAK)})
        _, holding = equilibrium(plant, START)
        spans = ((HELD, holding), (DRIVE, VOLTAGE), (WATCH, 0.0))
        voltage = np.concatenate([np.full(count(seconds), volts) for seconds, volts in spans])
        run = simulate(plant, voltage, SAMPLE_TIME, {"position": START})
        terms = force_rate_terms(run)
        c = coefficient_array(plant)
        rates = np.array([derivative_array(state, c, 0.0) for state in run.states])
        row_a, row_b = STATE_NAMES.index("pressure_a"), STATE_NAMES.index("pressure_b")
        area_a, area_b = (getattr(Coefficients(*c), f"area_{chamber}") for chamber in "ab")
        columns = {"leak_lpm": leak, "time_s": run.time - count(HELD) * SAMPLE_TIME}
        columns |= dict(zip(TERMS, terms, strict=True)) | {"sum_n_s": sum(terms)}
        columns["from_chambers_n_s"] = area_a * rates[:, row_a] - area_b * rates[:, row_b]
        columns["pressure_difference_bar"] = (run.pressure_a - run.pressure_b) / 1e5
        parts.append(pd.DataFrame(columns))
    return pd.concat(parts, ignore_index=True)


def share_of_leakage(samples: pd.DataFrame) -> float:
    """Sum of |internal leakage term| over the sum of the sizes of all four terms."""
    sizes = samples[list(TERMS)].abs().sum()
    return float(sizes["internal_leakage_n_s"] / sizes.sum())


def shares(table: pd.DataFrame) -> pd.DataFrame:
    """Per leak and window: internal leakage's share of all four sizes, and the mean pressure difference."""
    rows = []
    for leak, part in table.groupby("leak_lpm"):
        for window, (first, last) in WINDOWS.items():
            samples = part[(part["time_s"] >= first) & (part["time_s"] < last)]
            row = {"leak_lpm": leak, "window": window, "leakage_share": share_of_leakage(samples)}
            rows.append(row | {"mean_size_of_difference_bar": samples["pressure_difference_bar"].abs().mean()})
    return pd.DataFrame(rows)


def share_table() -> pd.DataFrame:
    """Leakage's share of the sizes of all four terms by law, leak and size of the pressure difference, bar.

    Over the move and the stop of :func:`force_rate_table`; bins with too few samples are left out.
    """
    tables = {law: force_rate_table(law) for law in LAWS}
    moving = {law: table[table["time_s"] >= 0.0] for law, table in tables.items()}
    largest = max(float(table["pressure_difference_bar"].abs().quantile(0.99)) for table in moving.values())
    edges = np.linspace(0.0, max(largest, 1e-3), BINS + 1)
    rows = []
    for law, table in moving.items():
        for leak in FEW_LEAKS:
            part = table[table["leak_lpm"] == leak]
            size = part["pressure_difference_bar"].abs()
            for low, high in pairwise(edges):
                samples = part[(size >= low) & (size < high)]
                if len(samples) >= FEWEST:
                    row = {"law": law, "leak_lpm": leak, "difference_low_bar": low, "difference_high_bar": high}
                    rows.append(row | {"samples": len(samples), "leakage_share": share_of_leakage(samples)})
    return pd.DataFrame(rows)
