"""The leaderboard of the challenge as files: an entry is a YAML file and its predictions; the page follows from them.

    python benchmarks/leaderboard.py add NAME PREDICTIONS --data DATA --who "…" --track "…" --code "…"
    python benchmarks/leaderboard.py page

``add`` scores predictions on the test split of 600 recordings with public seeds (``hydro record --benchmark DATA``) and
writes ``challenge/leaderboard/NAME.yaml`` and ``.parquet``. ``page`` writes ``docs/leaderboard.md``.
``tests/benchmarks/test_leaderboard.py`` scores every entry again.
"""

from __future__ import annotations

import argparse
import hashlib
import io
import json
from collections.abc import Mapping
from datetime import date
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import yaml

from hydro_agents.running.text import markdown
from hydro_env import __version__
from hydro_env.files import write_text, write_whole
from hydro_rig.challenge.axes import VERSION
from hydro_rig.challenge.scores import OPTIONAL, REQUIRED, labels_of, score

FOLDER = Path(__file__).parents[1] / "challenge/leaderboard"
PAGE = Path(__file__).parents[1] / "docs/leaderboard.md"
LABELS = FOLDER / "test_labels.csv"
TRACKS = ("signals only", "knows the axis")
FIGURES = {
    "found_share": "leaks found",
    "found_known axes": "known axes",
    "found_new axes": "new axes",
    "found_tier 3": "tier 3",
    "missed": "missed",
    "interval_holds": "90 % interval holds",
}
"""Figures of an entry, and their headings; shares."""


def figures_of(name: str, predictions: pd.DataFrame, labels: pd.DataFrame) -> dict[str, float]:
    """The figures of an entry, to four digits."""
    row = score(name, predictions, labels).row
    return {figure: round(float(row[figure]), 4) for figure in FIGURES if figure in row}


def labels() -> pd.DataFrame:
    """The labels of the test split with public seeds."""
    return pd.read_csv(LABELS, keep_default_na=False, na_values={"onset": [""]})


def add(name: str, predictions: pd.DataFrame, data: Path, about: Mapping[str, str]) -> None:
    """Write the files of an entry."""
    kept = predictions[[column for column in (*REQUIRED, *OPTIONAL) if column in predictions]].copy()
    for column in kept.select_dtypes("float"):
        kept[column] = kept[column].astype(np.float32)
    buffer = io.BytesIO()
    kept.to_parquet(buffer, index=False, compression="zstd")
    write_whole(FOLDER / f"{name}.parquet", buffer.getvalue())
    truth = labels_of(data, "test")
    write_text(LABELS, truth.to_csv(index=False))
    entry = {
        **about,
        "when": date.today().isoformat(),
        "challenge": VERSION,
        "hydro_env": __version__,
        "predictions_sha256": hashlib.sha256(buffer.getvalue()).hexdigest(),
        "figures": figures_of(name, pd.read_parquet(FOLDER / f"{name}.parquet"), truth),
    }
    write_text(FOLDER / f"{name}.yaml", yaml.safe_dump(entry, sort_keys=False, allow_unicode=True))


def entries() -> dict[str, dict[str, Any]]:
    """All entries by name, the best first."""
    read = {path.stem: yaml.safe_load(path.read_text(encoding="utf-8")) for path in sorted(FOLDER.glob("*.yaml"))}
    return dict(sorted(read.items(), key=lambda item: -item[1]["figures"]["found_share"]))


def page() -> str:
    """The page of all entries."""
    parts = [
        "# Leaderboard of leaking axes\n",
        f"Version {VERSION}, the test split of 600 recordings, public seeds. [The challenge](benchmark.md) tells what",
        "the figures mean, CONTRIBUTING how to add an entry. `python benchmarks/leaderboard.py page` writes this page.",
    ]
    for track in TRACKS:
        rows = []
        for name, entry in entries().items():
            if entry["track"] == track:
                values = [entry["figures"].get(figure) for figure in FIGURES]
                cells = ["–" if value is None else f"{100.0 * value:.1f} %" for value in values]
                rows.append([name, *cells, entry["who"], str(entry["when"]), entry["code"]])
        header = ["detector", *FIGURES.values(), "who", "when", "code"]
        parts += [f"\n## Track: {track}\n", markdown(header, rows, left=(0, 7, 8, 9))]
    return "\n".join(parts) + "\n"


def main() -> None:
    """Add an entry, or write the page."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    commands = parser.add_subparsers(dest="command", required=True)
    new = commands.add_parser("add")
    new.add_argument("name")
    new.add_argument("predictions", type=Path)
    new.add_argument("--data", type=Path, required=True)
    new.add_argument("--track", choices=TRACKS, required=True)
    for option in ("who", "code"):
        new.add_argument(f"--{option}", required=True)
    commands.add_parser("page")
    given = parser.parse_args()
    if given.command == "add":
        about = {"who": given.who, "track": given.track, "code": given.code}
        add(given.name, pd.read_parquet(given.predictions), given.data, about)
        print(json.dumps(entries()[given.name]["figures"], indent=2))
    write_text(PAGE, page())


if __name__ == "__main__":
    main()
