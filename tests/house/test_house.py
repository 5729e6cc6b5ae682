"""The house rules: imports run one way, and the environment draws no learning library."""

import ast
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
GROUND = tuple(
    (f"hydro_env/{name}", 0) for name in ("errors", "files", "folders", "mistakes", "units", "version", "compiling")
)
FLOORS = (
    *GROUND,
    ("hydro_env/plant/", 1),
    ("hydro_env/task/", 2),
    ("hydro_env/", 3),
    ("agents/hydro_agents/controllers/", 4),
    ("agents/hydro_agents/running/", 5),
    ("agents/hydro_agents/learning/", 6),
    ("agents/hydro_agents/detection/", 7),
    ("agents/hydro_agents/evaluation/", 8),
    ("agents/hydro_agents/report/", 9),
    ("agents/hydro_agents/rigs/", 10),
    ("agents/hydro_agents/study/", 11),
    ("agents/hydro_agents/", 12),
    ("agents/hydro_rig/estimation/", 13),
    ("agents/hydro_rig/recordings/", 14),
    ("agents/hydro_rig/export/", 15),
    ("agents/hydro_rig/identification/", 16),
    ("agents/hydro_rig/diagnosis/", 17),
    ("agents/hydro_rig/monitoring/", 18),
    ("agents/hydro_rig/challenge/", 19),
    ("agents/hydro_rig/", 20),
)

NOT_INSTALLED = {"paper", "benchmarks", "tests", "docs"}
"""Folders of a checkout that the wheel does not contain; they may import anything."""

HEAVY = {"torch", "stable_baselines3", "matplotlib", "pandas", "safetensors", "typer", "rich", "jinja2"}
FORBIDDEN = {0: HEAVY | {"gymnasium", "pygame"}, 1: HEAVY | {"gymnasium", "pygame"}, 2: HEAVY | {"pygame"}, 3: HEAVY}


def floor_of(path: str) -> int | None:
    return next((number for prefix, number in FLOORS if path.startswith(prefix)), None)


def imports_of(file: Path) -> list[str]:
    """Modules that a file imports, pandas only where the whole file needs it: a method may hand its data over to it."""
    names: list[str] = []
    tree = ast.parse(file.read_text(encoding="utf-8"))
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom) and node.module == "pandas" and node not in tree.body:
            continue
        if isinstance(node, ast.Import):
            names += [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom) and node.module:
            names.append(node.module)
    return names


INSTALLED = sorted(str(p.relative_to(ROOT)) for top in ("hydro_env", "agents") for p in (ROOT / top).rglob("*.py"))


@pytest.mark.parametrize("file", INSTALLED)
def test_nothing_imports_upwards(file):
    here = floor_of(file)
    for name in imports_of(ROOT / file):
        assert name.split(".")[0] not in FORBIDDEN.get(here, set()), f"{file} imports {name}"
        there = floor_of(
            name.replace(".", "/")
            .replace("hydro_agents", "agents/hydro_agents")
            .replace("hydro_rig", "agents/hydro_rig")
            + "/"
        )
        if file != "hydro_env/__init__.py":  # it loads lazily what stands above
            assert there is None or there <= here, f"{file} imports {name}"


def test_only_two_commands_import_what_is_not_installed():
    """They do so in a function, after they have asked for a checkout."""
    found = {file for file in INSTALLED for name in imports_of(ROOT / file) if name.split(".")[0] in NOT_INSTALLED}
    assert found == {"agents/hydro_agents/commands/checkout.py"}
    (file,) = found
    body = ast.parse((ROOT / file).read_text(encoding="utf-8")).body
    at_the_top = [node.module for node in body if isinstance(node, ast.ImportFrom) and node.module]
    assert not {name.split(".")[0] for name in at_the_top} & NOT_INSTALLED


def test_the_environment_loads_no_learning_library():
    code = (
        "import sys, gymnasium, hydro_env; env = gymnasium.make('ServoHydraulic-v0'); env.reset(seed=0);"
        f"found = sorted(set(sys.modules) & {HEAVY | {'pygame'}!r}); assert not found, found"
    )
    subprocess.run([sys.executable, "-c", code], check=True, cwd=ROOT)


def test_the_wheel_holds_three_packages_with_names_of_their_own():
    settings = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    wheel = settings["tool"]["hatch"]["build"]["targets"]["wheel"]
    assert [Path(package).name for package in wheel["packages"]] == ["hydro_env", "hydro_agents", "hydro_rig"]
    assert settings["project"]["scripts"]["hydro"].startswith("hydro_agents.")


def test_an_evaluation_with_shipped_policies_loads_no_library_of_the_training():
    code = (
        "import sys, hydro_agents.study.results, hydro_agents.study.settings as other;"
        "study = other.default_study(); study.with_weights({});"
        "found = sorted({'torch', 'stable_baselines3'} & set(sys.modules)); assert not found, found"
    )
    subprocess.run([sys.executable, "-c", code], check=True, cwd=ROOT)
