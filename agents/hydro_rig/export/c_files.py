"""Exported files: C from templates, compiled and compared with Python by its test program."""

import shutil
import subprocess
import tempfile
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from jinja2 import Environment, StrictUndefined

from hydro_env import HydroError
from hydro_env.types import ByName

TEMPLATES = Path(__file__).parent / "templates"
WARNINGS = ("-Wall", "-Wextra", "-Werror")


def c_code(name: str, values: ByName, template: str = "") -> dict[str, str]:
    """The files ``NAME.c`` and ``NAME.h``, from the templates of this name, or of that of ``template``."""
    return {f"{name}.{kind}": render(f"{template or name}.{kind}.j2", values) for kind in ("c", "h")}


def render(template: str, values: ByName, folder: Path = TEMPLATES) -> str:
    """Text of a template of a folder; its filter ``c`` writes a number exactly, in C."""
    environment = Environment(undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True, autoescape=False)
    environment.filters["c"] = lambda value: c_number(float(value))
    environment.filters["finite"] = lambda value: repr(min(float(value), 1e300))  # few tools read an infinite one
    return environment.from_string((folder / template).read_text(encoding="utf-8")).render(values)


def c_number(value: Any) -> str:
    """An exact number in C: the shortest text that reads back as the same number."""
    if isinstance(value, np.bool_ | bool | np.integer | int):
        return str(int(value))
    if np.isnan(value):
        return "NAN"
    suffix = "f" if isinstance(value, np.float32) else ""
    text = "INFINITY" if np.isinf(value) else f"{abs(value)!s}{suffix}"
    return f"-{text}" if np.signbit(value) else text


def c_compiler() -> str | None:
    """The command of this machine's C compiler, or ``None`` without one."""
    return next((name for name in ("cc", "gcc", "clang") if shutil.which(name)), None)


def compiled(
    sources: Mapping[str, str], options: Sequence[str], compiler: Sequence[str] = (), folder: Path | None = None
) -> bytes:
    """What a C compiler, by default that of this machine, makes of sources: texts by the names of their files.

    They and the result, a file ``out``, are written to a ``folder``, by default a temporary one.

    Raises:
        HydroError: there is no compiler, or it failed; the message is its first line.
    """
    if folder is None:
        with tempfile.TemporaryDirectory() as place:
            return compiled(sources, options, compiler, Path(place))
    own = compiler or [c_compiler() or ""]
    if not own[0]:
        raise HydroError("no C compiler found; install gcc or clang (the command is cc, gcc or clang)")
    for name, text in sources.items():
        (folder / name).write_text(text, encoding="utf-8")
    units = [name for name in sources if name.endswith(".c")]
    command = [*own, "-std=c99", "-O2", *options, "-o", "out", *units, "-lm"]
    result = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
    if result.returncode != 0:
        raise HydroError(f"{'ziglang' if compiler else own[0]}: {(result.stderr.splitlines() or ['failed'])[0]}")
    return (folder / "out").read_bytes()


def compared(name: str, texts: Mapping[str, str]) -> str:
    """What the test program ``test_NAME.c`` prints, compiled with ``NAME.c`` and run on this machine.

    Raises:
        HydroError: the code cannot be compiled, or gives other results than Python.
    """
    if c_compiler() is None:
        return "not compiled: this machine has no C compiler"
    with tempfile.TemporaryDirectory() as folder:
        compiled(texts, WARNINGS, folder=Path(folder))
        result = subprocess.run([f"{folder}/out"], cwd=folder, capture_output=True, text=True, check=False)
    said = " ".join((result.stdout + result.stderr).split())
    if result.returncode != 0:
        raise HydroError(f"the C code differs from the {name.replace('_', ' ')} in Python: {said}")
    return said


def csv_text(columns: Sequence[str], rows: Iterable[Iterable[float]]) -> str:
    """Rows as CSV, the first column tells whether a row is a start; every number reads back exactly."""
    lines = [",".join(["start", *columns])]
    for row in rows:
        lines.append(",".join(str(int(one)) if isinstance(one, bool | int) else repr(float(one)) for one in row))
    return "\n".join(lines) + "\n"


def tested(
    name: str, template: str, code: Mapping[str, str], vectors: str, values: ByName
) -> tuple[dict[str, bytes], str]:
    """The files of a folder by name: code, its test program, vectors as CSV, and a page; and what the program says.

    Raises:
        HydroError: as :func:`compared`.
    """
    texts = {**code, f"test_{name}.c": render(f"test_{template}.c.j2", values), "vectors.csv": vectors}
    said = compared(name, texts)
    texts["README.md"] = render(f"{template}_readme.md.j2", {**values, "said": said})
    return {file: text.encode() for file, text in texts.items()}, said
