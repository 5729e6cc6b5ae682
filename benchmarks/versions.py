"""Tests with the lowest and with the highest versions of the dependencies that pyproject.toml allows.

Run: python benchmarks/versions.py [pytest arguments]      (``make versions``; a few minutes, needs a package index)

Makes the virtual environments .versions/lowest and .versions/highest, runs a selection of tests and ``hydro --help``
in each, and prints a table of versions and results. torch has the version of constraints.txt in both: other versions of
it cost gigabytes.
"""

from __future__ import annotations

import os
import re
import subprocess
import sys
import tomllib
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
TESTS = [f"tests/{name}.py" for name in ("test_env", "test_vector_env", "plant/test_known_answers", "test_pretrained")]
EXTRAS = ("render", "agents")
TOOLS = ("pytest", "hypothesis")
HYDRO = "from hydro_agents.commands.launcher import main; main()"


def requirements() -> list[str]:
    """Requirements of the package, of its extras that users install, and of the tools that run the tests."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    optional = project["optional-dependencies"]
    tools = [item for item in optional["dev"] if item.startswith(TOOLS)]
    return [*project["dependencies"], *(item for extra in EXTRAS for item in optional[extra]), *tools]


def lowest(requirement: str) -> str:
    """``name>=1.2,<2`` as ``name==1.2``."""
    name, version = re.fullmatch(r"([\w.-]+)>=([\d.]+).*", requirement).groups()  # type: ignore[union-attr]
    return f"{name}=={version}"


def environment(name: str, torch: str) -> Path:
    """A virtual environment with the lowest or highest versions; returns its interpreter."""
    folder = ROOT / ".versions" / name
    interpreter = folder / "bin" / "python"
    subprocess.run(["make", f"VENV={folder}", f"PYTHON={sys.executable}", f"{folder}/.torch"], cwd=ROOT, check=True)
    wanted = [item for item in requirements() if not item.startswith("torch")]
    if name == "lowest":
        wanted = [lowest(item) for item in wanted]
    pip = [str(interpreter), "-m", "pip", "install", "--quiet", "--disable-pip-version-check"]
    subprocess.run([*pip, "--upgrade", "--upgrade-strategy", "eager", *wanted, torch], cwd=ROOT, check=True)
    return interpreter


def versions(interpreter: Path) -> dict[str, str]:
    """Installed version of each requirement."""
    lines = subprocess.run([interpreter, "-m", "pip", "freeze"], capture_output=True, text=True, check=True).stdout
    pairs = (line.lower().replace("_", "-").partition("==") for line in lines.splitlines())
    return {name: version for name, _, version in pairs}


def outcome(interpreter: Path, arguments: list[str]) -> str:
    """Last line that the tests print, and whether ``hydro --help`` works."""
    variables = {
        "PYTHONPATH": os.pathsep.join([str(ROOT), str(ROOT / "agents")]),
        "NUMBA_CACHE_DIR": str(interpreter.parents[1] / "numba"),
    }
    settings = {"cwd": ROOT, "env": {**os.environ, **variables}, "capture_output": True, "text": True}
    tests = subprocess.run([interpreter, "-m", "pytest", "-q", *arguments], check=False, **settings)  # type: ignore[call-overload]
    (interpreter.parents[1] / "tests.log").write_text(tests.stdout + tests.stderr, encoding="utf-8")
    page = subprocess.run([interpreter, "-c", HYDRO, "--help"], check=False, **settings)  # type: ignore[call-overload]
    last = (tests.stdout.strip().splitlines() or ["no tests ran"])[-1]
    return f"{last}; hydro --help {'fails' if page.returncode or 'simulate' not in page.stdout else 'works'}"


def main() -> int:
    """Print the table; 1 if anything failed."""
    arguments = sys.argv[1:] or TESTS
    torch = next(line for line in (ROOT / "constraints.txt").read_text().splitlines() if line.startswith("torch=="))
    interpreters = [environment(name, torch) for name in ("lowest", "highest")]
    installed = [versions(interpreter) for interpreter in interpreters]
    print("| package | allowed | lowest | highest |\n|---|---|---|---|")
    for requirement in requirements():
        name, allowed = re.fullmatch(r"([\w.-]+)(.*)", requirement).groups()  # type: ignore[union-attr]
        print(f"| {name} | {allowed} | {' | '.join(found.get(name.lower(), '–') for found in installed)} |")
    results = [outcome(interpreter, arguments) for interpreter in interpreters]
    print(f"| **result** | | {' | '.join(results)} |")
    return int(any("failed" in result or "error" in result or "fails" in result for result in results))


if __name__ == "__main__":
    sys.exit(main())
