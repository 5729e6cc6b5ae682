"""What each figure shows: a plain table, and verdicts on the paper's conclusions, each with the number it rests on."""

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
import pandas as pd

from hydro_agents.running.text import number
from paper.force_rate import shares
from paper.loop import closed_bode_summary
from paper.moves import displacement_summary
from paper.rig import LAWS, MODERATE, SEVERE, TIGHT, flow
from paper.settling import friction_words, trends

YES, PART, NO = "comes out", "in part", "not"

LITTLE = 0.05  # relative change of a length that counts as small
NEGLIGIBLE = 0.03  # relative change of a bandwidth that counts as unchanged
CLEAR_TREND = 1.5  # a trend is clear above this ratio of settling with a tight seal to settling with a moderate leak
LASTING = 0.25  # a share of leakage that is still so large, relative to its largest one, is not negligible


class Verdict(NamedTuple):
    """One conclusion of the paper, and whether it comes out here."""

    conclusion: str
    verdict: str  # comes out, in part, not
    measured: str  # the quantity
    here: str  # its values


class Shown(NamedTuple):
    """What a figure shows."""

    table: pd.DataFrame
    verdicts: tuple[Verdict, ...] = ()


def by_leak(summary: pd.DataFrame, columns: Mapping[str, str]) -> pd.DataFrame:
    """A table with one row per leak: ``summary`` is indexed by it, ``columns`` has the headings by name."""
    return summary[list(columns)].rename(columns=columns).rename_axis("leak, l/min at 100 bar")


def _ends(first: float, last: float, decimals: int) -> str:
    return f"{number(first, decimals)} at {flow(TIGHT)}, {number(last, decimals)} at {flow(SEVERE)}"


def displacement(table: pd.DataFrame) -> Shown:
    """Fig. 12: the first move, the creep after it, and the oscillation."""
    summary = displacement_summary(table).set_index("leak_lpm")
    free = summary[~summary["friction"]]
    rows = summary[summary["friction"]].assign(free_mm=free["swing_mm"])
    first, last = rows.iloc[0], rows.iloc[-1]
    ratio = last["move_mm"] / first["move_mm"]
    hidden = max(first["swing_mm"], last["swing_mm"]) < summary["noise_mm"].mean()
    verdicts = (
        Verdict(
            "A leak slows the axis",
            YES if ratio < 1.0 - LITTLE else PART if ratio < 1.0 else NO,
            "length of the first move, mm",
            _ends(first["move_mm"], last["move_mm"], 1),
        ),
        Verdict(
            "A leak damps the oscillation after a stop",
            (PART if hidden else YES) if last["free_mm"] < first["free_mm"] else NO,
            "swing without friction, mm; in part: with friction it is below the noise",
            _ends(first["free_mm"], last["free_mm"], 2),
        ),
    )
    columns = {
        "move_mm": "length of the first move, mm",
        "back_mm": "creep back, mm",
        "forth_mm": "creep forth, mm",
        "swing_mm": "oscillation as assumed, mm",
        "free_mm": "oscillation without friction, mm",
    }
    return Shown(by_leak(rows, columns), verdicts)


def settling(table: pd.DataFrame) -> Shown:
    """Fig. 13: whether the settling time falls as the leak grows."""
    times = trends(table)
    falls = times.pop("falls")
    throttle = times.xs("throttle", level="law")
    own = throttle.xs(True, level="valve_null_leakage").drop("none")
    hidden = own[TIGHT] <= CLEAR_TREND * own[MODERATE]
    free = throttle.loc[("none", False)]
    verdict = Verdict(
        "The settling time after a quick stop falls as the leak grows",
        YES if falls.all() and not hidden.any() else PART if falls.any() else NO,
        f"settling time without friction, s; it falls at every step in {falls.sum()} of {len(falls)} combinations",
        _ends(free.iloc[0], free.iloc[-1], 3),
    )
    names = []
    for friction, underlap, law in times.index:
        names.append(f"{friction_words(friction)}, {'null leakage' if underlap else 'zero-lapped'}, {law}")
    shown = times.set_axis(names, axis=0).rename(columns=lambda leak: f"settling at {flow(leak)}, s")
    return Shown(shown, (verdict,))


def terms(table: pd.DataFrame) -> Shown:
    """Section 4: the check with (23), the direction of the leakage, and its share in move and stop."""
    windows = shares(table).set_index(["window", "leak_lpm"])
    leakage, largest = table["internal_leakage_n_s"], table["from_chambers_n_s"].abs().max()
    error = (table["sum_n_s"] - table["from_chambers_n_s"]).abs().max() / largest
    against = (np.sign(leakage) == -np.sign(table["pressure_difference_bar"])).mean() > 0.999
    both = leakage.min() < 0.0 < leakage.max()
    verdicts = (
        Verdict(
            "The four terms of (24) add up to the rate of the force (23)",
            YES if error < 1e-6 else NO,
            "largest difference over the largest rate, with the corrected signs",
            "rounding" if error < 1e-12 else f"{error:.0e}",
        ),
        Verdict(
            "Leakage slows the build-up of the force",
            PART if both else YES if against else NO,
            "leakage term, kN/s; its sign is that of P_b − P_a",
            f"{number(1e-3 * leakage.min(), 1)} to {number(1e-3 * leakage.max(), 1)}",
        ),
    )
    merged = {}
    for window, when in (("move", "in the move"), ("stop", "after the stop")):
        merged[f"share of leakage {when}, %"] = 100.0 * windows.loc[window]["leakage_share"]
        merged[f"mean |P_a − P_b| {when}, bar"] = windows.loc[window]["mean_size_of_difference_bar"]
    return Shown(pd.DataFrame(merged), verdicts)


def share(table: pd.DataFrame) -> Shown:
    """Section 4: leakage's share at the lowest and at the highest pressure difference."""
    ends = table.groupby(["law", "leak_lpm"], sort=False).agg(["first", "last"])
    share_at, bar_at = ends["leakage_share"], ends["difference_low_bar"]
    ratio = share_at["last"] / share_at["first"]
    severe = ratio.xs(SEVERE, level="leak_lpm")
    lasting = (severe < 1.0 / LASTING) & (bar_at["first"].xs(SEVERE, level="leak_lpm") == 0.0)
    growing = int((ratio > 1.0).sum())
    verdicts = (
        Verdict(
            "Leakage is negligible while the pressure difference is low",
            NO if lasting.all() else PART if lasting.any() or table["difference_low_bar"].min() > 0.0 else YES,
            f"share at the highest difference over that at the lowest, leak of {flow(SEVERE)}",
            ", ".join(f"{number(value, digits=2)} ({LAWS[law].lower()})" for law, value in severe.items()),
        ),
        Verdict(
            "The share of leakage grows with the pressure difference",
            YES if growing == len(ratio) else PART if growing else NO,
            f"the same ratio over all leaks and laws; above 1 in {growing} of {len(ratio)} cases",
            f"{number(ratio.min(), digits=2)} to {number(ratio.max(), digits=2)}",
        ),
    )
    rows = {}
    for (law, leak), end in ends.iterrows():
        rows[f"{LAWS[law]}, {flow(leak)}"] = {
            "share at the lowest |P_a − P_b|, %": 100.0 * end["leakage_share", "first"],
            "up to, bar": end["difference_high_bar", "first"],
            "share at the highest, %": 100.0 * end["leakage_share", "last"],
            "from, bar": end["difference_low_bar", "last"],
        }
    return Shown(pd.DataFrame.from_dict(rows, orient="index"), verdicts)


def closed_loop(table: pd.DataFrame) -> Shown:
    """Bandwidth, peaks and value at rest of the closed loop."""
    summary = closed_bode_summary(table)
    first, last = summary.iloc[0], summary.iloc[-1]
    verdicts = (
        Verdict(
            "A loop with a leak is harder to control",
            YES if last["bandwidth_hz"] / first["bandwidth_hz"] < 1.0 - NEGLIGIBLE else NO,
            "bandwidth with the same gain, Hz",
            _ends(first["bandwidth_hz"], last["bandwidth_hz"], 1),
        ),
        Verdict(
            "A loop with a leak is better damped",
            YES if np.isfinite(first["hump"]) and not last["hump"] >= first["hump"] else NO,  # NaN: no peak
            "peak of the oil column (–: none)",
            _ends(first["hump"], last["hump"], 2),
        ),
    )
    columns = {
        "bandwidth_hz": "bandwidth, Hz",
        "peak": "largest gain",
        "peak_hz": "at, Hz",
        "hump": "peak of the oil column",
        "at_rest": "gain at rest",
        "largest_gain_per_m": "largest stable gain here, 1/m",
    }
    return Shown(by_leak(summary, columns), verdicts)
