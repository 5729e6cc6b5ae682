"""Tables with the columns of a protocol's run, made up so that every sentence of the page has a known answer."""

import pandas as pd

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


def part(condition):
    """Group and value of a row."""
    return {"group": "all", "value": ""} if condition == "all" else {"group": "condition", "value": condition}


def comparison():
    rows = []
    for name, ratios in RATIOS.items():
        for condition, ratio in ratios.items():
            row = {"controller": name, "against": "PID", **part(condition), "worst_ratio": 2.0 * ratio, **PRICES}
            for column in ("ratio", "ratio_sensor", "equal_weight", "equal_weight_sensor"):
                row |= {column: ratio, f"{column}_low": ratio - 0.1, f"{column}_high": ratio + 0.1}
            row |= {"share_better": 0.8, "share_better_low": 0.7, "share_better_high": 0.9, "cases": 10}
            rows.append(row)
    return pd.DataFrame(rows)


def summary():
    means = {"mean_error_mm": 0.2, "valve_travel_per_s": 9.0, "supply_energy_j": 300.0, "settling_time_s": 0.1}
    rows = []
    for number, name in enumerate(("PID", *RATIOS)):
        for condition in ("all", *(condition for condition, *_ in CONDITIONS)):
            for metric, mean in means.items():
                row = {"controller": name, **part(condition), "metric": metric, "mean": mean - 0.01 * number}
                rows.append(row | {"mean_low": 0.9 * mean, "mean_high": 1.1 * mean})
    return pd.DataFrame(rows)


def protocol_tables():
    """The tables of a protocol with the baseline PID and the controllers Good and Fair."""
    cycles = [("PID", "leak_0.01", 1.0), ("PID", "leak_0.01", 0.0), ("Good", "leak_0.01", 0.0), ("PID", "leak_8", 0.0)]
    status = ("Good", "period_10ms", "not applicable", "no controller of this name is tuned for 10 ms")
    facts = {"protocol": "robustness", "sha256": "41b35ac0", "command": "hydro evaluate <x>"}
    return {
        "summary": summary(),
        "comparison": comparison(),
        "conditions": pd.DataFrame(CONDITIONS, columns=["condition", "group", "label"]).assign(cases=10),
        "limit_cycles": pd.DataFrame(cycles, columns=["controller", "condition", "limit_cycle"]),
        "status": pd.DataFrame([status], columns=["controller", "condition", "status", "message"]),
        "protocol": pd.DataFrame(facts.items(), columns=["key", "value"]),
    }
