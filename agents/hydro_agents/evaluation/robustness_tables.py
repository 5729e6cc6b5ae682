"""The tables of a robustness protocol: summary, comparison with the baseline, ranking, worst cases."""

from __future__ import annotations

import numpy as np
import pandas as pd

from hydro_agents.evaluation.comparison import ALL
from hydro_agents.evaluation.metrics import COMPARED, ERROR, METRICS
from hydro_agents.evaluation.runner import FAILED, Results, table
from hydro_agents.running.seeds import SEED_MARK
from hydro_agents.running.statistics import interval

LEAK_GROUP = "leak"


@table("protocol")
def facts(results: Results) -> pd.DataFrame:
    """Keys and values: what ran, when, and where."""
    protocol, seeds = results.protocol, results.part("tracking")["seed"]
    own = [
        ("protocol", protocol.title),
        ("sha256", protocol.sha256),
        ("baseline", results.grid.controllers[0]),
        ("conditions", str(len(protocol.conditions))),
        ("seeds", f"{seeds.min()} to {seeds.max()}"),
    ]
    return pd.DataFrame([*own, *results.facts], columns=["key", "value"])


@table("summary")
def summary(results: Results) -> pd.DataFrame:
    """Every metric per controller and condition: mean with its interval, and the worst case."""
    grid, cases, rows = results.grid, results.part("tracking"), []
    for controller in grid.controllers:
        own = cases[cases["controller"] == controller]
        for metric, about in METRICS.items():
            for condition in (ALL, *dict.fromkeys(grid.condition.tolist())):
                chosen = grid.sample(controller, metric, grid.all_plants, grid.under(condition)).dense
                if not chosen.plants:
                    continue
                part = own if condition == ALL else own[own["condition"] == condition]
                worst = part.loc[part[metric].idxmax()]
                rows.append(
                    {
                        "controller": controller,
                        "condition": condition,
                        "metric": metric,
                        "unit": about.unit,
                        **interval(chosen.mean, chosen.plants).named("mean"),
                        "worst": float(worst[metric]),
                        "worst_seed": int(worst["seed"]),
                        "worst_family": worst["family"],
                        "worst_leakage_flow_lpm": worst["leakage_flow_lpm"],
                        "cases": int((~np.isnan(chosen.values)).sum()),
                        "training_seeds": len(chosen.values),
                    }
                )
    return pd.DataFrame(rows)


@table("comparison")
def comparison(results: Results) -> pd.DataFrame:
    """Each controller against the first, over all conditions and under each."""
    grid = results.grid
    conditions = (ALL, *dict.fromkeys(grid.condition.tolist()))
    return grid.comparisons("condition", [(name, grid.all_plants, grid.under(name)) for name in conditions])


@table("families")
def families(results: Results) -> pd.DataFrame:
    """Each controller against the first, per family of references, over the conditions of the group ``leak``.

    Without such a group it is over all conditions. A family that does not occur there has no row.
    """
    grid, cases = results.grid, results.part("tracking")
    leaks = cases.loc[cases["group"] == LEAK_GROUP, "condition"].unique()
    situations = np.isin(grid.condition, leaks) if len(leaks) else grid.all_situations
    names = dict.fromkeys(grid.family.tolist())
    return grid.comparisons("family", [(name, grid.family == name, situations) for name in names])


@table("corrected")
def corrected(results: Results) -> pd.DataFrame:
    """Each policy against the controller that it corrects, over all conditions, if that one is not the baseline."""
    return results.grid.corrected(results.participants.corrected)


@table("ranking")
def ranking(results: Results) -> pd.DataFrame:
    """Controllers in the order of their equally weighted ratio, with their costs."""
    grid, compared = results.grid, results.table("comparison")
    cases, cycles, baseline = results.part("tracking"), results.part("standstill"), grid.controllers[0]
    statuses = results.status[results.status["condition"].isin(list(results.protocol.conditions))]
    best = cases.groupby(["condition", "controller"], sort=False)[ERROR].mean().unstack().idxmin(axis=1)
    equal = [f"equal_weight{frame}{end}" for frame in ("", "_sensor") for end in ("", "_low", "_high")]
    copied = {name: name for name in (*equal, "worst_ratio", *COMPARED)} | {"mean_ratio": "ratio"}
    figures = {baseline: dict.fromkeys(copied.values(), 1.0)}
    if len(compared):
        figures |= compared[compared["condition"] == ALL].set_index("controller").to_dict("index")
    rows = []
    for controller in grid.controllers:
        own = cases[cases["controller"] == controller]
        still = cycles[cycles["controller"] == controller] if len(cycles) else pd.DataFrame({"limit_cycle": []})
        mine = statuses[statuses["controller"].str.partition(SEED_MARK)[0] == controller]
        rows.append(
            {
                "controller": controller,
                **{name: figures.get(controller, {}).get(source, np.nan) for name, source in copied.items()},
                "best_in": int((best == controller).sum()),
                "conditions": int(own["condition"].nunique()),
                "failures": int(own["failed"].sum()),
                "failed_conditions": int((mine["status"] == FAILED).sum()),
                "limit_cycles": int(still["limit_cycle"].sum()),
                "standstills": len(still),
                "training_seeds": int(own["training_seed"].nunique()),
            }
        )
    ranked = pd.DataFrame(rows).sort_values("equal_weight", kind="stable", ignore_index=True)
    ranked.insert(0, "rank", np.arange(1, len(ranked) + 1))
    return ranked


@table("worst_cases")
def worst_cases(results: Results) -> pd.DataFrame:
    """The cases with the largest ratio of errors to the baseline; for the baseline, those with its largest errors."""
    cases, baseline, count = results.part("tracking"), results.grid.controllers[0], results.protocol.worst
    where = ["condition", "family", "leakage_flow_lpm", "plant", "seed"]
    base = cases[cases["controller"] == baseline].groupby(where, sort=False)[ERROR].mean().rename("baseline_error_mm")
    joined = cases.join(base, on=where)
    joined["ratio"] = joined[ERROR] / joined["baseline_error_mm"]
    shown = ["controller", "training_seed", "rank", *where, ERROR]
    shown += ["baseline_error_mm", "ratio", "peak_error_mm", "failed"]
    frames = []
    for name in cases["controller"].unique():
        own = joined[joined["controller"] == name]
        # A case counts once if several conditions do not change it.
        order = own.sort_values(ERROR if name == baseline else "ratio", ascending=False, kind="stable")
        order = order.drop_duplicates(["training_seed", "leakage_flow_lpm", "seed", ERROR]).head(count)
        frames.append(order.assign(rank=np.arange(1, len(order) + 1))[shown])
    return pd.concat(frames, ignore_index=True)
