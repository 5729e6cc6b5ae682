"""Scripts that measure the project, and what they have in common: command lines, and rows that a file keeps."""

import argparse
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import pandas as pd
from joblib import Parallel, delayed

from hydro_env.files import write_text

Rows = Iterable[Mapping[str, Any]]


def command_line(text: str | None, *positional: str, **options: Any) -> argparse.Namespace:
    """What the command line of a script says; the docstring of the script explains the options.

    ``positional``: names of paths that must be given; of several, with three dots. ``options``: name and default. A
    list takes one word or more, ``False`` makes a flag, a type has no default; of a tuple one is chosen, at first the
    first; of the keys of a mapping several, at first all.
    """
    parser = argparse.ArgumentParser(description=text, formatter_class=argparse.RawDescriptionHelpFormatter)
    for name in positional:
        several = "+" if name.endswith("...") else None
        parser.add_argument(name.removesuffix("..."), type=Path, nargs=several)
    for name, default in options.items():
        flag = f"--{name}"
        if isinstance(default, bool):
            parser.add_argument(flag, action="store_true")
        elif default == []:
            parser.add_argument(flag, nargs="+", action="extend", default=[])
        elif isinstance(default, list):
            parser.add_argument(flag, nargs="+", type=type(default[0]), default=default)
        elif isinstance(default, Mapping):
            parser.add_argument(flag, nargs="+", choices=default, default=list(default))
        elif isinstance(default, tuple):
            parser.add_argument(flag, choices=default, default=default[0])
        elif isinstance(default, type):
            parser.add_argument(flag, type=default)
        else:
            parser.add_argument(flag, type=type(default), default=default)
    return parser.parse_args()


def kept_rows(
    file: Path | None, key: str, wanted: Sequence[int], rows_of: Callable[[int], Rows], jobs: int = 1
) -> pd.DataFrame:
    """The rows of all wanted numbers (column ``key``): what the CSV file lacks is computed, and added to it at once.

    An interrupted script then goes on where it was; without a file nothing is kept.
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
