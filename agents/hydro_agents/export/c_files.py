"""Files in C: written from templates, compiled, and compared with Python by their test program."""

from __future__ import annotations

import csv
import io
import shutil
import subprocess
import tempfile
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jinja2 import Environment, StrictUndefined

from hydro_env import HydroError

TEMPLATES = Path(__file__).parent / "templates"


@dataclass(frozen=True)
class CCode:
    """A C file and its header, as text."""

    name: str
    header: str
    source: str

    @property
    def files(self) -> dict[str, str]:
        """Texts by file name."""
        return {f"{self.name}.c": self.source, f"{self.name}.h": self.header}


def c_code(name: str, values: Mapping[str, Any], template: str = "") -> CCode:
    """The templates ``NAME.h.j2`` and ``NAME.c.j2`` with values; ``template`` if it has another name than the code."""
    return CCode(name, *(render(f"{template or name}.{kind}.j2", values) for kind in ("h", "c")))


def render(template: str, values: Mapping[str, Any], folder: Path = TEMPLATES) -> str:
    """Text of a template of a folder; its filter ``c`` writes a number exactly, in C."""
    environment = Environment(undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True, autoescape=False)
    environment.filters["c"] = _number
    environment.filters["xml"] = lambda value: repr(min(float(value), 1e300))  # few tools can read an infinite number
    return environment.from_string((folder / template).read_text(encoding="utf-8")).render(values)


def _number(value: float) -> str:
    if np.isinf(value):
        return "INFINITY" if value > 0 else "-INFINITY"
    return repr(float(value))


def write_files(texts: Mapping[str, str], folder: Path) -> None:
    """Write texts to a folder, by file name."""
    for name, text in texts.items():
        (folder / name).write_text(text, encoding="utf-8")


def c_compiler() -> str | None:
    """The command of this machine's C compiler, or ``None`` without one."""
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


def compared(name: str, texts: Mapping[str, str]) -> str:
    """What the test program ``test_NAME.c`` prints, compiled and run on this machine.

    Args:
        name: of the code.
        texts: of ``NAME.c``, ``NAME.h``, ``test_NAME.c`` and ``vectors.csv``, by file name.

    Raises:
        HydroError: the code cannot be compiled, or gives other results than Python.
    """
    if c_compiler() is None:
        return "not compiled: this machine has no C compiler"
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place)
        write_files(texts, folder)
        compile_c(folder, ["-Wall", "-Wextra", "-Werror", "-o", "test", f"test_{name}.c", f"{name}.c"])
        result = subprocess.run([str(folder / "test")], cwd=folder, capture_output=True, text=True, check=False)
    said = " ".join((result.stdout + result.stderr).split())
    if result.returncode != 0:
        raise HydroError(f"the C code differs from the {name.replace('_', ' ')} in Python: {said}")
    return said


def csv_text(columns: Sequence[str], rows: Iterable[tuple[int, Sequence[float]]]) -> str:
    """Rows as CSV: a mark of the start, and numbers that read back exactly."""
    file = io.StringIO()
    writer = csv.writer(file, lineterminator="\n")
    writer.writerow(["start", *columns])
    for start, values in rows:
        writer.writerow([int(start), *(repr(float(value)) for value in values)])
    return file.getvalue()
