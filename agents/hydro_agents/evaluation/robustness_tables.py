"""The tables of a robustness protocol: summary, comparison with the baseline, ranking, profiles, worst cases."""

from __future__ import annotations

import numpy as np
import pandas as pd

from hydro_agents.evaluation.metrics import COMPARED, ERROR, METRICS
from hydro_agents.evaluation.participants import sees_table
from hydro_agents.evaluation.runner import FAILED, Results, table
from hydro_agents.running.seeds import SEED_MARK
from hydro_agents.running.statistics import interquartile_means, interval, means

KIND = "robustness"
ALL = "all"
LEAK_GROUP = "leak"
CLOSED = ("gap", "score", "score_low", "score_high")  # 0 for the baseline; all other figures of the ranking are ratios
PROFILE_RATIOS = {"best": np.geomspace(1.0, 10.0, 41), "baseline": np.geomspace(0.2, 5.0, 41)}


@table("sees", KIND)
def inputs(results: Results) -> pd.DataFrame:
    """The inputs of every controller."""
    return sees_table(results.participants, results.protocol.task)


@table("protocol", KIND)
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


@table("summary", KIND)
def summary(results: Results) -> pd.DataFrame:
    """Every metric per controller and condition: mean and interquartile mean with intervals, and the worst case."""
    grid, cases, rows = results.grid, results.part("tracking"), []
    for controller in grid.controllers:
        own = cases[cases["controller"] == controller]
        for metric, about in METRICS.items():
            values = grid.values(controller, metric)
            for condition in (ALL, *dict.fromkeys(grid.condition.tolist())):
                chosen = values[:, :, (grid.condition == condition) | (condition == ALL)]
                there = ~np.isnan(chosen)
                if not there.any():
                    continue
                used = np.asarray(there.any(axis=(0, 2)))
                weights = grid.weights(controller, len(chosen), used)
                mean = interval(means(chosen[:, used], weights), int(used.sum()))
                middle = interval(interquartile_means(chosen[:, used], weights), int(used.sum()))
                part = own if condition == ALL else own[own["condition"] == condition]
                worst = part.loc[part[metric].idxmax()]
                rows.append(
                    {
                        "controller": controller,
                        "condition": condition,
                        "metric": metric,
                        "unit": about.unit,
                        **mean.named("mean"),
                        **middle.named("iqm"),
                        "worst": float(worst[metric]),
                        "worst_seed": int(worst["seed"]),
                        "worst_family": worst["family"],
                        "worst_leakage_flow_lpm": worst["leakage_flow_lpm"],
                        "cases": int(there.sum()),
                        "training_seeds": len(values),
                    }
                )
    return pd.DataFrame(rows)


@table("comparison", KIND)
def comparison(results: Results) -> pd.DataFrame:
    """Each controller against the first, over all conditions and under each."""
    grid, rows = results.grid, []
    everybody = np.ones(len(grid.family), dtype=np.bool_)
    for controller in grid.controllers[1:]:
        for condition in (ALL, *dict.fromkeys(grid.condition.tolist())):
            situations = (grid.condition == condition) | (condition == ALL)
            row = grid.compare(controller, grid.controllers[0], everybody, situations)
            if row["cases"]:
                rows.append({"controller": controller, "against": grid.controllers[0], "condition": condition, **row})
    return pd.DataFrame(rows)


@table("families", KIND)
def families(results: Results) -> pd.DataFrame:
    """Each controller against the first, per family of references, over the conditions of the group ``leak``.

    Without such a group it is over all conditions. A family that does not occur there has no row.
    """
    grid, cases = results.grid, results.part("tracking")
    leaks = cases.loc[cases["group"] == LEAK_GROUP, "condition"].unique()
    situations = np.isin(grid.condition, leaks) if len(leaks) else np.ones(len(grid.condition), dtype=np.bool_)
    rows = []
    for controller in grid.controllers[1:]:
        for family in dict.fromkeys(grid.family.tolist()):
            row = grid.compare(controller, grid.controllers[0], grid.family == family, situations)
            if row["cases"]:
                rows.append({"controller": controller, "against": grid.controllers[0], "family": family, **row})
    return pd.DataFrame(rows)


@table("ranking", KIND)
def ranking(results: Results) -> pd.DataFrame:
    """Controllers in the order of their equally weighted ratio, with their costs."""
    grid, compared = results.grid, results.table("comparison")
    cases, cycles, baseline = results.part("tracking"), results.part("standstill"), grid.controllers[0]
    statuses = results.status[results.status["condition"].isin(list(results.protocol.conditions))]
    by_condition = cases.groupby(["condition", "controller"], sort=False)[ERROR].mean().unstack()
    best = by_condition.idxmin(axis=1)
    equal = [f"equal_weight{frame}{end}" for frame in ("", "_sensor") for end in ("", "_low", "_high")]
    copied = (*equal, "worst_ratio", *COMPARED, *CLOSED)
    rows = []
    for controller in grid.controllers:
        if controller == baseline:
            shared = {name: 0.0 if name in CLOSED else 1.0 for name in (*copied, "mean_ratio")}
        else:
            found = compared[(compared["controller"] == controller) & (compared["condition"] == ALL)]
            row = found.iloc[0].to_dict() if len(found) else {}
            shared = {name: row.get(name, np.nan) for name in copied} | {"mean_ratio": row.get("ratio", np.nan)}
        own = cases[cases["controller"] == controller]
        still = cycles[cycles["controller"] == controller] if len(cycles) else None
        mine = statuses[statuses["controller"].str.partition(SEED_MARK)[0] == controller]
        rows.append(
            {
                "controller": controller,
                **shared,
                "best_in": int((best == controller).sum()),
                "conditions": int(own["condition"].nunique()),
                "failures": int(own["failed"].sum()),
                "failed_conditions": int((mine["status"] == FAILED).sum()),
                "limit_cycles": int(still["limit_cycle"].sum()) if still is not None else 0,
                "standstills": len(still) if still is not None else 0,
                "training_seeds": int(own["training_seed"].nunique()),
            }
        )
    ranked = pd.DataFrame(rows).sort_values("equal_weight", kind="stable", ignore_index=True)
    ranked.insert(0, "rank", np.arange(1, len(ranked) + 1))
    return ranked


@table("profiles", KIND)
def profiles(results: Results) -> pd.DataFrame:
    """Share of cases with an error of at most τ times that of the best controller in the case, or of the baseline.

    It includes only conditions under which every controller ran. Dolan & Moré (2002); intervals as Agarwal et al.
    (2021).
    """
    grid = results.grid
    errors = {name: grid.values(name, ERROR) for name in grid.controllers}
    expected = np.array([np.nanmean(np.where(np.isnan(v), np.inf, v), axis=0) for v in errors.values()])
    shared = np.isfinite(expected).all(axis=0)
    references = {"best": expected.min(axis=0), "baseline": expected[0]}
    used = shared.any(axis=1)
    rows = []
    for against, ratios in PROFILE_RATIOS.items():
        for name, values in errors.items():
            relative = np.where(shared, values / np.where(shared, references[against], np.nan), np.nan)[:, used]
            weights = grid.weights(name, len(values), used)
            for tau in ratios:
                inside = np.where(np.isnan(relative), np.nan, relative <= tau * (1.0 + 1e-12))
                share = interval(means(inside, weights), int(used.sum()))
                rows.append(
                    {
                        "controller": name,
                        "against": against,
                        "tau": float(tau),
                        **share.columns("share"),
                    }
                )
    return pd.DataFrame(rows)


@table("worst_cases", KIND)
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
