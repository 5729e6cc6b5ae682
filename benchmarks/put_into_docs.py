"""Keep measured tables in ``docs/tables``, and put the short ones of the pages in place.

Run: python benchmarks/put_into_docs.py [results]

The folder holds what ``make figures`` wrote: ``study``, ``robustness``, ``speed`` and so on. What is absent keeps
what it has. The first line of ``docs/tables/NAME.csv`` tells version, commit, date and command. A page holds
``<!-- table: NAME -->`` and ``<!-- end -->``; what stands between follows from that file.
"""

import re
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import pandas as pd

from benchmarks.figures import ORIGIN
from hydro_agents.running.machine import Origin
from hydro_env.files import read_json, read_yaml

DOCS = Path(__file__).resolve().parents[1] / "docs"
TABLES = DOCS / "tables"
PROTOCOL = DOCS.parent / "configs" / "protocols" / "leakage.yaml"
PAGES = ("results.md", "leakage.md", "real_machines.md", "performance.md", "model.md")
MARKED = re.compile(r"(<!-- table: (\w+) -->\n).*?(<!-- end -->)", flags=re.DOTALL)


class Source(NamedTuple):
    """A table of the pages, as put_into_docs.yaml explains it."""

    file: str
    columns: Mapping[str, str]
    kept: Sequence[str] = ()
    where: str = ""
    pivot: Sequence[str] = ()
    rows: str = ""
    names: Mapping[str, str] = {}


SOURCES = {name: Source(**fields) for name, fields in read_yaml(Path(__file__).with_suffix(".yaml")).items()}


def _written(row: pd.Series, form: str) -> str:
    """A cell: a figure without interval stands alone, and what is missing is a dash."""
    text = form.format_map(row)
    if text.startswith("nan"):
        return "–"
    if "nan" in text:
        text = text.partition(" (")[0]
    return text


def by_level(table: pd.DataFrame, names: Mapping[str, str]) -> pd.DataFrame:
    """One row per detector: shares in % with their intervals as text."""
    shares = table.assign(level=table["level"].map("{:g} l/min".format))
    form = "{at_1_percent:.1%} ({at_1_percent_low:.1%} to {at_1_percent_high:.1%})"
    shares["text"] = shares.apply(_written, axis=1, form=form).str.replace("%", "")
    wide = shares.pivot(index="detector", columns="level", values="text")
    return wide.loc[table["detector"].unique()].reset_index()


def by_condition(table: pd.DataFrame, names: Mapping[str, str]) -> pd.DataFrame:
    """One row per condition: shares in %, of healthy axes under ``NAME 0``; its name as the protocol writes it."""
    kinds = read_yaml(PROTOCOL)["conditions"]
    shares = table.assign(flagged=100.0 * table["flagged"], cannot_tell=100.0 * table["cannot_tell"])
    wide = shares.pivot(index="condition", columns=["detector", "level"], values=["flagged", "cannot_tell"])
    wide = wide.loc[[name for name in kinds if name in names]]
    wide.columns = [f"{detector} {figure} {level:g}".replace(".", ",") for figure, detector, level in wide.columns]
    return wide.assign(condition=[kinds[name]["label"] for name in wide.index])


def foreign(table: pd.DataFrame, names: Mapping[str, str]) -> pd.DataFrame:
    """One row per axis and controller; errors also relative to those of the first controller there."""
    first = table.groupby("plant", sort=False)["error_um"].transform("first")
    rows = table.assign(ratio=table["error_um"] / first)
    rows = rows.sort_values("plant", key=lambda plant: plant.map([*names].index))
    return rows.assign(plant=rows["plant"].map(names), controller=rows["controller"].map(names))


def speed(table: pd.DataFrame, names: Mapping[str, str]) -> pd.DataFrame:
    """The rows of the page, the median with three digits, and the ratio to the row beside it."""
    rows = table.set_index("row").loc[list(names)].assign(what=list(names.values()))
    rows["median"] = rows["median"].map("{:.3g}".format).map(lambda text: f"{float(text):,g}" if "e" in text else text)
    rows["beside"] = rows["ratio"].map("{:.2g} × ".format) + rows["beside"]
    return rows.fillna({"beside": ""})


ROWS = {made.__name__: made for made in (by_level, by_condition, foreign, speed)}


def kept_of(source: Source, table: pd.DataFrame) -> pd.DataFrame:
    """What docs/tables keeps of a table that a command wrote."""
    if source.where:
        table = table.query(source.where)
    if source.pivot:
        table = table.pivot_table(*source.pivot, sort=False).reset_index()
    return table[list(source.kept)] if source.kept else table


def table_of(name: str) -> str:
    """A kept table in Markdown, and the command that computes it."""
    source = SOURCES[name]
    kept = pd.read_csv(TABLES / f"{name}.csv", skiprows=1)
    lines = [list(source.columns), ["---"] * len(source.columns)]
    if source.rows:
        kept = ROWS[source.rows](kept, source.names)
    for _, row in kept.iterrows():
        lines.append([_written(row, form) if form else row[heading] for heading, form in source.columns.items()])
    table = "\n".join(f"| {' | '.join(line)} |" for line in lines)
    command = origin_of(name).split("`")[-2]
    return f"{table}\n\n`{command}` ([kept with its date](tables/{name}.csv))"


def origin_of(name: str) -> str:
    """Version, commit, date and command of a kept table."""
    with open(TABLES / f"{name}.csv", encoding="utf-8") as text:
        return text.readline().removeprefix("# ").strip()


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
            kept = kept_of(source, pd.read_csv(file)).to_csv(index=False, float_format="%.6g")
            (TABLES / f"{name}.csv").write_text(first + kept, encoding="utf-8")
        print(f"{name}: {file if new else 'as before'}")
    made = {name: table_of(name) for name in SOURCES}
    for page in PAGES:
        path = DOCS / page
        path.write_text(filled(path.read_text(encoding="utf-8"), made), encoding="utf-8")


if __name__ == "__main__":
    main(*sys.argv[1:])
