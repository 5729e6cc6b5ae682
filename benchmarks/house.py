"""Measures the structure of the code: packages, arrows between them, sizes of files, modules with a single importer.

    python benchmarks/house.py [--run]

``--run`` also counts the own modules that a small protocol loads (a minute). An arrow is a pair of packages of
which one imports the other. A module that only one other module imports could join it.
"""

from __future__ import annotations

import ast
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
PLACES = {"hydro_env": ROOT / "hydro_env", "hydro_agents": ROOT / "agents" / "hydro_agents"}


def modules() -> dict[str, Path]:
    """Every module of the two packages, by its name; ``__init__`` files carry the name of their folder."""
    found = {}
    for package, folder in PLACES.items():
        for file in sorted(folder.rglob("*.py")):
            parts = [package, *file.relative_to(folder).with_suffix("").parts]
            found[".".join(part for part in parts if part != "__init__")] = file
    return found


def imported(file: Path, known: dict[str, Path]) -> Iterator[str]:
    """Names of the own modules that a file imports, also within functions."""
    for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names if alias.name in known)
        elif isinstance(node, ast.ImportFrom) and node.module:
            inside = [f"{node.module}.{alias.name}" for alias in node.names]
            submodules = [name for name in inside if name in known]
            yield from submodules
            if len(submodules) < len(inside) and node.module in known:
                yield node.module


def room_of(name: str) -> str:
    """The package of a module: ``hydro_env``, or a folder of ``hydro_agents``."""
    parts = name.split(".")
    return parts[1] if parts[0] == "hydro_agents" and len(parts) > 1 else parts[0]


def loaded_by(*words: str) -> int:
    """Number of own modules in memory after a command that succeeds."""
    code = (
        "import sys; from hydro_agents.commands.launcher import main\n"
        "try:\n    main()\nexcept SystemExit as end:\n    assert not end.code\n"
        "print(sum(name.split('.')[0] in ('hydro_env', 'hydro_agents') for name in sys.modules), file=sys.stderr)"
    )
    done = subprocess.run([sys.executable, "-c", code, *words], capture_output=True, text=True, check=True)
    return int(done.stderr.split()[-1])


def main() -> None:
    """Print the figures."""
    known = modules()
    arrows: set[tuple[str, str]] = set()
    importers: dict[str, set[str]] = {name: set() for name in known}
    for name, file in known.items():
        for target in set(imported(file, known)) - {name}:
            importers[target].add(name)
            if room_of(name) != room_of(target):
                arrows.add((room_of(name), room_of(target)))
    lines = {name: len(file.read_text(encoding="utf-8").splitlines()) for name, file in known.items()}
    own = [name for name in known if name.startswith("hydro_agents.")]
    files = [name for name in own if known[name].name != "__init__.py"]
    rooms = sorted({room_of(name) for name in own} - {"pretrained"})
    for room in rooms:
        inside = [name for name in files if room_of(name) == room]
        print(f"{room:12} {sum(lines[name] for name in inside):6} lines {len(inside):4} files")
    print(f"packages of hydro_agents: {len(rooms)}; arrows between packages: {len(arrows)}")
    in_agents = sum(lines[name] for name in own)
    print(f"lines of hydro_agents: {in_agents}; of hydro_env: {sum(lines.values()) - in_agents}")
    print(f"lines per file: {sum(lines[name] for name in files) / len(files):.0f} (mean of {len(files)})")
    print(f"modules with exactly one importer: {sum(len(importers[name]) == 1 for name in files)}")
    tests = sum(len(file.read_text(encoding="utf-8").splitlines()) for file in (ROOT / "tests").rglob("*.py"))
    print(f"lines of tests: {tests}")
    if "--run" in sys.argv:
        with tempfile.TemporaryDirectory() as folder:
            count = loaded_by("evaluate", "--protocol", "quick", "--output", folder)
        print(f"own modules that `hydro evaluate --protocol quick` loads: {count}")


if __name__ == "__main__":
    main()
