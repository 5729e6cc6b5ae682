"""The tables of a protocol of controllers: summary, comparison, ranking, rest."""

from collections.abc import Iterator

import numpy as np
import pandas as pd

from hydro_agents.evaluation.comparison import ALL, Grid
from hydro_agents.evaluation.metrics import COMPARED, METRICS, RETURN
from hydro_agents.evaluation.runner import FAILED, Results, Rows, table
from hydro_agents.running.limit_cycles import counted
from hydro_agents.running.seeds import SEED_MARK
from hydro_agents.running.statistics import interval
from hydro_env.types import Mask

LEAK_GROUP = "leak"


def parts_of(results: Results) -> Iterator[tuple[str, str, Mask, Mask]]:
    """Group, value, plants and situations of each row; families are over the conditions of the group ``leak``, if any.

    See :meth:`~hydro_agents.evaluation.comparison.Grid.parts`.
    """
    grid, cases = results.grid, results.part("cases")
    leaks = cases.loc[cases["group"] == LEAK_GROUP, "condition"].unique()
    return grid.parts(np.isin(grid.condition, leaks) if len(leaks) else grid.all_situations)


@table("summary")
def summary(results: Results) -> Rows:
    """Every metric per controller, over all cases and in parts: mean with its interval."""
    grid = results.grid
    for controller in grid.controllers:
        for group, value, *part in parts_of(results):
            for metric, about in METRICS.items():
                chosen = grid.sample(controller, metric, *part)
                if chosen.plants:
                    yield {
                        "controller": controller,
                        "group": group,
                        "value": value,
                        "metric": metric,
                        "unit": about.unit,
                        **interval(chosen.mean, chosen.plants).named("mean"),
                        "cases": (~np.isnan(chosen.values)).sum(),
                        "training_seeds": len(chosen.values),
                    }


@table("comparison")
def comparison(results: Results) -> Rows:
    """Each controller against the first, over all cases and in parts; policies against what they correct, over all."""
    grid = results.grid
    baseline, *others = grid.controllers
    for controller in others:
        for group, value, *part in parts_of(results):
            row = grid.compare(controller, baseline, *part)
            if row["cases"]:
                yield {"controller": controller, "against": baseline, "group": group, "value": value, **row}
    for controller, base in results.participants.corrects.items():
        if controller in others and base in others:
            row = grid.compare(controller, base, grid.all_plants, grid.all_situations)
            yield {"controller": controller, "against": base, "group": ALL, "value": "", **row}


@table("seeds")
def seeds(results: Results) -> Rows:
    """Each training seed of each controller against the first one, over all cases; empty if none has several."""
    cases = results.part("cases")
    baseline, *others = results.grid.controllers
    first = cases[cases["controller"] == baseline]
    if cases.groupby("controller")["training_seed"].nunique().max() < 2:
        return
    for controller in others:
        for seed, own in cases[cases["controller"] == controller].groupby("training_seed", sort=False):
            grid = Grid(pd.concat([first, own], ignore_index=True))
            row = grid.compare(controller, baseline, grid.all_plants, grid.all_situations)
            known = {"controller": controller, "against": baseline, "training_seed": seed}
            yield known | row | {"failures": int(own["failed"].sum())}


@table("ranking")
def ranking(results: Results) -> pd.DataFrame:
    """Controllers in the order of their equally weighted ratio, with their costs."""
    grid, compared = results.grid, results.table("comparison")
    cases, cycles, baseline = results.part("cases"), results.part("limit_cycles"), grid.controllers[0]
    if cycles.empty:
        cycles = pd.DataFrame({"controller": [], "limit_cycle": []})
    statuses = results.status[results.status["condition"].isin(list(results.protocol.conditions))]
    equal = [f"equal_weight{frame}{end}" for frame in ("", "_sensor") for end in ("", "_low", "_high")]
    copied = {name: name for name in (*equal, "worst_ratio", *COMPARED)} | {"mean_ratio": "ratio"}
    figures = {baseline: dict.fromkeys(copied.values(), 1.0)}
    if len(compared):
        overall = compared[(compared["group"] == ALL) & (compared["against"] == baseline)]
        figures |= overall.set_index("controller").to_dict("index")
    rows = []
    for controller in grid.controllers:
        own = cases[cases["controller"] == controller]
        still = cycles[cycles["controller"] == controller]
        mine = statuses[statuses["controller"].str.partition(SEED_MARK)[0] == controller]
        rows.append(
            {
                "controller": controller,
                **{name: figures.get(controller, {}).get(source, np.nan) for name, source in copied.items()},
                "conditions": own["condition"].nunique(),
                RETURN: own[RETURN].mean(),
                "failures": int(own["failed"].sum()),
                "failed_conditions": (mine["status"] == FAILED).sum(),
                "limit_cycles": int(still["limit_cycle"].sum()),
                "standstills": len(still),
                "training_seeds": own["training_seed"].nunique(),
            }
        )
    ranked = pd.DataFrame(rows).sort_values("equal_weight", kind="stable", ignore_index=True)
    ranked.insert(0, "rank", np.arange(1, len(ranked) + 1))
    return ranked


@table("limit_cycle_summary")
def limit_cycle_summary(results: Results) -> Rows:
    """Number and largest amplitude of the limit cycles at rest, per controller."""
    cycles = results.part("limit_cycles")
    if len(cycles):
        for name, own in cycles.groupby("controller", sort=False):
            yield {"controller": name, **counted(own)}
