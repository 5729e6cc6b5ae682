"""Scripts that measure the project, and what their command lines have in common."""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from pathlib import Path
from typing import Any


def command_line(text: str | None, *positional: str, **options: Any) -> argparse.Namespace:
    """What the command line of a script says.

    Args:
        text: the docstring of the script, which explains the options.
        positional: names of paths that must be given; of several, with three dots.
        options: name and default. A list takes one word or more, ``False`` makes a flag, a type has no default; of a
            tuple one is chosen, at first the first; of the keys of a mapping several, at first all.
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
