"""Build a release and try its wheel as a user would, or test other versions of the dependencies.

Run: python benchmarks/release.py [--url https://…]      (``make release``; needs a package index)
     python benchmarks/release.py --versions             (``make versions``; a few minutes)

Builds sdist and wheel, checks both (twine, check-wheel-contents), and for every Python from 3.11 on that is installed
makes an environment with the wheel alone, first the environment without learning libraries, then the command line.
Nothing is uploaded; the last line tells where the files are.

``--versions`` runs a selection of tests with the lowest and with the highest versions of the dependencies that
pyproject.toml allows. torch has the version of constraints.txt in both: other versions of it cost gigabytes.
"""

import os
import re
import shutil
import subprocess
import sys
import tempfile
import tomllib
from pathlib import Path

from benchmarks import command_line

ROOT = Path(__file__).resolve().parents[1]
VERSIONS = ("3.11", "3.12", "3.13", "3.14")
TOOLS = ("build", "twine", "check-wheel-contents")
TESTS = (
    *("tests/hydro_env/test_env.py", "tests/hydro_env/test_vector_env.py", "tests/hydro_agents/test_pretrained.py"),
    "tests/hydro_env/plant/test_known_answers.py",
)
TEST_TOOLS = ("pytest", "hypothesis")

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

LEAK = 10  # exit code of ``hydro diagnose`` for the leak of the recording


def run(*command: str | Path, cwd: Path = ROOT, code: int = 0, **variables: str) -> str:
    """Run a command and return what it prints; another exit code than expected ends the script with its output."""
    changed = {**os.environ, **variables}
    done = subprocess.run(command, cwd=cwd, env=changed, capture_output=True, text=True, check=False)
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


def release(folder: Path, url: str) -> None:
    """Build, check, try, with environments in a folder that nobody keeps."""
    output = ROOT / "dist"
    shutil.rmtree(output, ignore_errors=True)
    tools = environment(sys.executable, folder / "tools")
    install(tools, *TOOLS)
    print("building", flush=True)
    run(tools, "-m", "build", "--outdir", str(output), str(ROOT), HYDRO_ENV_URL=url)
    (wheel,), (source,) = output.glob("*.whl"), output.glob("*.tar.gz")
    run(tools, "-m", "twine", "check", "--strict", str(wheel), str(source))
    run(tools.with_name("check-wheel-contents"), str(wheel))
    found = [name for name in (f"python{version}" for version in VERSIONS) if works(name)]
    for name in found or [sys.executable]:
        print(f"{name}: the wheel in a clean environment", flush=True)
        (folder / Path(name).name).mkdir()
        tried(name, wheel, folder / Path(name).name)
    if missing := [version for version in VERSIONS if f"python{version}" not in found]:
        print(f"not tried, because they are not installed: Python {', '.join(missing)}")
    if not url:
        print("built without an address: the README for the package index has no links into the repository (--url)")
    print(f"{wheel}\n{source}")


def versions() -> None:
    """Test the lowest and the highest allowed versions; the environments in .versions stay."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    extras = project["optional-dependencies"]
    tools = [item for item in extras["dev"] if item.startswith(TEST_TOOLS)]
    allowed = [*project["dependencies"], *extras["render"], *extras["agents"], *tools]
    highest = [item for item in allowed if not item.startswith("torch")]
    lowest = [re.sub(r">=([\d.]+).*", r"==\1", item) for item in highest]
    (torch,) = re.findall(r"^torch==.*", (ROOT / "constraints.txt").read_text(encoding="utf-8"), re.MULTILINE)
    paths = os.pathsep.join([str(ROOT), str(ROOT / "agents")])
    for name, wanted in (("lowest", lowest), ("highest", highest)):
        folder = ROOT / ".versions" / name
        python = folder / "bin" / "python"
        run("make", f"VENV={folder}", f"PYTHON={sys.executable}", f"{folder}/.torch")
        pip = (python, "-m", "pip")
        run(*pip, "install", "--quiet", "--upgrade", "--upgrade-strategy", "eager", *wanted, torch)
        print(run(*pip, "freeze"))
        print(run(python, "-m", "pytest", "-q", *TESTS, PYTHONPATH=paths, NUMBA_CACHE_DIR=str(folder / "numba")))


if __name__ == "__main__":
    given = command_line(__doc__, url=os.environ.get("HYDRO_ENV_URL", ""), versions=False)
    with tempfile.TemporaryDirectory() as temporary:
        if given.versions:
            versions()
        else:
            release(Path(temporary), given.url)
