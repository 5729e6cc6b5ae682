"""Tables with the columns of a protocol's run, made up so that every sentence of the page has a known answer."""

import numpy as np
import pandas as pd

from hydro_agents.evaluation.metrics import COMPARED

CONDITIONS = [
    ("leak_0.01", "leak", "0.01 l/min"),
    ("leak_8", "leak", "8 l/min"),
    ("latency_5ms", "timing", "latency 5 ms"),
    ("period_10ms", "timing", "period 10 ms"),
    ("mass_x0.5", "parameter", "mass × 0.5"),
]
RATIOS = {  # controller: ratio under each condition, with an interval of ± 0.1
    "Good": {"all": 0.7, "leak_0.01": 0.5, "leak_8": 0.7, "latency_5ms": 1.4, "mass_x0.5": 0.6},
    "Fair": {"all": 0.95, "leak_0.01": 0.8, "leak_8": 1.02, "latency_5ms": 0.99, "period_10ms": 1.3, "mass_x0.5": 0.9},
}
PRICES = {"travel_ratio": 0.8, "reversals_ratio": 1.1, "energy_ratio": 0.98, "offset_ratio": 0.7}


def comparison():
    rows = []
    for name, ratios in RATIOS.items():
        for condition, ratio in ratios.items():
            row = {"controller": name, "against": "PID", "condition": condition, "worst_ratio": 2.0 * ratio, **PRICES}
            for column, value in (("ratio", ratio), ("equal_weight", ratio), ("score", 50.0)):
                row |= {column: value, f"{column}_low": value - 0.1, f"{column}_high": value + 0.1}
            row |= {"share_better": 0.8, "share_better_low": 0.7, "share_better_high": 0.9, "cases": 10}
            rows.append(row)
    return pd.DataFrame(rows)


def summary():
    rows = []
    for number, name in enumerate(("PID", *RATIOS)):
        for condition in ("all", *(condition for condition, *_ in CONDITIONS)):
            for metric, mean in (
                ("mean_error_mm", 0.2),
                ("valve_travel_per_s", 9.0),
                ("supply_energy_j", 300.0),
                ("settling_time_s", 0.1),
            ):
                low, high = 0.9 * mean, 1.1 * mean
                row = {"controller": name, "condition": condition, "metric": metric, "mean": mean - 0.01 * number}
                row |= {"mean_low": low, "mean_high": high, "worst": 1.5}
                rows.append(row)
    return pd.DataFrame(rows)


def cases():
    """Errors in mm of two cases under two conditions: Good is worst at 5 ms (0.4 / 0.2), PID at 8 l/min (0.9 / 0.3)."""
    errors = {
        ("latency_5ms", "step", 7): {"PID": 0.2, "Good": 0.4, "Fair": 0.25},
        ("latency_5ms", "sine", 8): {"PID": 0.2, "Good": 0.3, "Fair": 0.2},
        ("leak_8", "ramp", 9): {"PID": 0.9, "Good": 0.3, "Fair": 0.5},
    }
    rows = [
        {"condition": condition, "family": family, "leakage_flow_lpm": 4.0, "seed": 2_200_000 + seed}
        | {"controller": name, "training_seed": 0, "mean_error_mm": error}
        | {"plant": seed, "mean_error_sensor_mm": error, **dict.fromkeys((m.name for m in COMPARED.values()), 1.0)}
        for (condition, family, seed), by_name in errors.items()
        for name, error in by_name.items()
    ]
    return pd.DataFrame(rows)


def protocol_tables():
    """The tables of a protocol with the baseline PID and the controllers Good and Fair."""
    ranking = [
        {"rank": 1, "controller": "Good", "best_in": 3, "conditions": 5, "failures": 0, "limit_cycles": 0},
        {"rank": 2, "controller": "Fair", "best_in": 1, "conditions": 5, "failures": 2, "limit_cycles": 4},
        {"rank": 3, "controller": "PID", "best_in": 1, "conditions": 5, "failures": 0, "limit_cycles": 9},
    ]
    worst = {"training_seed": 0, "rank": 1, "condition": "latency_5ms", "family": "step", "leakage_flow_lpm": 4.0}
    worst |= {"plant": 0, "seed": 2_200_007, "mean_error_mm": 0.4, "baseline_error_mm": 0.2, "ratio": 2.0}
    cycles = [("PID", "leak_0.01", 1.0), ("PID", "leak_0.01", 0.0), ("Good", "leak_0.01", 0.0), ("PID", "leak_8", 0.0)]
    families = comparison().query("condition == 'leak_8'").drop(columns="condition").assign(family="step")
    status = ("Good", "period_10ms", "not applicable", "no controller of this name is tuned for 10 ms")
    facts = {"protocol": "robustness", "sha256": "41b35ac0", "baseline": "PID", "command": "hydro evaluate <x>"}
    return {
        "summary": summary(),
        "cases": cases(),
        "comparison": comparison(),
        "families": families,
        "conditions": pd.DataFrame(CONDITIONS, columns=["condition", "group", "label"]).assign(cases=10),
        "ranking": pd.DataFrame(ranking),
        "limit_cycles": pd.DataFrame(cycles, columns=["controller", "condition", "limit_cycle"]),
        "worst_cases": pd.DataFrame([{"controller": name, **worst, "peak_error_mm": 3.0} for name in RATIOS]),
        "status": pd.DataFrame([status], columns=["controller", "condition", "status", "message"]),
        "protocol": pd.DataFrame(facts.items(), columns=["key", "value"]),
    }


def experiment_tables():
    """The tables of the experiments for PID and Good."""
    labels = [(name, leak, seed) for name in ("PID", "Good") for leak in (0.01, 4.0) for seed in (0, 1)]
    base = pd.DataFrame(labels, columns=["controller", "leakage_flow_lpm", "seed"])
    standstill = base.assign(unrest_um=20.0, offset_um=1.0, valve_travel_per_s=1.5, failed=False)
    step = base.assign(force_n=872.0, peak_mm=0.2, recovery_s=0.1, remaining_mm=np.where(base["seed"] == 0, 0.0, 0.0))
    step = step.assign(static_mm_per_kn=0.0, dynamic_mm_per_kn=0.23)
    step.loc[1, "recovery_s"] = np.nan
    return {
        "standstill": standstill,
        "force_step": step,
    }
