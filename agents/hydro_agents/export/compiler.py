"""The C compiler of this machine."""

from __future__ import annotations

import shutil
import subprocess
from collections.abc import Sequence
from pathlib import Path

from hydro_env import HydroError


def c_compiler() -> str | None:
    """Its command, or ``None`` if there is none."""
    return next((name for name in ("cc", "gcc", "clang") if shutil.which(name)), None)


def compile_c(folder: Path, arguments: Sequence[str]) -> None:
    """Run the C compiler in a folder.

    Raises:
        HydroError: there is no compiler, or it failed; the message is its first line.
    """
    compiler = c_compiler()
    if compiler is None:
        raise HydroError("no C compiler found; install gcc or clang (the command is cc, gcc or clang)")
    result = subprocess.run(
        [compiler, "-std=c99", "-O2", *arguments, "-lm"], cwd=folder, capture_output=True, text=True, check=False
    )
    if result.returncode != 0:
        raise HydroError(f"{compiler}: {(result.stderr.splitlines() or ['failed'])[0]}")
