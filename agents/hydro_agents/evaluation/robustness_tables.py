"""The tables of a protocol: summary, comparison with the baseline, ranking, profiles, worst cases."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from pathlib import Path

import numpy as np
import pandas as pd

from hydro_agents.evaluation.comparison import Grid
from hydro_agents.evaluation.metrics import COMPARED, METRICS
from hydro_agents.evaluation.participants import Participants, sees_table
from hydro_agents.evaluation.robustness_protocol import Protocol
from hydro_agents.evaluation.robustness_running import FAILED, ProtocolRun
from hydro_agents.evaluation.tables import ERROR
from hydro_agents.running.resampling import interquartile_means, interval, means
from hydro_env.files import write_whole

ALL = "all"
LEAK_GROUP = "leak"
PROFILE_RATIOS = {"best": np.geomspace(1.0, 10.0, 41), "baseline": np.geomspace(0.2, 5.0, 41)}


@dataclass(frozen=True)
class Tables:
    """Every table of a protocol; docs/robustness.md describes their columns."""

    cases: pd.DataFrame
    limit_cycles: pd.DataFrame
    bound: pd.DataFrame
    conditions: pd.DataFrame
    summary: pd.DataFrame
    comparison: pd.DataFrame
    families: pd.DataFrame
    ranking: pd.DataFrame
    profiles: pd.DataFrame
    worst_cases: pd.DataFrame
    sees: pd.DataFrame
    status: pd.DataFrame
    protocol: pd.DataFrame

    def write(self, folder: Path) -> None:
        """Write every table that is not empty as CSV.

        Raises:
            ConfigurationError: a file cannot be written.
        """
        for name, table in self.by_name().items():
            if not table.empty:
                write_whole(folder / f"{name}.csv", table.to_csv(index=False).encode())

    def by_name(self) -> dict[str, pd.DataFrame]:
        """The tables by the names of their files."""
        return {part.name: getattr(self, part.name) for part in fields(self)}


def make_tables(
    protocol: Protocol,
    chosen: Participants,
    run: ProtocolRun,
    facts: Sequence[tuple[str, str]] = (),
) -> Tables:
    """All tables of a run.

    Args:
        protocol: the protocol.
        chosen: its controllers; the first one that ran is the baseline.
        run: its results.
        facts: more rows of the table ``protocol``: key and value.
    """
    grid = Grid(run.cases, run.bound)
    comparison, families = comparison_table(grid), families_table(grid, run.cases)
    own = [
        ("protocol", protocol.title),
        ("sha256", protocol.sha256),
        ("baseline", grid.controllers[0]),
        ("conditions", str(len(protocol.conditions))),
        ("seeds", f"{run.cases['seed'].min()} to {run.cases['seed'].max()}"),
    ]
    return Tables(
        cases=run.cases,
        limit_cycles=run.limit_cycles,
        bound=run.bound if run.bound is not None else pd.DataFrame(),
        conditions=protocol.table(),
        summary=summary_table(grid, run.cases),
        comparison=comparison,
        families=families,
        ranking=ranking_table(grid, comparison, run),
        profiles=profile_table(grid),
        worst_cases=worst_table(run.cases, grid.controllers[0], protocol.worst),
        sees=sees_table(chosen, protocol.task),
        status=run.status,
        protocol=pd.DataFrame([*own, *facts], columns=["key", "value"]),
    )


def summary_table(grid: Grid, cases: pd.DataFrame) -> pd.DataFrame:
    """Every metric per controller and condition: mean and interquartile mean with intervals, and the worst case."""
    rows = []
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
                        **dict(zip(("mean", "mean_low", "mean_high"), mean, strict=True)),
                        **dict(zip(("iqm", "iqm_low", "iqm_high"), middle, strict=True)),
                        "worst": float(worst[metric]),
                        "worst_seed": int(worst["seed"]),
                        "worst_family": worst["family"],
                        "worst_leakage_flow_lpm": worst["leakage_flow_lpm"],
                        "cases": int(there.sum()),
                        "training_seeds": len(values),
                    }
                )
    return pd.DataFrame(rows)


def comparison_table(grid: Grid) -> pd.DataFrame:
    """Each controller against the first, over all conditions and under each."""
    everybody = np.ones(len(grid.family), dtype=np.bool_)
    rows = []
    for controller in grid.controllers[1:]:
        for condition in (ALL, *dict.fromkeys(grid.condition.tolist())):
            situations = (grid.condition == condition) | (condition == ALL)
            row = grid.compare(controller, grid.controllers[0], everybody, situations)
            if row["cases"]:
                rows.append({"controller": controller, "against": grid.controllers[0], "condition": condition, **row})
    return pd.DataFrame(rows)


def families_table(grid: Grid, cases: pd.DataFrame) -> pd.DataFrame:
    """Each controller against the first, per family of references, over the conditions of the group ``leak``.

    Without such a group it is over all conditions.
    """
    leaks = cases.loc[cases["group"] == LEAK_GROUP, "condition"].unique()
    situations = np.isin(grid.condition, leaks) if len(leaks) else np.ones(len(grid.condition), dtype=np.bool_)
    return pd.DataFrame(
        [
            {
                "controller": controller,
                "against": grid.controllers[0],
                "family": family,
                **grid.compare(controller, grid.controllers[0], grid.family == family, situations),
            }
            for controller in grid.controllers[1:]
            for family in dict.fromkeys(grid.family.tolist())
        ]
    )


def ranking_table(grid: Grid, comparison: pd.DataFrame, run: ProtocolRun) -> pd.DataFrame:
    """Controllers in the order of their equally weighted ratio, with their costs."""
    baseline = grid.controllers[0]
    by_condition = run.cases.groupby(["condition", "controller"], sort=False)[ERROR].mean().unstack()
    best = by_condition.idxmin(axis=1)
    copied = ("equal_weight", "equal_weight_low", "equal_weight_high", "worst_ratio", *COMPARED, "gap")
    rows = []
    for controller in grid.controllers:
        if controller == baseline:
            shared = {name: 0.0 if name == "gap" else 1.0 for name in (*copied, "mean_ratio")}
        else:
            found = comparison[(comparison["controller"] == controller) & (comparison["condition"] == ALL)]
            row = found.iloc[0].to_dict() if len(found) else {}
            shared = {name: row.get(name, np.nan) for name in copied} | {"mean_ratio": row.get("ratio", np.nan)}
        own = run.cases[run.cases["controller"] == controller]
        still = run.limit_cycles[run.limit_cycles["controller"] == controller] if len(run.limit_cycles) else None
        statuses = run.status[run.status["controller"].str.partition("#")[0] == controller]
        rows.append(
            {
                "controller": controller,
                **shared,
                "best_in": int((best == controller).sum()),
                "conditions": int(own["condition"].nunique()),
                "failures": int(own["failed"].sum()),
                "failed_conditions": int((statuses["status"] == FAILED).sum()),
                "limit_cycles": int(still["limit_cycle"].sum()) if still is not None else 0,
                "standstills": len(still) if still is not None else 0,
                "training_seeds": int(own["training_seed"].nunique()),
            }
        )
    table = pd.DataFrame(rows).sort_values("equal_weight", kind="stable", ignore_index=True)
    table.insert(0, "rank", np.arange(1, len(table) + 1))
    return table


def profile_table(grid: Grid) -> pd.DataFrame:
    """Share of cases with an error of at most τ times that of the best controller in the case, or of the baseline.

    It includes only conditions under which every controller ran. Dolan & Moré (2002); intervals as Agarwal et al.
    (2021).
    """
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
                        **dict(zip(("share", "low", "high"), share, strict=True)),
                    }
                )
    return pd.DataFrame(rows)


def worst_table(cases: pd.DataFrame, baseline: str, count: int) -> pd.DataFrame:
    """The cases with the largest ratio of errors to the baseline; for the baseline, those with its largest errors."""
    where = ["condition", "family", "leakage_flow_lpm", "plant", "seed"]
    base = cases[cases["controller"] == baseline].groupby(where, sort=False)[ERROR].mean().rename("baseline_error_mm")
    joined = cases.join(base, on=where)
    joined["ratio"] = joined[ERROR] / joined["baseline_error_mm"]
    shown = [
        "controller",
        "training_seed",
        "rank",
        *where,
        ERROR,
        "baseline_error_mm",
        "ratio",
        "peak_error_mm",
        "failed",
    ]
    frames = []
    for name in cases["controller"].unique():
        own = joined[joined["controller"] == name]
        # A case counts once if several conditions do not change it.
        order = own.sort_values(ERROR if name == baseline else "ratio", ascending=False, kind="stable")
        order = order.drop_duplicates(["training_seed", "leakage_flow_lpm", "seed", ERROR]).head(count)
        frames.append(order.assign(rank=np.arange(1, len(order) + 1))[shown])
    return pd.concat(frames, ignore_index=True)
