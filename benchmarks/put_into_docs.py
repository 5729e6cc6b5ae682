"""Keep the results that the pages show in ``docs/tables``, and put them into the pages.

Run: python benchmarks/put_into_docs.py [results]

The folder holds what commands wrote: ``study``, ``seeds``, ``robustness``, ``leakage``, ``reproduce``,
``alone``, ``baselines``. What is absent keeps what it has. A page holds ``<!-- table: NAME -->`` and ``<!-- end -->``;
what stands between is made from ``docs/tables/NAME.csv``, whose first line says which version, commit, date and command
it is of; ``tests/site/test_site.py`` checks both.
"""

from __future__ import annotations

import re
import sys
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import NamedTuple

import pandas as pd

from benchmarks.figures import ORIGIN
from hydro_agents.running.machine import Origin
from hydro_env.files import read_json, read_yaml

DOCS = Path(__file__).resolve().parents[1] / "docs"
TABLES = DOCS / "tables"
PROTOCOL = DOCS.parent / "configs" / "protocols" / "leakage.yaml"
PAGES = ("results.md", "reproduction.md", "learning.md", "leakage.md")
MARKED = re.compile(r"(<!-- table: (\w+) -->\n).*?(<!-- end -->)", flags=re.DOTALL)


class Source(NamedTuple):
    """A table of the pages."""

    file: str  # that a command wrote
    columns: Mapping[str, str] = {}  # heading and format (empty: text of this name); none: only a chart shows it
    change: Callable[[pd.DataFrame], pd.DataFrame] = pd.DataFrame.copy  # from what is kept to the rows of the page
    keep: Callable[[pd.DataFrame], pd.DataFrame] = pd.DataFrame.copy  # from the file to what is kept


def _interval(name: str, decimals: int = 3, low: str = "", high: str = "") -> str:
    """Format of a figure with its interval."""
    names = (name, low or f"{name}_low", high or f"{name}_high")
    value, first, last = (f"{{{each}:.{decimals}f}}" for each in names)
    return f"{value} ({first} to {last})"


def _written(row: pd.Series, form: str) -> str:
    """A cell: a figure without interval stands alone, and what is missing is a dash."""
    text = form.format_map(row)
    alone = text.partition(" (")[0] if "nan" in text else text
    return "–" if alone.startswith("nan") else alone.replace(" ± nan", "")


def _study(table: pd.DataFrame) -> pd.DataFrame:
    return table[(table["against"] == "PID") & (table["group"] == "all")]


def _errors(table: pd.DataFrame) -> pd.DataFrame:
    """One row per controller: mean errors in both frames; every leak has the same number of cases."""
    kept = table[table["metric"].isin(("mean_error_mm", "mean_error_sensor_mm"))]
    return kept.pivot_table("mean", "controller", "metric", sort=False).reset_index()


def _detectors(table: pd.DataFrame) -> pd.DataFrame:
    kept = table[(table["condition"] == "ordinary") & table["level"].isin((0.05, 0.1, 0.2, 0.3, 1.0))]
    return kept[["detector", "level", "at_1_percent", "at_1_percent_low", "at_1_percent_high", "windows"]]


def _by_level(table: pd.DataFrame) -> pd.DataFrame:
    """One row per detector: shares in % with their intervals as text."""
    names = ["at_1_percent", "at_1_percent_low", "at_1_percent_high"]
    shares = table.assign(level=table["level"].map("{:g} l/min".format), **(100.0 * table[names]))
    shares["text"] = shares.apply(_written, axis=1, form=_interval("at_1_percent", 1))
    wide = shares.pivot(index="detector", columns="level", values="text")[shares["level"].unique()]
    order = table["detector"].unique()
    return wide.loc[order].assign(windows=table.groupby("detector")["windows"].min()).reset_index()


def _conditions(table: pd.DataFrame) -> pd.DataFrame:
    kept = table[table["level"].isin((0.0, 0.1, 0.3, 1.0)) & ~table["condition"].str.startswith("rig_")]
    return kept[["detector", "condition", "level", "flagged", "cannot_tell"]]


def _by_condition(table: pd.DataFrame) -> pd.DataFrame:
    """One row per condition: shares in %, of healthy axes under ``NAME 0``; its name as the protocol writes it."""
    kinds = read_yaml(PROTOCOL)["conditions"]
    shares = table.assign(flagged=100.0 * table["flagged"], cannot_tell=100.0 * table["cannot_tell"])
    wide = shares.pivot(index="condition", columns=["detector", "level"], values=["flagged", "cannot_tell"])
    wide = wide.reindex([name for name in kinds if name in wide.index])
    wide.columns = [f"{detector} {figure} {level:g}".replace(".", ",") for figure, detector, level in wide.columns]
    return wide.assign(condition=[kinds[name]["label"] for name in wide.index])


def _seeds(table: pd.DataFrame) -> pd.DataFrame:
    """Of what was trained: mean errors, time; the head without the ranges of large leaks: "≥ 0.3 l/min"."""
    trained = table["of"].isin(table.loc[table["figure"] == "training, s", "of"])
    shown = table["group"].isin(("all", "equal_weight", "head")) | (table["figure"] == "training, s")
    large = table["figure"].str.contains("leaks of (?:0.3–|0.5–|1–|2–)", regex=True)
    return table[trained & shown & ~large].drop(columns=["group", "sd"])


SEED_DECIMALS = {"%": 2, "curve": 4, "s": 0}
"""Decimals of a figure over the seeds, by the last word of its name; all others have three."""


def _by_seed(table: pd.DataFrame) -> pd.DataFrame:
    """The figures as text; the time of a training has no interval: the machine did other work as well."""
    lines = []
    for _, row in table.iterrows():
        decimals = SEED_DECIMALS.get(row["figure"].split()[-1], 3)
        seeds = {name: f"{row[name]:.{decimals}f}" for name in table if name.startswith("seed ")}
        form = "{mean:.0f}" if row["figure"] == "training, s" else _interval("mean", decimals, "low", "high")
        lines.append({"of": row["of"], "figure": row["figure"], **seeds, "mean": _written(row, form)})
    return pd.DataFrame(lines)


TRAININGS = {
    "all": "mean",
    "equal_weight": "geo",
    "valve_travel_per_s": "travel",
    "reversals_per_s": "reversals",
    "failed": "failed",
    "training": "gradient steps",
}
"""Groups of figures of a study over seeds that a page shows, with their columns."""


def _trainings(table: pd.DataFrame) -> pd.DataFrame:
    """One row per controller: the first figure of each group, and the standard deviations over the seeds."""
    first = table[table["group"].isin(TRAININGS)].drop_duplicates(["of", "group"])
    wide = first.pivot(index="of", columns="group").reindex(first["of"].unique())
    seeds = sum(name.startswith("seed ") for name in table)
    rows = wide["mean"].rename(columns=TRAININGS)
    spread = wide["sd"].rename(columns=TRAININGS)[["mean", "geo"]].add_suffix(" sd")
    counts = rows["gradient steps"].notna() * seeds
    kept = pd.concat([counts.rename("seeds"), rows[list(TRAININGS.values())], spread], axis=1)
    return kept.rename_axis("controller").reset_index()


TRAINED = {
    "controller": "{controller}",
    "seeds": "{seeds:.0f}",
    "accuracy ÷ PID's": "{mean:.3f} ± {mean sd:.3f}",
    "kinds of reference weigh the same": "{geo:.3f} ± {geo sd:.3f}",
    "valve travel ÷ PID's": "{travel:.2f}",
    "reversals ÷ PID's": "{reversals:.2f}",
    "failures per training": "{failed:.1f}",
    "gradient steps": "{gradient steps:.0f}",
}


def _trained(table: pd.DataFrame) -> pd.DataFrame:
    return table.assign(seeds=table["seeds"].replace(0, float("nan")))


SOURCES = {
    "score": Source(
        "study/tables/levels.csv",
        {
            "controller": "{controller}",
            "accuracy, mm": "{mean_error_mm:.4f}",
            "repeatability, mm": "{mean_error_sensor_mm:.4f}",
        },
        keep=_errors,
    ),
    "study": Source(
        "study/tables/ratios.csv",
        {
            "controller": "{controller}",
            "accuracy ÷ PID's": _interval("ratio", 3, "low", "high"),
            "better than the PID in": "{better:.0f} % of cases",
            "repeatability ÷ PID's": _interval("ratio_sensor"),
        },
        lambda table: table.assign(better=100 * table["share_of_cases_better"]),
        _study,
    ),
    "seeds": Source(
        "seeds/tables/over_seeds.csv",
        {"trained": "{of}", "figure": "{figure}"}
        | dict.fromkeys(("seed 0", "seed 1", "seed 2", "seed 3"), "")
        | {"mean over the seeds": "{mean}"},
        _by_seed,
        _seeds,
    ),
    "learning_curves": Source("seeds/tables/learning_curves.csv"),
    "robustness": Source(
        "robustness/tables/ranking.csv",
        {
            "controller": "{controller}",
            "accuracy ÷ PID's": _interval("equal_weight"),
            "repeatability ÷ PID's": _interval("equal_weight_sensor"),
            "worst case": "{worst_ratio:.1f}",
            "valve travel": "{travel_ratio:.2f}",
            "reversals": "{reversals_ratio:.2f}",
            "energy": "{energy_ratio:.2f}",
            "limit cycles": "{limit_cycles:.0f} of {standstills:.0f}",
            "failures": "{failures:.0f}",
        },
    ),
    "detectors": Source(
        "leakage/tables/detection.csv",
        {"detector": "{detector}"}
        | dict.fromkeys(("0.05 l/min", "0.1 l/min", "0.2 l/min", "0.3 l/min", "1 l/min"), "")
        | {"windows": "{windows:.0f}"},
        _by_level,
        _detectors,
    ),
    "conditions": Source(
        "leakage/tables/detection.csv",
        {
            "condition": "{condition}",
            "head: false alarms": "{head flagged 0:.1f}",
            "0.1 l/min found": "{head flagged 0,1:.0f}",
            "0.3 l/min found": "{head flagged 0,3:.0f}",
            "1 l/min found": "{head flagged 1:.0f}",
            "cannot tell": "{head cannot_tell 0:.0f}",
            "estimator: false alarms": "{estimator flagged 0:.0f}",
            "of 0.3 l/min found": "{estimator flagged 0,3:.0f}",
            "it cannot tell": "{estimator cannot_tell 0:.0f}",
        },
        _by_condition,
        _conditions,
    ),
    "alone": Source("alone/tables/over_seeds.csv", TRAINED, _trained, _trainings),
    "baselines": Source("baselines/tables/over_seeds.csv", TRAINED, _trained, _trainings),
    "verdicts": Source(
        "reproduce/verdicts.csv",
        {
            "the paper concludes": "{conclusion}",
            "verdict": "**{verdict}**",
            "measured": "{measured}",
            "here": "{here}",
            "figure": "{figure}",
        },
    ),
}


def table_of(name: str) -> str:
    """A kept table in Markdown, and where it comes from."""
    source = SOURCES[name]
    rows = source.change(pd.read_csv(TABLES / f"{name}.csv", skiprows=1))
    header = list(source.columns)
    lines = [
        [_written(row, form) if form else row[heading] for heading, form in source.columns.items()]
        for _, row in rows.iterrows()
    ]
    table = "\n".join(f"| {' | '.join(line)} |" for line in (header, ["---"] * len(header), *lines))
    return f"{table}\n\n*{origin_of(name)}*"


def origin_of(name: str) -> str:
    """Version, commit, date and command of a kept table."""
    with open(TABLES / f"{name}.csv", encoding="utf-8") as text:
        return text.readline().removeprefix("# ").strip()


def _keep(name: str, table: pd.DataFrame, origin: Origin) -> None:
    """Keep a table that ``make figures`` computed."""
    first = f"# hydro_env {origin.version}, {origin.date}: `{origin.command}`\n"
    (TABLES / f"{name}.csv").write_text(first + table.to_csv(index=False, float_format="%.6g"), encoding="utf-8")


def tables() -> dict[str, str]:
    """The tables of the pages, from the kept results."""
    return {name: table_of(name) for name, source in SOURCES.items() if source.columns}


def filled(page: str, made: Mapping[str, str]) -> str:
    """The page with the tables in place."""
    return MARKED.sub(lambda mark: f"{mark[1]}\n{made[mark[2]]}\n\n{mark[3]}" if mark[2] in made else mark[0], page)


def main(results: str = "results") -> None:
    """Keep new results, fill the pages."""
    for name, source in SOURCES.items():
        file = Path(results) / source.file
        mark = Path(results) / Path(source.file).parts[0] / ORIGIN
        if new := mark.is_file() and file.is_file():
            _keep(name, source.keep(pd.read_csv(file)), Origin(**read_json(mark)))
        print(f"{name}: {file if new else 'as before'}")
    made = tables()
    for name in PAGES:
        page = (DOCS / name).read_text(encoding="utf-8")
        (DOCS / name).write_text(filled(page, made), encoding="utf-8")


if __name__ == "__main__":
    main(*sys.argv[1:])
