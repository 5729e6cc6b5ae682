"""How well `hydro identify` finds hidden rigs: 20 s under a PID, noise, biases and a leak; intervals, held-back part.

Run: python benchmarks/identification.py [--rigs 30] [--folder FOLDER] [--validation]

Each seed hides a rig of its own (:mod:`benchmarks.hidden_rigs`). The code behind `hydro record` writes the recording,
the code behind `hydro identify` reads it. Figures: test seeds. ``rows.csv`` in the folder has a row for each unknown of
each rig; a later call continues it.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import Any

import pandas as pd

from benchmarks import command_line
from benchmarks.hidden_rigs import hidden_rig, identified_task
from benchmarks.kept_rows import kept_rows
from hydro_agents.running.seeds import HIDDEN_RIGS, THRESHOLDS
from hydro_agents.running.text import markdown
from hydro_env import HydroError
from hydro_env.task.rig import read_rig
from hydro_rig.identification.identify import identify

VALIDATION_SKIP = 50_000  # seeds of validation before those of this benchmark
DURATION = 20.0  # s
FAR = 10.0  # standard deviations
KINDS = ("no spool sensor", "no pressures", "clipped")  # in the names of the rigs


def unknowns_of(seed: int, first: int, folder: Path) -> Iterator[dict[str, Any]]:
    """Identify a hidden rig; a row for each unknown, and one row alone if the recording is refused.

    ``away`` is in standard deviations from the middle of the interval.
    """
    hidden = hidden_rig(folder, seed, seed - first, DURATION)
    began, cost = time.monotonic(), time.process_time()
    row: dict[str, Any] = {"seed": seed, "rig": hidden.name, "wrong": bool(hidden.wrong), "refused": True}
    try:
        found = identify([hidden.recording], identified_task(hidden.rig), read_rig(hidden.rig))
    except HydroError as error:
        yield row | {"verdict": str(error)}
        return
    fit = found.fit
    row |= {"refused": not found.describes, "verdict": found.verdict(), "share": found.share}
    row |= {"seconds": time.monotonic() - began, "core_s": time.process_time() - cost}
    for one in fit.unknowns:
        value = hidden.true[one.name]
        away = abs(value - 0.5 * (one.low + one.high)) / max((one.high - one.low) / 3.92, 1e-300)
        judged = {"determined": fit.knows(one), "within": bool(one.low <= value <= one.high)}
        yield row | {"unknown": one.name, **judged, "away": float(away)}


def columns_of(rows: pd.DataFrame) -> list[str]:
    """A column of the table: rigs, refusals, determined unknowns, those within their interval, those far off, time."""
    done = rows[~rows["refused"]]
    known = done[done["determined"].astype(bool)]
    times = done.groupby("seed")["core_s"].first()
    cells = [str(rows["seed"].nunique()), str(rows.loc[rows["refused"], "seed"].nunique())]
    if known.empty:
        return [*cells, "–", "–", "–", "–"]
    within = f"{known['within'].mean():.1%} of {len(known)}"
    far = str(int((known["away"] > FAR).sum()))
    return [*cells, f"{len(known) / len(done):.1%}", within, far, f"{times.median():.0f}; {times.max():.0f}"]


def report(rows: pd.DataFrame) -> None:
    """Print the table by kind of rig, the table by unknown, and what else the page says."""
    right, wrong = rows[~rows["wrong"]], rows[rows["wrong"]]
    whole = ~right["rig"].str.contains("|".join(KINDS))
    kinds = {"all sensors": right[whole], **{kind: right[right["rig"].str.contains(kind)] for kind in KINDS}}
    columns = {name: columns_of(part) for name, part in (kinds | {"all": right}).items()}
    names = (
        "rigs",
        "refused",
        "determined",
        "within their 95 % interval",
        f"beyond {FAR:g} σ",
        "core: median; longest, s",
    )
    print(markdown(("", *columns), [(name, *cells) for name, *cells in zip(names, *columns.values(), strict=True)]))
    refused = wrong.loc[wrong["refused"], "seed"].nunique()
    print(f"\nwith a wrong fixed number {refused} of {wrong['seed'].nunique()} refused")
    done = right[~right["refused"]]
    if done.empty:
        return
    shares = done.groupby("seed")["share"].first()
    print(f"share of the position's variance: median {shares.median():.3%}, lowest {shares.min():.3%}")
    print()
    lines = []
    for name, own in done.groupby("unknown", sort=False):
        known = own["determined"].astype(bool)
        within = f"{own.loc[known, 'within'].mean():.0%}" if known.any() else "–"
        lines.append((str(name), f"{known.mean():.0%}", within))
    print(markdown(("unknown", "determined", "within"), lines))


def main() -> None:
    """Identify the hidden rigs, and print the tables."""
    given = command_line(__doc__, rigs=30, folder=Path("results/identification"), validation=False)
    seeds = THRESHOLDS.take(given.rigs, VALIDATION_SKIP) if given.validation else HIDDEN_RIGS.take(given.rigs)
    given.folder.mkdir(parents=True, exist_ok=True)
    rows_of = partial(unknowns_of, first=seeds[0], folder=given.folder)
    report(kept_rows(given.folder / "rows.csv", "seed", seeds, rows_of))


if __name__ == "__main__":
    main()
