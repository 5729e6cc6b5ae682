"""The conclusions of the paper, and whether they are reproduced: a verdict per conclusion, from the figures' facts."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import pandas as pd

from hydro_agents.report.leaks import SEVERE, TIGHT, flow
from hydro_agents.report.text import number
from paper.facts import NEGLIGIBLE_CHANGE, Facts

YES, PART, NO = "comes out", "in part", "not"
LITTLE = 0.05
"""Relative change of a length or a time that counts as small."""


class Verdict(NamedTuple):
    """One conclusion of the paper."""

    figure: str
    conclusion: str
    verdict: str  # comes out, in part, not
    finding: str  # with its numbers


def verdicts_of(key: str, title: str, facts: Facts) -> list[Verdict]:
    """The verdicts of a figure; an empty list if the paper draws no conclusion from it.

    Args:
        key: of the figure.
        title: of the figure.
        facts: of the figure's table (:mod:`paper.facts`).
    """
    number_of_figure, _, rest = title.partition(":")
    name = rest.strip().capitalize() if number_of_figure == "Further" else number_of_figure
    return [Verdict(name, *row) for row in _JUDGES[key](facts)] if key in _JUDGES else []


def verdict_table(verdicts: list[Verdict]) -> pd.DataFrame:
    """The verdicts as a table."""
    return pd.DataFrame(verdicts, columns=list(Verdict._fields))


_Rows = list[tuple[str, str, str]]


def _ends(first: float, last: float, unit: str, decimals: int) -> str:
    return f"{number(first, decimals)} {unit} at {flow(TIGHT)} and {number(last, decimals)} {unit} at {flow(SEVERE)}"


def _moves(facts: Facts) -> _Rows:
    first, last, swing = facts["first"], facts["last"], facts["swing"]
    ratio = last["move_mm"] / first["move_mm"]
    hidden = max(first["swing_mm"], last["swing_mm"]) < facts["noise"]
    falls = swing[1] < swing[0]
    return [
        (
            "A leak slows the axis",
            YES if ratio < 1.0 - LITTLE else PART if ratio < 1.0 else NO,
            f"The same command moves it {_ends(first['move_mm'], last['move_mm'], 'mm', 1)}.",
        ),
        (
            "A leak damps the oscillation after a stop",
            (PART if hidden else YES) if falls else NO,
            f"Without friction it swings by {_ends(swing[0], swing[1], 'mm', 2)}."
            + (" With the assumed friction the swing is below the noise at every leak." if hidden else ""),
        ),
    ]


def _closed_moves(facts: Facts) -> _Rows:
    sizes = facts["first"]["largest_mm"], facts["last"]["largest_mm"]
    ratio = facts["ratio"]
    return [
        (
            "The slowing also shows in a closed position loop (the paper does not say whether it was closed)",
            YES if ratio >= facts["little"] else PART if ratio > 1.0 + facts["notable"] else NO,
            f"While the axis moves the error reaches {_ends(sizes[0], sizes[1], 'mm', 2)}.",
        )
    ]


def _settling(facts: Facts) -> _Rows:
    falling, combinations = facts["falling"], facts["combinations"]
    free = facts["trend"][-1]
    without_friction = _ends(free["first"], free["last"], "s", 3)
    friction = "".join(
        f" With {row['words']} {facts['forces']} it takes {number(row['first_s'], 3)} s and, at a moderate leak, "
        f"{number(row['moderate_s'], 3)} s."
        for row in facts["hidden"]
    )
    return [
        (
            "The settling time after a quick stop falls as the leak grows",
            YES if falling == combinations and not facts["hidden"] else PART if falling else NO,
            f"It falls at every step in {falling} of {combinations} combinations of friction, valve and law of the "
            f"leak; without friction ({free['name'].lower()}) it is {without_friction}.{friction}",
        )
    ]


def _terms(facts: Facts) -> _Rows:
    both, error = facts["both_signs"], facts["error"]
    return [
        (
            "The four terms of (24) add up to the rate of the force (23)",
            YES if error < 1e-6 else NO,
            "With the corrected signs they agree "
            + ("to rounding." if error < 1e-12 else f"within {error:.0e} of the largest rate."),
        ),
        (
            "Leakage slows the build-up of the force",
            PART if both else YES if facts["against"] else NO,
            "Its sign is that of P_b − P_a"
            + (": it both raises and lowers the force." if both else ": it always acts against the difference."),
        ),
    ]


def _share(facts: Facts) -> _Rows:
    laws, ratio = facts["laws"], facts["ratio"]
    lasting = [law for law in laws if law["persists"]]
    shares = "; ".join(
        f"{law['name'].lower()} {law['low']['percent']} % at {law['low']['bar']} bar, "
        f"{law['high']['percent']} % at {law['high']['bar']} bar"
        for law in laws
    )
    growing = int((ratio > 1.0).sum())
    return [
        (
            "Leakage is negligible while the pressure difference is low",
            NO if len(lasting) == len(laws) else PART if lasting or facts["lowest"] > 0.0 else YES,
            f"Share of the leakage term at {flow(SEVERE)}: {shares}.",
        ),
        (
            "The share of leakage grows with the pressure difference",
            YES if growing == len(ratio) else PART if growing else NO,
            f"It grows in {growing} of {len(ratio)} cases, by factors of {number(ratio.min(), digits=2)} to "
            f"{number(ratio.max(), digits=2)}.",
        ),
    ]


def _loop(facts: Facts) -> _Rows:
    first, last, change = facts["first"], facts["last"], facts["change"]
    remains = last["hump"] == last["hump"]
    peak = f"one of {number(last['hump'], 2)}" if remains else "none"
    return [
        (
            "A loop with a leak is harder to control",
            YES if change < 1.0 - NEGLIGIBLE_CHANGE else NO,
            f"With the same gain the bandwidth is {_ends(first['bandwidth_hz'], last['bandwidth_hz'], 'Hz', 1)}.",
        ),
        (
            "A loop with a leak is better damped",
            NO if remains and last["hump"] >= first["hump"] else YES,
            f"The oil column causes a peak of {number(first['hump'], 2)} at {flow(TIGHT)}, and "
            f"{peak} at {flow(SEVERE)}.",
        ),
    ]


_JUDGES: dict[str, Callable[[Facts], _Rows]] = {
    "fig12_displacement": _moves,
    "fig12_closed_loop": _closed_moves,
    "fig13_settling_time": _settling,
    "section4_force_rate": _terms,
    "section4_share": _share,
    "bode_closed_loop": _loop,
}
