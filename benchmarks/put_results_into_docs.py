"""Keep the results that the pages show in ``docs/tables``, and put them into the pages.

Run: python benchmarks/put_results_into_docs.py [results]

The folder holds what commands wrote: ``study``, ``seeds``, ``robustness``, ``leakage``, ``reproduce``, ``alone``,
``baselines``. A part that is absent keeps what it has. A page holds ``<!-- table: NAME -->`` and ``<!-- end -->``; what
stands between is made from ``docs/tables/NAME.csv``, and ``tests/site/test_site.py`` checks that it still is.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import pandas as pd

from benchmarks.put_into_docs import filled

DOCS = Path(__file__).resolve().parents[1] / "docs"
TABLES = DOCS / "tables"
PAGES = ("results.md", "reproduction.md", "learning.md")


def _study(table: pd.DataFrame) -> pd.DataFrame:
    return table[(table["against"] == "PID") & (table["group"] == "all")]


def _detectors(table: pd.DataFrame) -> pd.DataFrame:
    kept = table[(table["condition"] == "ordinary") & table["level"].isin((0.05, 0.1, 0.2, 0.3, 1.0))]
    return kept[["detector", "level", "at_1_percent", "at_1_percent_low", "at_1_percent_high", "windows"]]


def _seeds(table: pd.DataFrame) -> pd.DataFrame:
    """All but the ranges of large leaks, which "≥ 0.3 l/min" holds."""
    return table[~table["figure"].str.contains("leaks of (?:0.3–|0.5–|1–|2–)", regex=True)]


def _with_interval(row: pd.Series, value: str, low: str, high: str, factor: float = 1.0, decimals: int = 3) -> str:
    """A figure with its interval, if there is one; – for none."""
    numbers = ["–" if pd.isna(row[name]) else f"{factor * row[name]:.{decimals}f}" for name in (value, low, high)]
    return numbers[0] if "–" in numbers else f"{numbers[0]} ({numbers[1]} to {numbers[2]})"


def _score_rows(table: pd.DataFrame) -> list[dict[str, str]]:
    return [
        {
            "controller": row["controller"],
            "score": _with_interval(row, "score", "low", "high", decimals=0),
            "accuracy, mm": f"{row['mean_error_mm']:.4f}",
            "repeatability, mm": f"{row['mean_error_sensor_mm']:.4f}",
        }
        for _, row in table.iterrows()
    ]


def _study_rows(table: pd.DataFrame) -> list[dict[str, str]]:
    return [
        {
            "controller": row["controller"],
            "accuracy ÷ PID's": _with_interval(row, "ratio", "low", "high"),
            "better than the PID in": f"{100 * row['share_of_cases_better']:.0f} % of cases",
            "repeatability ÷ PID's": _with_interval(row, "ratio_sensor", "ratio_sensor_low", "ratio_sensor_high"),
        }
        for _, row in table.iterrows()
    ]


SEED_DECIMALS = {"score": 1, "%": 2, "curve": 4, "s": 0}
"""Decimals of a figure over the seeds, by the last word of its name; all others have three."""


def _seed_rows(table: pd.DataFrame) -> list[dict[str, str]]:
    rows = []
    for _, row in table.iterrows():
        decimals = SEED_DECIMALS.get(row["figure"].split()[-1], 3)
        seeds = {name: f"{row[name]:.{decimals}f}" for name in table if name.startswith("seed ")}
        whole = _with_interval(row, "mean", "low", "high", decimals=decimals)
        mean = f"{row['mean']:.0f}" if row["figure"] == "training, s" else whole  # the machine did other work as well
        rows.append({"trained": row["of"], "figure": row["figure"]} | seeds | {"mean over the seeds": mean})
    return rows


def _robustness_rows(table: pd.DataFrame) -> list[dict[str, str]]:
    return [
        {
            "controller": row["controller"],
            "score": _with_interval(row, "score", "score_low", "score_high", decimals=0),
            "accuracy ÷ PID's": _with_interval(row, "equal_weight", "equal_weight_low", "equal_weight_high"),
            "repeatability ÷ PID's": _with_interval(
                row, "equal_weight_sensor", "equal_weight_sensor_low", "equal_weight_sensor_high"
            ),
            "worst case": f"{row['worst_ratio']:.1f}",
            "valve travel": f"{row['travel_ratio']:.2f}",
            "reversals": f"{row['reversals_ratio']:.2f}",
            "energy": f"{row['energy_ratio']:.2f}",
            "limit cycles": f"{row['limit_cycles']:.0f} of {row['standstills']:.0f}",
            "failures": f"{row['failures']:.0f}",
        }
        for _, row in table.iterrows()
    ]


def _detector_rows(table: pd.DataFrame) -> list[dict[str, str]]:
    names = ("at_1_percent", "at_1_percent_low", "at_1_percent_high")
    rows = []
    for detector, part in table.groupby("detector", sort=False):
        shares = {f"{row['level']:g} l/min": _with_interval(row, *names, 100.0, 1) for _, row in part.iterrows()}
        rows.append({"detector": str(detector), **shares, "windows": f"{part['windows'].min():.0f}"})
    return rows


def _verdict_rows(table: pd.DataFrame) -> list[dict[str, str]]:
    return [
        {
            "the paper concludes": row["conclusion"],
            "verdict": f"**{row['verdict']}**",
            "here": row["finding"],
            "figure": row["figure"],
        }
        for _, row in table.iterrows()
    ]


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


def _training_rows(table: pd.DataFrame) -> list[dict[str, str]]:
    def with_spread(row: pd.Series, name: str) -> str:
        spread = row[f"{name} sd"]
        return f"{row[name]:.3f}" + ("" if pd.isna(spread) else f" ± {spread:.3f}")

    return [
        {
            "controller": row["controller"],
            "seeds": f"{row['seeds']:.0f}" if row["seeds"] else "–",
            "accuracy ÷ PID's": with_spread(row, "mean"),
            "kinds of reference weigh the same": with_spread(row, "geo"),
            "valve travel ÷ PID's": f"{row['travel']:.2f}",
            "reversals ÷ PID's": f"{row['reversals']:.2f}",
            "failures per training": f"{row['failed']:.1f}",
            "gradient steps": "–" if pd.isna(row["gradient steps"]) else f"{row['gradient steps']:.0f}",
        }
        for _, row in table.iterrows()
    ]


class Source(NamedTuple):
    """A table of the pages: the file that a command wrote, what of it is kept, and how it is shown."""

    file: str
    keep: Callable[[pd.DataFrame], pd.DataFrame]
    rows: Callable[[pd.DataFrame], list[dict[str, str]]] | None = None  # None: only a chart shows it


SOURCES = {
    "score": Source("study/tables/score.csv", pd.DataFrame.copy, _score_rows),
    "study": Source("study/tables/ratios.csv", _study, _study_rows),
    "seeds": Source("seeds/tables/over_seeds.csv", _seeds, _seed_rows),
    "learning_curves": Source("seeds/tables/learning_curves.csv", pd.DataFrame.copy),
    "robustness": Source("robustness/tables/ranking.csv", pd.DataFrame.copy, _robustness_rows),
    "detectors": Source("leakage/tables/detection.csv", _detectors, _detector_rows),
    "alone": Source("alone/tables/over_seeds.csv", _trainings, _training_rows),
    "baselines": Source("baselines/tables/over_seeds.csv", _trainings, _training_rows),
    "verdicts": Source("reproduce/verdicts.csv", pd.DataFrame.copy, _verdict_rows),
}


def markdown(rows: list[dict[str, str]]) -> str:
    """Rows as a table in Markdown; all have the same columns."""
    header = list(rows[0])
    lines = [header, ["---"] * len(header), *([row.get(name, "–") for name in header] for row in rows)]
    return "\n".join(f"| {' | '.join(str(cell) for cell in line)} |" for line in lines)


def tables() -> dict[str, str]:
    """The tables of the pages, from the kept results."""
    return {
        name: markdown(source.rows(pd.read_csv(TABLES / f"{name}.csv")))
        for name, source in SOURCES.items()
        if source.rows is not None
    }


def main(results: str = "results") -> int:
    """Keep new results, fill the pages."""
    TABLES.mkdir(exist_ok=True)
    for name, source in SOURCES.items():
        file = Path(results) / source.file
        if file.is_file():
            source.keep(pd.read_csv(file)).to_csv(TABLES / f"{name}.csv", index=False, float_format="%.6g")
        print(f"{name}: {file if file.is_file() else 'as before'}")
    made = tables()
    for page in PAGES:
        path = DOCS / page
        path.write_text(filled(path.read_text(encoding="utf-8"), made), encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))
