"""Keep measured tables in ``docs/tables``, and put the short ones of the pages in place.

Run: python benchmarks/put_into_docs.py [results]

The folder holds what ``make figures`` wrote: ``study``, ``robustness``, ``speed`` and so on. What is absent keeps
what it has. The first line of ``docs/tables/NAME.csv`` tells version, commit, date and command. A page holds
``<!-- table: NAME -->`` and ``<!-- end -->``; what stands between follows from that file.
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
PAGES = ("results.md", "leakage.md", "performance.md", "model.md")
MARKED = re.compile(r"(<!-- table: (\w+) -->\n).*?(<!-- end -->)", flags=re.DOTALL)


class Source(NamedTuple):
    """A table of the pages."""

    file: str  # that a command wrote
    columns: Mapping[str, str] = {}  # heading and format (empty: text of this name); none: only a chart shows it
    rows: Callable[[pd.DataFrame], pd.DataFrame] = pd.DataFrame.copy  # from what is kept to the rows of the page
    keep: Callable[[pd.DataFrame], pd.DataFrame] = pd.DataFrame.copy  # from the file to what is kept


def _interval(name: str) -> str:
    """Format of a figure with its interval."""
    return f"{{{name}:.3f}} ({{{name}_low:.3f}} to {{{name}_high:.3f}})"


def _written(row: pd.Series, form: str) -> str:
    """A cell: a figure without interval stands alone, and what is missing is a dash."""
    text = form.format_map(row)
    if text.startswith("nan"):
        return "–"
    if "nan" in text:
        text = text.partition(" (")[0]
    return text


def _errors(table: pd.DataFrame) -> pd.DataFrame:
    """One row per controller: mean errors in both frames."""
    kept = table[(table["group"] == "all") & table["metric"].isin(("mean_error_mm", "mean_error_sensor_mm"))]
    return kept.pivot_table("mean", "controller", "metric", sort=False).reset_index()


def _against_the_first(*names: str) -> Callable[[pd.DataFrame], pd.DataFrame]:
    """Columns of the rows over all cases against the first controller."""

    def kept(table: pd.DataFrame) -> pd.DataFrame:
        first = table["against"].iloc[0]
        return table.loc[(table["against"] == first) & (table["group"] == "all"), list(names)]

    return kept


def _detectors(table: pd.DataFrame) -> pd.DataFrame:
    kept = table[(table["condition"] == "ordinary") & table["level"].isin((0.05, 0.1, 0.2, 0.3, 1.0))]
    return kept[["detector", "level", "at_1_percent", "at_1_percent_low", "at_1_percent_high", "windows"]]


def _by_level(table: pd.DataFrame) -> pd.DataFrame:
    """One row per detector: shares in % with their intervals as text."""
    shares = table.assign(level=table["level"].map("{:g} l/min".format))
    form = "{at_1_percent:.1%} ({at_1_percent_low:.1%} to {at_1_percent_high:.1%})"
    shares["text"] = shares.apply(_written, axis=1, form=form).str.replace("%", "")
    wide = shares.pivot(index="detector", columns="level", values="text")
    return wide.loc[table["detector"].unique()].reset_index()


def _conditions(table: pd.DataFrame) -> pd.DataFrame:
    kept = table[table["level"].isin((0.0, 0.1, 0.3, 1.0)) & ~table["condition"].str.startswith("rig_")]
    return kept[["detector", "condition", "level", "flagged", "cannot_tell"]]


SHOWN_CONDITIONS = (
    "ordinary", "standing", "standing_null_minus", "slow", "by_hand", "orifice", "onset", "lqg", "null_shift_minus",
    "underlap", "hysteresis", "external_large", "pressure_a_offset", "pressure_freeze", "load", "lugre",
)  # fmt: skip


def _by_condition(table: pd.DataFrame) -> pd.DataFrame:
    """One row per condition: shares in %, of healthy axes under ``NAME 0``; its name as the protocol writes it."""
    kinds = read_yaml(PROTOCOL)["conditions"]
    shares = table.assign(flagged=100.0 * table["flagged"], cannot_tell=100.0 * table["cannot_tell"])
    wide = shares.pivot(index="condition", columns=["detector", "level"], values=["flagged", "cannot_tell"])
    wide = wide.loc[[name for name in kinds if name in SHOWN_CONDITIONS]]
    wide.columns = [f"{detector} {figure} {level:g}".replace(".", ",") for figure, detector, level in wide.columns]
    return wide.assign(condition=[kinds[name]["label"] for name in wide.index])


SPEED = {
    "one axis": "one axis through `gym.make`",
    "axes, N = 64": "64 axes, `gym.make_vec`",
    "axes, N = 1,024": "1024 axes",
    "axes, N = 16,384": "16 384 axes",
    "AsyncVectorEnv of 16 single axes": "16 axes as processes of Gymnasium",
    "plants: 4,096, 2 threads": "the integrator alone, two threads",
    "PPO of stable-baselines3": "training of PPO on flow linearisation, end to end",
    "first step, compiled before": "import, make, reset and first step",
    "first step, empty cache": "the same, everything compiled anew",
    "policy: median": "one call of the policy in Python",
}
"""Rows of the measurement that the page shows, and what it calls them."""


def _speed(table: pd.DataFrame) -> pd.DataFrame:
    """The rows of the page, the median with three digits, and the ratio to the row beside it."""
    rows = table.set_index("row").loc[list(SPEED)].assign(what=list(SPEED.values()))
    rows["median"] = rows["median"].map("{:.3g}".format).map(lambda text: f"{float(text):,g}" if "e" in text else text)
    rows["beside"] = rows["ratio"].map("{:.2g} × ".format) + rows["beside"]
    return rows.fillna({"beside": ""})


SOURCES = {
    "errors": Source(
        "study/tables/summary.csv",
        {
            "controller": "{controller}",
            "accuracy, mm": "{mean_error_mm:.3f}",
            "repeatability, mm": "{mean_error_sensor_mm:.3f}",
        },
        keep=_errors,
    ),
    "study": Source(
        "study/tables/comparison.csv",
        {
            "controller": "{controller}",
            "accuracy ÷ PID's": _interval("ratio"),
            "repeatability ÷ PID's": _interval("ratio_sensor"),
            "better than the PID, share of cases": "{share_better:.2f}",
        },
        keep=_against_the_first(
            *("controller", "ratio", "ratio_low", "ratio_high", "share_better"),
            *("ratio_sensor", "ratio_sensor_low", "ratio_sensor_high"),
        ),
    ),
    "seeds": Source(
        "seeds/tables/seeds.csv",
        {
            "controller": "{controller}",
            "÷": "{against}",
            "training seed": "{training_seed}",
            "accuracy": "{ratio:.3f}",
            "families weigh the same": "{equal_weight:.3f}",
        },
        keep=lambda table: table[["controller", "against", "training_seed", "ratio", "equal_weight"]],
    ),
    "robustness": Source(
        "robustness/tables/ranking.csv",
        {
            "controller": "{controller}",
            "accuracy ÷ PID's": _interval("equal_weight"),
            "repeatability ÷ PID's": _interval("equal_weight_sensor"),
            "worst case": "{worst_ratio:.1f}",
            "valve travel": "{travel_ratio:.2f}",
            "limit cycles": "{limit_cycles:.0f} of {standstills:.0f}",
        },
    ),
    "detectors": Source(
        "leakage/tables/detection.csv",
        {"detector": "{detector}"} | dict.fromkeys(("0.05 l/min", "0.1 l/min", "0.3 l/min", "1 l/min"), ""),
        _by_level,
        _detectors,
    ),
    "conditions": Source(
        "leakage/tables/detection.csv",
        {
            "condition": "{condition}",
            "head: false alarms": "{head flagged 0:.1f}",
            "0.3 l/min found": "{head flagged 0,3:.0f}",
            "the head cannot tell": "{head cannot_tell 0:.0f}",
            "estimator: false alarms": "{estimator flagged 0:.0f}",
            "of 0.3 l/min found": "{estimator flagged 0,3:.0f}",
            "it cannot tell": "{estimator cannot_tell 0:.0f}",
        },
        _by_condition,
        _conditions,
    ),
    "baselines": Source(
        "baselines/tables/comparison.csv",
        {
            "controller": "{controller}",
            "accuracy ÷ PID's": _interval("ratio"),
            "families weigh the same": _interval("equal_weight"),
            "valve travel ÷ PID's": "{travel_ratio:.2f}",
        },
        keep=_against_the_first(
            *("controller", "ratio", "ratio_low", "ratio_high", "travel_ratio"),
            *("equal_weight", "equal_weight_low", "equal_weight_high"),
        ),
    ),
    "challenge": Source(
        "challenge/tables/challenge.csv",
        {
            "detector": "{detector}",
            "knows the axis": "{knows the axis}",
            "leaks found (95 %)": "{found:.3f} ({found_low:.2f} to {found_high:.2f})",
            "known axes": "{known axes:.3f}",
            "new axes": "{new axes:.3f}",
        },
    ),
    "speed": Source(
        "speed/speed.csv",
        {"what": "{what}", "median": "{median} {unit}", "beside": "{beside}"},
        _speed,
        lambda table: table[["group", "row", "unit", "median", "beside", "ratio"]],
    ),
    "verdicts": Source(
        "reproduce/verdicts.csv",
        {"the paper concludes": "{conclusion}", "verdict": "**{verdict}**", "measured": "{measured}", "here": "{here}"},
    ),
}


def table_of(name: str) -> str:
    """A kept table in Markdown, and the command that computes it."""
    source = SOURCES[name]
    kept = pd.read_csv(TABLES / f"{name}.csv", skiprows=1)
    lines = [list(source.columns), ["---"] * len(source.columns)]
    for _, row in source.rows(kept).iterrows():
        lines.append([_written(row, form) if form else row[heading] for heading, form in source.columns.items()])
    table = "\n".join(f"| {' | '.join(line)} |" for line in lines)
    command = origin_of(name).split("`")[-2]
    return f"{table}\n\n`{command}` ([kept with its date](tables/{name}.csv))"


def origin_of(name: str) -> str:
    """Version, commit, date and command of a kept table."""
    with open(TABLES / f"{name}.csv", encoding="utf-8") as text:
        return text.readline().removeprefix("# ").strip()


def tables() -> dict[str, str]:
    """The tables of the pages, from the kept results."""
    return {name: table_of(name) for name, source in SOURCES.items() if source.columns}


def filled(page: str, made: Mapping[str, str]) -> str:
    """The page with the tables in place."""
    return MARKED.sub(lambda mark: f"{mark[1]}\n{made[mark[2]]}\n\n{mark[3]}", page)


def main(results: str = "results") -> None:
    """Keep new results, fill the pages."""
    for name, source in SOURCES.items():
        file = Path(results) / source.file
        mark = Path(results) / Path(source.file).parts[0] / ORIGIN
        if new := mark.is_file() and file.is_file():
            origin = Origin(**read_json(mark))
            first = f"# hydro_env {origin.version}, {origin.date}: `{origin.command}`\n"
            kept = source.keep(pd.read_csv(file)).to_csv(index=False, float_format="%.6g")
            (TABLES / f"{name}.csv").write_text(first + kept, encoding="utf-8")
        print(f"{name}: {file if new else 'as before'}")
    made = tables()
    for page in PAGES:
        path = DOCS / page
        path.write_text(filled(path.read_text(encoding="utf-8"), made), encoding="utf-8")


if __name__ == "__main__":
    main(*sys.argv[1:])
