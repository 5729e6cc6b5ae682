"""The numbers and cases for the sentences of a figure (words/*.j2), and the short tables of the page."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pandas as pd

from hydro_agents.controllers.sampled_loop import PLACES
from hydro_agents.report.leaks import SEVERE, TIGHT, flow
from hydro_agents.report.text import Table, number, setting, span
from paper.closed_loop import LONGEST_SETTLING, achievable, sensible_gain
from paper.force_rate import DRAWN, DRIVE, EXTERNAL_LEAK, FEWEST, TERMS, WATCH, WINDOWS, shares
from paper.frequency import LOWEST, NYQUIST, closed_bode_summary, tight_frequency
from paper.holding import DURATION, controllers, held_places
from paper.holding import JUDGED as HOLDING_JUDGED
from paper.moves import JUDGED, closed_moves_summary, displacement_summary, ramp_speed
from paper.pictures_further import SHOWN
from paper.results import FRICTION_SHARE, LEAK, RESULTS
from paper.rig import LAWS, SHORT_LAWS, Law, Rig
from paper.sensitivity import effects, is_scaled
from paper.variations import CHANGE, LEAK_NAME, unused_parameters

Facts = dict[str, Any]
"""Names in a template → values; ``summary`` is a table for the page."""

NEGLIGIBLE_CHANGE = 0.03
"""Largest relative change of a measure of speed that counts as unchanged."""


def displacement_facts(rig: Rig, table: pd.DataFrame) -> Facts:
    """First move, creep and oscillation with the smallest and the largest leak."""
    summary = displacement_summary(table, rig.stretch)
    without = summary[~summary["friction"]]
    rows = summary[summary["friction"]] if rig.has_friction else without
    noise = float(summary["noise_mm"].mean())
    both = rows[(rows[["back_mm", "forth_mm"]] > noise).all(axis=1)]
    creep = rows["drift_mm"]
    return {
        "first": rows.iloc[0],
        "last": rows.iloc[-1],
        "less": rows["move_mm"].iloc[-1] < rows["move_mm"].iloc[0],
        "turns": len(both) > 0 and not (creep.is_monotonic_increasing or creep.is_monotonic_decreasing),
        "middle": both.iloc[len(both) // 2] if len(both) else None,
        "swing": without["swing_mm"].iloc[[0, -1]].tolist(),
        "noise": noise,
    }


def closed_moves_facts(rig: Rig, table: pd.DataFrame) -> Facts:
    """Errors and commands with the smallest and the largest leak."""
    summary = closed_moves_summary(table, rig)
    first, last = summary.iloc[0], summary.iloc[-1]
    facts: Facts = {"first": first, "last": last, "ratio": last["largest_mm"] / first["largest_mm"]}
    facts |= {"little": 1.2, "notable": 0.05, "largest_command": summary["largest_command"].max()}
    return facts | {"gain": sensible_gain(rig), "judged": JUDGED, "speed": ramp_speed(rig)}


def force_rate_facts(rig: Rig, table: pd.DataFrame, law: Law) -> Facts:
    """Sizes of the terms, the check with (23), and leakage's share in move and stop."""
    windows = shares(table, rig.stretch)
    at = {name: windows[windows["window"] == name].set_index("leak_lpm") for name in WINDOWS}
    part = table[table["leak_lpm"] == DRAWN]
    sizes = part[list(TERMS)].abs().max()
    leakage, difference = table["internal_leakage_n_s"], table["pressure_difference_bar"]
    listed = {
        name: ", ".join(
            f"{number(100 * row['leakage_share'], digits=2)} % at {flow(leak)}" for leak, row in rows.iterrows()
        )
        for name, rows in at.items()
    }
    return {
        "law": law,
        "law_words": LAWS[law],
        "drawn": DRAWN,
        "external": EXTERNAL_LEAK,
        "drive": DRIVE,
        "sizes": sizes,
        "second": sizes[["valve_n_s", "motion_n_s"]].min(),
        "against": (np.sign(leakage) == -np.sign(difference)).mean() > 0.999,
        "both_signs": leakage.min() < 0.0 < leakage.max(),
        "error": (table["sum_n_s"] - table["from_chambers_n_s"]).abs().max() / table["from_chambers_n_s"].abs().max(),
        "listed": listed,
        "rest": part[part["time_s"] < 0.0].iloc[0],
        "move": at["move"].loc[DRAWN],
        "stop": at["stop"].loc[DRAWN],
    }


def share_facts(rig: Rig, table: pd.DataFrame) -> Facts:
    """Leakage's share at the lowest and at the highest pressure difference."""
    ends = table.groupby(["law", "leak_lpm"])["leakage_share"].agg(["first", "last"])
    facts: Facts = {"ratio": ends["last"] / ends["first"], "lowest": float(table["difference_low_bar"].min())}
    facts |= {"duration": (DRIVE + WATCH) * rig.stretch, "fewest": FEWEST, "laws": []}
    for law, name in SHORT_LAWS.items():
        part = table[(table["law"] == law) & (table["leak_lpm"] == SEVERE)]
        low, high = part.iloc[0], part.iloc[-1]
        relative = low["leakage_share"] / high["leakage_share"]
        law_facts = {"name": name, "low": _bin(low), "high": _bin(high), "relative": relative}
        law_facts["persists"] = low["difference_low_bar"] == 0.0 and relative > 0.25
        facts["laws"].append(law_facts | {"steep": law == "throttle" and low["leakage_share"] > 0.0})
    return facts


def _bin(row: pd.Series) -> Facts:
    share = 100.0 * float(row["leakage_share"])
    bar = span(row["difference_low_bar"], row["difference_high_bar"], 1)
    return {"percent": number(share, digits=2) if share > 0.0 else number(share, 1), "bar": bar}


def map_facts(rig: Rig, table: pd.DataFrame) -> Facts:
    """Extremes of frequency and damping over the stroke."""
    rows = table.set_index(["leak_lpm", "position_mm"]).sort_index()
    leaks = rows.index.get_level_values("leak_lpm")
    tight, worst = rows.loc[leaks.min()], rows.loc[leaks.max()]
    at_middle = {
        flow(leak): part["damping_ratio"].iloc[len(part) // 2] for leak, part in ((TIGHT, tight), (SEVERE, worst))
    }
    return {"frequency": tight["natural_frequency_hz"], "worst": worst["damping_ratio"], "middle": at_middle}


def bode_facts(rig: Rig, table: pd.DataFrame) -> Facts:
    """Gain at low frequency; the peak at the resonance over the gain well below it."""
    hertz, slow, ratio, peaks = tight_frequency(rig), [], [], []
    for leak in (TIGHT, SEVERE):
        part = table[table["leak_lpm"] == leak].set_index("frequency_hz")["gain_mm_per_v"]
        resonance = part[part.index > 0.7 * hertz]
        slow.append(part.iloc[0])
        ratio.append(resonance.max() / part[part.index > 0.3 * hertz].iloc[0])
        peaks.append(resonance.idxmax())
    return {"lowest_hz": LOWEST, "slow": slow, "ratio": ratio, "peak_hz": peaks[0], "below_hz": 0.3 * hertz}


def closed_bode_facts(rig: Rig, table: pd.DataFrame) -> Facts:
    """Bandwidth, peaks and value at rest with the smallest and the largest leak."""
    summary = closed_bode_summary(table)
    first, last = summary.iloc[0], summary.iloc[-1]
    rows = [
        (
            setting(leak),
            number(row["bandwidth_hz"], 2),
            number(row["peak"], 3) if row["has_peak"] else "none",
            number(row["peak_hz"], 2) if row["has_peak"] else "–",
            number(row["hump"], 3),
            number(row["at_rest"], 4),
            number(row["largest_gain_per_m"], digits=4),
        )
        for leak, row in summary.iterrows()
    ]
    columns = ("bandwidth, Hz", "peak", "at, Hz", "peak of the oil column", "at rest", "largest stable gain here, 1/m")
    table_of_leaks = Table("", ("leak, l/min at 100 bar", *columns), rows)
    change = last["bandwidth_hz"] / first["bandwidth_hz"]
    return {"first": first, "last": last, "change": change, "nyquist": NYQUIST, "summary": table_of_leaks}


def stability_facts(rig: Rig, table: pd.DataFrame) -> Facts:
    """The largest stable gains with a new and a worn seal, and the speeds that they allow."""
    summary = achievable(table)
    new, worn = (summary[summary["law"] == "laminar"].iloc[row] for row in (0, -1))
    throttle = summary[summary["law"] == "throttle"]["limit_per_m"]
    laminar = table[table["law"] == "laminar"]
    by_place = laminar.dropna(subset="limit_per_m").groupby("position_mm")["limit_per_m"].agg(["first", "last"])
    ratios = {
        "bandwidth": worn["bandwidth_hz"] / new["bandwidth_hz"],
        "settling": new["settling_s"] / worn["settling_s"],
        "velocity gain": worn["velocity_gain_per_s"] / new["velocity_gain_per_s"],
    }
    rows = [
        (
            row["law"],
            setting(row["leak_lpm"]),
            number(row["limit_per_m"], digits=4),
            number(row["gain_per_m"], digits=4),
            f"{number(row['bandwidth_hz'], 2)} Hz" if math.isfinite(row["bandwidth_hz"]) else "none",
            _seconds(row["settling_s"]),
            number(row["velocity_gain_per_s"], 1),
        )
        for _, row in summary.iterrows()
    ]
    gains = ("largest stable gain, 1/m", "gain used, 1/m", "bandwidth", "settling to 2 %", "velocity gain, 1/s")
    return {
        "new": new,
        "worn": worn,
        "growth": worn["limit_per_m"] / new["limit_per_m"],
        "growth_throttle": throttle.iloc[-1] / throttle.iloc[0],
        "single": by_place["last"] / by_place["first"],
        "rule": laminar.groupby("leak_lpm")["continuous_limit_per_m"].min(),
        "settling": [_seconds(row["settling_s"]) for row in (new, worn)],
        "better": {name: ratio for name, ratio in ratios.items() if ratio > 1.0 + NEGLIGIBLE_CHANGE},
        "worse": {name: ratio for name, ratio in ratios.items() if ratio < 1.0 - NEGLIGIBLE_CHANGE},
        "places": PLACES,
        "points": len(table),
        "absent": int(table["limit_per_m"].isna().sum()),
        "summary": Table("", ("leak", "l/min at 100 bar", *gains), rows),
    }


def _seconds(time: float) -> str:
    return f"{number(1e3 * time, 0)} ms" if math.isfinite(time) else f"more than {LONGEST_SETTLING:g} s"


def holding_facts(rig: Rig, table: pd.DataFrame) -> Facts:
    """Errors and commands by controller over the leak."""
    error, command = (table.pivot(index="leak_lpm", columns="controller", values=v) for v in ("error_mm", "command_v"))
    facts = {"error": error, "command": command, "gains": controllers(rig), "judged": HOLDING_JUDGED}
    return facts | {"duration": DURATION, "worst_integral": error[["PI", "PID"]].abs().max().max()}


def energy_facts(rig: Rig, table: pd.DataFrame) -> Facts:
    """Power and energy with the smallest and the largest leak through a throttle."""
    part = table[table["law"] == "throttle"]
    first, last = part.iloc[0], part.iloc[-1]
    times = {
        "cycle": last["cycle_j"] / first["cycle_j"],
        "holding": last["holding_second_w"] / first["holding_second_w"],
    }
    return {"first": first, "last": last, "places": held_places(rig)} | times


def sensitivity_facts(rig: Rig, table: pd.DataFrame) -> Facts:
    """The three largest effects on each result, and the parameters with other variations or none."""
    grid, own = effects(table), table[table["parameter"] != LEAK_NAME]
    results = []
    for result in RESULTS:
        part = own[own["result"] == result.name].head(3)
        if len(part):
            listed = [(_named(row.parameter), row.effect_percent) for row in part.itertuples()]
            row = {"words": result.words, "unit": result.unit, "normal": part["normal"].iloc[0], "effects": listed}
            results.append(row)
    special = [row for row in own.drop_duplicates("parameter").itertuples() if not is_scaled(row.value, row.low_value)]
    return {
        "results": results,
        "idle": [_named(name) for name in grid.index[grid.max(axis=1) < 1.0]],
        "unused": [_named(name) for name in unused_parameters(rig)],
        "missing": [result.words for result in RESULTS if result.name not in grid.columns],
        "others": "; ".join(f"{_named(r.parameter)} {r.value} → {r.low_value}, {r.high_value}" for r in special),
        "percent": 100 * CHANGE,
        "shown": min(len(grid), SHOWN),
        "total": len(grid),
        "leak": LEAK,
        "friction_percent": 100 * FRICTION_SHARE,
    }


def _named(path: str) -> str:
    return path.replace(".", ": ").replace("_", " ")
