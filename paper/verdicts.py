"""What each figure shows: numbers for the text of the page, a plain table, and verdicts on the paper's conclusions."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
import pandas as pd

from hydro_agents.running.text import Table, number, setting, span
from paper.force_rate import DRAWN, TERMS, shares
from paper.leaks import LEVELS, MODERATE, SEVERE, TIGHT, flow
from paper.loop import closed_bode_summary, sensible_gain
from paper.moves import closed_moves_summary, displacement_summary, ramp_speed
from paper.pictures import SHOWN
from paper.rig import LAWS, SHORT_LAWS, Law, Rig
from paper.sensitivity import effects
from paper.settling import METHODS, chosen, friction_words, trends

YES, PART, NO = "comes out", "in part", "not"

LITTLE = 0.05
"""Relative change of a length that counts as small."""

LARGE = 0.2
"""Relative growth of an error that counts as clear."""

NEGLIGIBLE = 0.03
"""Relative change of a bandwidth that counts as unchanged."""

CLEAR_TREND = 1.5
"""A trend is clear above this ratio of settling with a tight seal to settling with a moderate leak."""

LASTING = 0.25
"""A share of leakage that is still so large, relative to its largest one, is not negligible."""


class Verdict(NamedTuple):
    """One conclusion of the paper, and whether it comes out here."""

    conclusion: str
    verdict: str  # comes out, in part, not
    finding: str  # with its numbers


class Shown(NamedTuple):
    """What a figure shows."""

    numbers: dict[str, Any]  # for the text
    table: Table | None = None
    verdicts: tuple[Verdict, ...] = ()


def by_leak(
    summary: pd.DataFrame, columns: Mapping[str, tuple[str, int]], groups: tuple[tuple[str, int], ...] = ()
) -> Table:
    """A table with one row per leak.

    Args:
        summary: by leak.
        columns: heading and decimals of each column.
        groups: titles above the headings, each with its number of columns.
    """
    rows = [
        (setting(leak), *(number(row[name], decimals) for name, (_, decimals) in columns.items()))
        for leak, row in summary.iterrows()
    ]
    header = ("leak, l/min at 100 bar", *(heading for heading, _ in columns.values()))
    return Table("", header, rows, groups)


def _ends(first: float, last: float, unit: str, decimals: int) -> str:
    unit = f" {unit}" if unit else ""
    return f"{number(first, decimals)}{unit} at {flow(TIGHT)} and {number(last, decimals)}{unit} at {flow(SEVERE)}"


def displacement(rig: Rig, table: pd.DataFrame) -> Shown:
    """Fig. 12: the first move, the creep after it, and the oscillation."""
    summary = displacement_summary(table, rig.stretch).set_index("leak_lpm")
    free = summary[~summary["friction"]]
    rows = summary[summary["friction"] == rig.has_friction].assign(free_mm=free["swing_mm"])
    first, last, noise = rows.iloc[0], rows.iloc[-1], float(summary["noise_mm"].mean())
    ratio = last["move_mm"] / first["move_mm"]
    hidden = max(first["swing_mm"], last["swing_mm"]) < noise
    verdicts = (
        Verdict(
            "A leak slows the axis",
            YES if ratio < 1.0 - LITTLE else PART if ratio < 1.0 else NO,
            f"The same command moves it {_ends(first['move_mm'], last['move_mm'], 'mm', 1)}.",
        ),
        Verdict(
            "A leak damps the oscillation after a stop",
            (PART if hidden else YES) if last["free_mm"] < first["free_mm"] else NO,
            f"Without friction it swings by {_ends(first['free_mm'], last['free_mm'], 'mm', 2)}."
            + (" With the assumed friction the swing is below the noise at every leak." if hidden else ""),
        ),
    )
    columns = {
        "move_mm": ("length", 1),
        "back_mm": ("back", 2),
        "forth_mm": ("forth", 2),
        "swing_mm": ("as assumed", 3),
        "free_mm": ("no friction", 3),
    }
    groups = (("first move, mm", 1), ("creep after it, mm", 2), ("oscillation, mm", 2))
    return Shown({"rows": rows, "noise": noise}, by_leak(rows, columns, groups), verdicts)


def closed_moves(rig: Rig, table: pd.DataFrame) -> Shown:
    """Fig. 12 in a closed loop: errors and commands."""
    summary = closed_moves_summary(table, rig)
    sizes = summary["largest_mm"].iloc[0], summary["largest_mm"].iloc[-1]
    growth = sizes[1] / sizes[0] - 1.0
    verdict = Verdict(
        "The slowing also shows in a closed position loop (the paper does not say whether it was closed)",
        YES if growth >= LARGE else PART if growth > LITTLE else NO,
        f"While the axis moves the error reaches {_ends(*sizes, 'mm', 2)}.",
    )
    rows = summary.assign(volts=10.0 * summary["command"])
    columns = {"largest_mm": ("largest error, mm", 2), "left_mm": ("error at the end of the first stop, mm", 3)}
    columns |= {"volts": ("command there, V", 2)}
    numbers = {"rows": rows, "gain": sensible_gain(rig), "speed": ramp_speed(rig)}
    return Shown(numbers, by_leak(rows, columns), (verdict,))


def settling(rig: Rig, table: pd.DataFrame) -> Shown:
    """Fig. 13: whether the settling time falls as the leak grows."""
    summary = trends(table)
    clean = summary[summary["method"] == "clean_s"]
    throttle = clean[clean["law"] == "throttle"]
    free = throttle[throttle["friction"] == "none"].iloc[0]
    # The rig's own valve is the last one; a rig without friction has no row here.
    own = throttle[throttle["friction"] != "none"].drop_duplicates("friction", keep="last")
    hidden = own[own["first_s"] <= CLEAR_TREND * own["moderate_s"]]
    falling, forces = int(clean["falls"].sum()), "as assumed" if rig.is_paper else "and the forces of this rig"
    friction = "".join(
        f" With {friction_words(row['friction'])} {forces} it takes {number(row['first_s'], 3)} s and, at a moderate "
        f"leak, {number(row['moderate_s'], 3)} s."
        for _, row in hidden.iterrows()
    )
    verdict = Verdict(
        "The settling time after a quick stop falls as the leak grows",
        YES if falling == len(clean) and hidden.empty else PART if falling else NO,
        f"It falls at every step in {falling} of {len(clean)} combinations of friction, valve and law of the leak; "
        f"without friction ({SHORT_LAWS['throttle'].lower()}) it is {_ends(free['first_s'], free['last_s'], 's', 3)}."
        + friction,
    )
    unhindered = table[(table["friction"] == "none") & (table["clean_s"] > 0.0)]
    lapped = unhindered[~unhindered["valve_null_leakage"]]
    error = (lapped["theory_s"] / lapped["clean_s"] - 1.0).abs().groupby(lapped["law"])
    numbers = {
        "seconds": lambda *what: chosen(table, *what[:3])["clean_s"][what[3]],  # law, friction, null leakage, leak
        "omega": chosen(table, "laminar", "none", False)["natural_frequency_rad_s"].loc[TIGHT],
        "theory": {"median": error.median(), "largest": error.max()},
        "signal_error": float((unhindered["signal_s"] / unhindered["clean_s"] - 1.0).abs().median()),
        "fastest_signal": float(unhindered["signal_s"].min()),
    }
    return Shown(numbers, _combinations(table, summary), (verdict,))


def _combinations(table: pd.DataFrame, summary: pd.DataFrame) -> Table:
    """All combinations: settling times over the leaks, and whether they fall as in the paper."""
    leaks, rows = [leak for leak in LEVELS if leak in set(table["leak_lpm"]) - {0.03}], []
    for _, row in summary.iterrows():
        times = chosen(table, row["law"], row["friction"], row["valve_null_leakage"])[row["method"]]
        first = (friction_words(row["friction"]), "null leakage" if row["valve_null_leakage"] else "zero-lapped")
        middle = (row["law"], METHODS[row["method"]], *(number(times[leak], 3) for leak in leaks))
        rows.append((*first, *middle, "yes" if row["falls"] else "no", number(row["ratio"], 1)))
    header = ("friction", "valve", "leak", "settling time, s, by", *map(flow, leaks), "falls at every step")
    return Table("Every combination of law, friction and valve", (*header, "first / last"), rows, style="words")


def terms(rig: Rig, table: pd.DataFrame, law: Law) -> Shown:
    """Section 4: sizes of the terms, the check with (23), and leakage's share in move and stop."""
    windows = shares(table, rig.stretch).set_index(["window", "leak_lpm"])
    part = table[table["leak_lpm"] == DRAWN]
    leakage, largest = table["internal_leakage_n_s"], table["from_chambers_n_s"].abs().max()
    error = (table["sum_n_s"] - table["from_chambers_n_s"]).abs().max() / largest
    against = (np.sign(leakage) == -np.sign(table["pressure_difference_bar"])).mean() > 0.999
    both = leakage.min() < 0.0 < leakage.max()
    verdicts = (
        Verdict(
            "The four terms of (24) add up to the rate of the force (23)",
            YES if error < 1e-6 else NO,
            "With the corrected signs they agree "
            + ("to rounding." if error < 1e-12 else f"within {error:.0e} of the largest rate."),
        ),
        Verdict(
            "Leakage slows the build-up of the force",
            PART if both else YES if against else NO,
            "Its sign is that of P_b − P_a"
            + (": it both raises and lowers the force." if both else ": it always acts against the difference."),
        ),
    )
    merged: dict[str, pd.Series] = {}
    columns: dict[str, tuple[str, int]] = {}
    for window in ("move", "stop"):
        merged[window] = 100.0 * windows.loc[window]["leakage_share"]
        merged[f"{window}_bar"] = windows.loc[window]["mean_size_of_difference_bar"]
        columns |= {window: ("share of leakage, %", 3), f"{window}_bar": ("mean |P_a − P_b|, bar", 1)}
    numbers = {"law": law, "sizes": 1e-3 * part[list(TERMS)].abs().max(), "error": error, "law_words": LAWS[law]}
    numbers |= {"rest": part[part["time_s"] < 0.0].iloc[0], "stop": windows.loc["stop"].loc[DRAWN]}
    shown = by_leak(pd.DataFrame(merged), columns, (("in the move", 2), ("after the stop", 2)))
    return Shown(numbers, shown, verdicts if law == "laminar" else ())


def share(rig: Rig, table: pd.DataFrame) -> Shown:
    """Section 4: leakage's share at the lowest and at the highest pressure difference."""
    ends = table.groupby(["law", "leak_lpm"], sort=False).agg(["first", "last"])
    rows, said, lasting = [], [], []
    for (law, leak), end in ends.iterrows():
        words = []
        for side in ("first", "last"):
            percent = 100.0 * float(end["leakage_share", side])
            bar = span(end["difference_low_bar", side], end["difference_high_bar", side], 1)
            words.append((bar, number(percent, digits=2) if percent > 0.0 else number(percent, 1)))
        rows.append((SHORT_LAWS[law], setting(leak), *words[0], *words[1]))
        if leak == SEVERE:
            said.append(
                f"{SHORT_LAWS[law].lower()} " + ", ".join(f"{percent} % at {bar} bar" for bar, percent in words)
            )
            lasts = end["leakage_share", "first"] > LASTING * end["leakage_share", "last"]
            lasting.append(bool(lasts and end["difference_low_bar", "first"] == 0.0))
    ratio = ends["leakage_share", "last"] / ends["leakage_share", "first"]
    growing, lowest = int((ratio > 1.0).sum()), float(table["difference_low_bar"].min())
    verdicts = (
        Verdict(
            "Leakage is negligible while the pressure difference is low",
            NO if all(lasting) else PART if any(lasting) or lowest > 0.0 else YES,
            f"Share of the leakage term at {flow(SEVERE)}: {'; '.join(said)}.",
        ),
        Verdict(
            "The share of leakage grows with the pressure difference",
            YES if growing == len(ratio) else PART if growing else NO,
            f"It grows in {growing} of {len(ratio)} cases, by factors of {number(ratio.min(), digits=2)} to "
            f"{number(ratio.max(), digits=2)}.",
        ),
    )
    header = ("law", "leak, l/min at 100 bar", "bar", "share, %", "bar", "share, %")
    groups = (("", 1), ("lowest |P_a − P_b|", 2), ("highest", 2))
    return Shown({"ratio": ratio}, Table("", header, rows, groups), verdicts)


def closed_loop(rig: Rig, table: pd.DataFrame) -> Shown:
    """Bandwidth, peaks and value at rest of the closed loop."""
    summary = closed_bode_summary(table)
    first, last = summary.iloc[0], summary.iloc[-1]
    if np.isfinite(first["hump"]):
        remains = bool(np.isfinite(last["hump"]))
        damped = not remains or last["hump"] < first["hump"]
        new, worn = number(first["hump"], 2), f"one of {number(last['hump'], 2)}" if remains else "none"
        peak = f"The oil column causes a peak of {new} at {flow(TIGHT)}, and {worn} at {flow(SEVERE)}."
    else:  # the oil column is stiff, or the loop slow: one peak at most
        damped = last["peak"] < (1.0 - NEGLIGIBLE) * first["peak"]
        peak = (
            f"The oil column has no peak of its own; the largest gain is {_ends(first['peak'], last['peak'], '', 2)}."
        )
    verdicts = (
        Verdict(
            "A loop with a leak is harder to control",
            YES if last["bandwidth_hz"] / first["bandwidth_hz"] < 1.0 - NEGLIGIBLE else NO,
            f"With the same gain the bandwidth is {_ends(first['bandwidth_hz'], last['bandwidth_hz'], 'Hz', 1)}.",
        ),
        Verdict("A loop with a leak is better damped", YES if damped else NO, peak),
    )
    columns = {"bandwidth_hz": ("bandwidth, Hz", 2), "peak": ("largest gain", 3), "peak_hz": ("at, Hz", 2)}
    columns |= {"hump": ("peak of the oil column", 3), "at_rest": ("gain at rest", 4)}
    columns |= {"largest_gain_per_m": ("largest stable gain here, 1/m", 1)}
    return Shown({"rows": summary}, by_leak(summary, columns), verdicts)


def friction_scan(rig: Rig, table: pd.DataFrame) -> Shown:
    """Settling times over friction with a tight seal and a moderate leak."""
    scan = table.pivot(index="friction_share", columns="leak_lpm", values="settling_s")
    force = rig.parameters.friction.coulomb_force
    rows = []
    for part, row in scan.iterrows():
        times = (number(row[TIGHT], 3), number(row[MODERATE], 3), number(row[TIGHT] / row[MODERATE], 1))
        rows.append((setting(100 * part), number(part * force, 1), *times))
    header = ("friction, % of what is assumed", "Coulomb force, N", f"settling at {flow(TIGHT)}, s")
    shown = Table("", (*header, f"at {flow(MODERATE)}, s", "ratio"), rows)
    return Shown({"scan": scan, "force": force, "model": friction_words(rig.parameters.friction.model)}, shown)


def sensitivity(rig: Rig, table: pd.DataFrame) -> Shown:
    """The number of parameters that were varied; the picture has the effects."""
    grid = effects(table)
    return Shown({"total": len(grid), "shown": min(len(grid), SHOWN), "idle": int((grid.max(axis=1) < 1.0).sum())})
