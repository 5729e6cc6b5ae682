"""Tests with the lowest and with the highest versions of the dependencies that pyproject.toml allows.

Run: python benchmarks/versions.py [pytest arguments]      (``make versions``; a few minutes, needs a package index)

Makes the virtual environments .versions/lowest and .versions/highest, and runs a selection of tests in each. torch has
the version of constraints.txt in both: other versions of it cost gigabytes.
"""

from __future__ import annotations

import os
import re
import subprocess
import sys
import tomllib
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
TESTS = [
    f"tests/{name}.py"
    for name in ("hydro_env/test_env", "hydro_env/test_vector_env", "hydro_env/plant/test_known_answers")
] + ["tests/hydro_agents/test_pretrained.py"]
TOOLS = ("pytest", "hypothesis")


def requirements() -> list[str]:
    """Requirements of the package, of its extras that users install, and of the tools that run the tests."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    extras = project["optional-dependencies"]
    tools = [item for item in extras["dev"] if item.startswith(TOOLS)]
    every = [*project["dependencies"], *extras["render"], *extras["agents"], *tools]
    return [item for item in every if not item.startswith("torch")]


def lowest(requirement: str) -> str:
    """``name>=1.2,<2`` as ``name==1.2``."""
    return re.sub(r">=([\d.]+).*", r"==\1", requirement)


def tried(name: str, wanted: list[str], arguments: list[str]) -> int:
    """Make an environment with some versions, and run tests in it; returns their exit code."""
    folder = ROOT / ".versions" / name
    python = str(folder / "bin" / "python")
    subprocess.run(["make", f"VENV={folder}", f"PYTHON={sys.executable}", f"{folder}/.torch"], cwd=ROOT, check=True)
    (torch,) = re.findall(r"^torch==.*", (ROOT / "constraints.txt").read_text(encoding="utf-8"), re.MULTILINE)
    eager = ("--quiet", "--upgrade", "--upgrade-strategy", "eager")
    subprocess.run([python, "-m", "pip", "install", *eager, *wanted, torch], cwd=ROOT, check=True)
    subprocess.run([python, "-m", "pip", "freeze"], check=True)
    paths = os.pathsep.join([str(ROOT), str(ROOT / "agents")])
    variables = {**os.environ, "PYTHONPATH": paths, "NUMBA_CACHE_DIR": str(folder / "numba")}
    return subprocess.run([python, "-m", "pytest", "-q", *arguments], cwd=ROOT, env=variables, check=False).returncode


def main() -> int:
    """Run both; 1 if anything failed."""
    arguments, allowed = sys.argv[1:] or TESTS, requirements()
    wanted = {"lowest": [lowest(item) for item in allowed], "highest": allowed}
    codes = {name: tried(name, items, arguments) for name, items in wanted.items()}
    print(", ".join(f"{name}: {'failed' if code else 'passed'}" for name, code in codes.items()))
    return int(any(codes.values()))


if __name__ == "__main__":
    sys.exit(main())
