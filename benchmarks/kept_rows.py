"""Results that a file keeps, so that an interrupted script goes on where it was."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import pandas as pd
from joblib import Parallel, delayed

from hydro_env.files import write_text

Rows = Iterable[Mapping[str, Any]]


def kept_rows(
    file: Path | None, key: str, wanted: Sequence[int], rows_of: Callable[[int], Rows], jobs: int = 1
) -> pd.DataFrame:
    """The rows of all wanted numbers: what the file lacks is computed, and added to it at once.

    Args:
        file: a CSV file, which makes an interrupted script go on where it was; ``None``: nothing is kept.
        key: the column with the number, of a rig or a seed.
        wanted: numbers.
        rows_of: computes the rows of one number.
        jobs: processes.
    """
    rows = pd.read_csv(file) if file is not None and file.exists() else pd.DataFrame({key: []})
    missing = [number for number in wanted if number not in set(rows[key])]
    began = time.perf_counter()
    found = Parallel(jobs, return_as="generator_unordered")(delayed(_listed)(rows_of, number) for number in missing)
    for done, new in enumerate(found, 1):
        rows = pd.concat([rows, pd.DataFrame(new)], ignore_index=True) if len(rows) else pd.DataFrame(new)
        if file is not None:
            write_text(file, rows.to_csv(index=False))
        print(f"{key} {new[0][key]}: {done} of {len(missing)}, {time.perf_counter() - began:.0f} s", flush=True)
    return rows[rows[key].isin(wanted)]


def _listed(rows_of: Callable[[int], Rows], number: int) -> list[Mapping[str, Any]]:
    return list(rows_of(number))
