"""Facts for the sentences about settling: Fig. 13 and the scan of friction."""

from __future__ import annotations

import math

import numpy as np
import pandas as pd

from hydro_agents.report.leaks import LEVELS, MODERATE, TIGHT, flow
from hydro_agents.report.text import Table, number
from paper.facts import Facts
from paper.rig import LAWS, SHORT_LAWS, Law, Rig
from paper.settling import METHODS, chosen, friction_words, trends
from paper.signals import (
    ACCELEROMETER_BANDWIDTH,
    ACCELEROMETER_NOISE,
    GRAVITY,
    SETTLED,
    accelerometer_noise,
)

CLEAR_TREND = 1.5
"""A trend is clear above this ratio of settling with a tight seal to settling with a moderate leak."""

CLEAR_FACTOR = 2.0
"""The same for the scan of friction."""

NULL_LEAKAGE_RATIO = 0.9
"""Below this ratio of settling with to settling without null leakage, the page mentions the damping of the valve."""


def settling_facts(rig: Rig, table: pd.DataFrame) -> Facts:
    """Trends of the settling times, errors of theory and accelerometer, and cases without the paper's trend."""
    summary = trends(table)
    clean = summary[summary["method"] == "clean_s"]
    throttle = clean[(clean["law"] == "throttle") & (clean["friction"] != "none")]
    last_valve = throttle.drop_duplicates("friction", keep="last")
    is_clear = last_valve["first_s"] > CLEAR_TREND * last_valve["moderate_s"]
    free = table[(table["friction"] == "none") & (table["clean_s"] > 0.0)]
    shown = throttle[throttle["first_s"] > CLEAR_TREND * throttle["moderate_s"]]["friction"].unique()
    return {
        "settled": SETTLED,
        "noise": accelerometer_noise(),
        "noise_density": 1e6 * ACCELEROMETER_NOISE / GRAVITY,
        "noise_bandwidth": ACCELEROMETER_BANDWIDTH,
        "trend": [_trend(clean, law) for law in LAWS],
        "theory": [_theory(table, law) for law in LAWS],
        "poor": 0.1,
        "few": 4.0,
        "signal_error": float((free["signal_s"] / free["clean_s"] - 1.0).abs().median()),
        "fastest_signal": float(free["signal_s"].min()),
        "forces": "as assumed" if rig.is_paper else "and the forces of this rig",
        "clear": [_with_words(row) for _, row in last_valve[is_clear].iterrows()],
        "hidden": [_hidden(table, row) for _, row in last_valve[~is_clear].iterrows()],
        "shows": [friction_words(str(model)) for model in shown],
        "falling": int(clean["falls"].sum()),
        "combinations": len(clean),
        "omega": chosen(table, "laminar", "none", False)["natural_frequency_rad_s"].loc[TIGHT],
        "null": _null_leakage(table),
        "rising": [_rise(table, row) for _, row in clean[~clean["falls"]].iterrows()],
        "summary": _settling_summary(table, summary),
    }


def _with_words(row: pd.Series) -> Facts:
    return dict(row) | {"words": friction_words(row["friction"]), "model": row["friction"]}


def _trend(clean: pd.DataFrame, law: Law) -> Facts:
    rows = (clean["law"] == law) & (clean["friction"] == "none") & ~clean["valve_null_leakage"]
    row = clean[rows].iloc[0]
    return {"name": SHORT_LAWS[law], "falls": row["falls"], "first": row["first_s"], "last": row["last_s"]}


def _theory(table: pd.DataFrame, law: Law) -> Facts:
    part = chosen(table, law, "none", False)
    part = part[part["theory_s"].notna() & (part["clean_s"] > 0.0)]
    error = (part["theory_s"] / part["clean_s"] - 1.0).abs()
    return {"name": LAWS[law], "median": error.median(), "largest": error.max()}


def _hidden(table: pd.DataFrame, row: pd.Series) -> Facts:
    """Effect of friction on the trend of one model, and the settling times without friction."""
    part = chosen(table, "throttle", "none", bool(row["valve_null_leakage"]))
    first, moderate = (float(part["clean_s"].loc[leak]) for leak in (TIGHT, MODERATE))
    return _with_words(row) | {
        "free_first": first,
        "free_moderate": moderate,
        "weak": first < CLEAR_TREND * moderate,
        "reversed": row["moderate_s"] > CLEAR_TREND * row["first_s"],
        "periods": row["first_s"] * part["natural_frequency_rad_s"].loc[TIGHT] / (2.0 * np.pi),
        "divides": row["first_s"] / row["moderate_s"] if row["moderate_s"] > 0.0 else math.inf,
    }


def _null_leakage(table: pd.DataFrame) -> Facts | None:
    """Settling without friction with both valves, if the null leakage of the valve makes a difference."""
    if not table["valve_null_leakage"].any():
        return None
    times = {name: chosen(table, "laminar", "none", name == "null")["clean_s"] for name in ("lapped", "null")}
    if times["null"].loc[TIGHT] >= NULL_LEAKAGE_RATIO * times["lapped"].loc[TIGHT]:
        return None
    ends = {"first": TIGHT, "moderate": MODERATE}
    return {f"{name}_{end}": part.loc[leak] for name, part in times.items() for end, leak in ends.items()}


def _rise(table: pd.DataFrame, row: pd.Series) -> Facts:
    """The two neighbouring leaks between which the settling time rises most."""
    times = chosen(table, row["law"], row["friction"], row["valve_null_leakage"])["clean_s"]
    steps = times.diff()
    leak = steps.idxmax()
    before = times.index[times.index.get_loc(leak) - 1]
    facts = {"law": SHORT_LAWS[row["law"]], "words": friction_words(row["friction"]), "null": row["valve_null_leakage"]}
    facts |= {"leak": leak, "before": before, "rises": steps[leak] > 0.0}
    return facts | {"before_s": times.loc[before], "time_s": times.loc[leak]}


def _settling_summary(table: pd.DataFrame, summary: pd.DataFrame) -> Table:
    """All combinations: settling times over the leaks, and whether they fall as in the paper."""
    leaks, rows = [leak for leak in LEVELS if leak in set(table["leak_lpm"]) - {0.03}], []
    for _, row in summary.iterrows():
        times = chosen(table, row["law"], row["friction"], row["valve_null_leakage"])[row["method"]]
        rows.append(
            (
                friction_words(row["friction"]),
                "null leakage" if row["valve_null_leakage"] else "zero-lapped",
                row["law"],
                METHODS[row["method"]],
                *(number(times[leak], 3) for leak in leaks),
                "yes" if row["falls"] else "no",
                number(row["ratio"], 1),
            )
        )
    header = (
        "friction",
        "valve",
        "leak",
        "settling time, s, by",
        *map(flow, leaks),
        "falls at every step",
        "first / last",
    )
    return Table("Every combination of law, friction and valve", header, rows)


def friction_scan_facts(rig: Rig, table: pd.DataFrame) -> Facts:
    """Settling times over friction with a tight seal and a moderate leak, and the most friction with a clear trend."""
    scan = table.pivot(index="friction_share", columns="leak_lpm", values="settling_s")
    ratio = scan[TIGHT] / scan[MODERATE]
    facts = {"tight_s": scan[TIGHT], "moderate_s": scan[MODERATE], "clear": CLEAR_FACTOR}
    facts["most"] = ratio[ratio >= CLEAR_FACTOR].index.max()
    return facts | {
        "model": friction_words(rig.parameters.friction.model),
        "force": rig.parameters.friction.coulomb_force,
    }
