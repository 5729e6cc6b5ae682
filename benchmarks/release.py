"""Build a release and try its wheel as a user would, from a foreign folder and without the repository.

Run: python benchmarks/release.py [--url https://…]      (``make release``; needs a package index)

Builds sdist and wheel, checks both (twine, check-wheel-contents), and for every Python from 3.11 on that is installed
makes an environment with the wheel alone, first the environment without learning libraries, then the command line.
Nothing is uploaded; the last line tells where the files are.
"""

from __future__ import annotations

import argparse
import os
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
VERSIONS = ("3.11", "3.12", "3.13", "3.14")
TOOLS = ("build", "twine", "check-wheel-contents")

FIRST_STEPS = """
import gymnasium as gym, hydro_env
env = gym.make("ServoHydraulic-v0", episode_duration=0.5)
observation, info = env.reset(seed=0, options={"leakage_flow_lpm": 1.0})
over, steps = False, 0
while not over:
    observation, reward, terminated, truncated, info = env.step([0.1])
    over, steps = terminated or truncated, steps + 1
assert steps == 100 and not terminated, (steps, terminated)
assert "torch" not in __import__("sys").modules
"""

COMMANDS = (
    ("record", "--output", "axis.csv", "--leakage", "0.5", "--duration", "6"),
    ("diagnose", "axis.csv", "--output", "diagnosis"),
    ("export", "flow_linearising", "--output", "controller"),
    ("check-rig", "--rig", "kovari_2015"),
    ("study", "--config", "quick", "--output", "study"),
)
"""The main job and what a maintenance engineer and a control engineer do first."""

LEAK = 10
"""Exit code of ``hydro diagnose`` for the leak of the recording."""


def run(*command: str | Path, cwd: Path = ROOT, code: int = 0, **variables: str) -> str:
    """Run a command and return what it prints; another exit code than expected ends the release with its output."""
    done = subprocess.run(
        command, cwd=cwd, env={**os.environ, **variables}, capture_output=True, text=True, check=False
    )
    if done.returncode != code:
        sys.exit(f"{' '.join(map(str, command))}: exit code {done.returncode}\n{done.stdout}{done.stderr}")
    return done.stdout


def works(interpreter: str) -> bool:
    """Whether it is installed; a version manager may put a name on the path that only tells how to choose it."""
    found = shutil.which(interpreter)
    return found is not None and subprocess.run((found, "--version"), capture_output=True, check=False).returncode == 0


def environment(interpreter: str, folder: Path) -> Path:
    """The interpreter of a new virtual environment."""
    run(interpreter, "-m", "venv", folder)
    return folder / ("Scripts/python.exe" if os.name == "nt" else "bin/python")


def install(python: Path, *what: str) -> None:
    """Install packages with the versions of constraints.txt."""
    pip = (python, "-m", "pip", "install", "--quiet", "--disable-pip-version-check")
    run(*pip, "--constraint", str(ROOT / "constraints.txt"), *what)


def tried(interpreter: str, wheel: Path, folder: Path) -> None:
    """Install the wheel and use it in a folder without any file of the repository."""
    python = environment(interpreter, folder / "environment")
    cache = str(folder / "numba")
    install(python, str(wheel))
    run(python, "-c", FIRST_STEPS, cwd=folder, PYTHONPATH="", NUMBA_CACHE_DIR=cache)
    install(python, f"{wheel}[agents,export]")
    hydro = python.with_name("hydro")
    for command in COMMANDS:
        print(f"  hydro {' '.join(command)}", flush=True)
        code = LEAK if command[0] == "diagnose" else 0
        run(hydro, *command, cwd=folder, code=code, PYTHONPATH="", NUMBA_CACHE_DIR=cache)


def main() -> None:
    """Build, check, try."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--url", default=os.environ.get("HYDRO_ENV_URL", ""), help="address of the repository")
    parser.add_argument("--output", type=Path, default=ROOT / "dist")
    arguments = parser.parse_args()
    if arguments.output.exists():
        shutil.rmtree(arguments.output)
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        tools = environment(sys.executable, folder / "tools")
        install(tools, *TOOLS)
        print("building", flush=True)
        run(tools, "-m", "build", "--outdir", str(arguments.output), str(ROOT), HYDRO_ENV_URL=arguments.url)
        (wheel,) = arguments.output.glob("*.whl")
        (source,) = arguments.output.glob("*.tar.gz")
        run(tools, "-m", "twine", "check", "--strict", str(wheel), str(source))
        run(tools.with_name("check-wheel-contents"), str(wheel))
        found = [name for name in (f"python{version}" for version in VERSIONS) if works(name)]
        for name in found or [sys.executable]:
            print(f"{name}: the wheel in a clean environment", flush=True)
            (folder / Path(name).name).mkdir()
            tried(name, wheel, folder / Path(name).name)
    missing = [version for version in VERSIONS if f"python{version}" not in found]
    if missing:
        print(f"not tried, because they are not installed: Python {', '.join(missing)}")
    if not arguments.url:
        print("built without an address: the README for the package index has no links into the repository (--url)")
    print(f"{wheel}\n{source}")


if __name__ == "__main__":
    main()
