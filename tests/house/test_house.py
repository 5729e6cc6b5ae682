"""The house rules: imports run one way and in no circle, code keeps its budget, tests mirror the rooms."""

import ast
import subprocess
import sys
import tokenize
import tomllib
from pathlib import Path

import pytest

import hydro_env

ROOT = Path(__file__).parents[2]
GROUND = ("errors", "version", "types", "compiling", "mistakes", "units", "field_mistakes", "folders", "files")
ROOMS = (
    *(f"hydro_env/{name}" for name in GROUND),
    "hydro_env/plant/",
    "hydro_env/task/",
    "hydro_env/",
    "hydro_agents/controllers/",
    "hydro_agents/running/",
    "hydro_agents/learning/",
    "hydro_agents/detection/",
    "hydro_agents/evaluation/",
    "hydro_agents/report/",
    "hydro_agents/rigs/",
    "hydro_agents/",
    "hydro_rig/estimation/",
    "hydro_rig/recordings/",
    "hydro_rig/export/",
    "hydro_rig/identification/",
    "hydro_rig/diagnosis/",
    "hydro_rig/watching/",
    "hydro_rig/",
)
"""From the bottom to the top: a room imports from itself and from rooms before it."""

BUDGET = {"hydro_env": 60_742, "hydro_agents": 100_890, "hydro_rig": 106_283, "tests": 181_060}
"""Tokens. Who adds code takes code out elsewhere, or changes the number in a commit that says why."""

NOT_INSTALLED = {"paper", "benchmarks", "challenge", "tests", "docs"}
"""Folders of a checkout that the wheel does not contain; they may import anything."""

HEAVY = {"torch", "stable_baselines3", "matplotlib", "pandas", "safetensors", "typer", "rich", "jinja2"}
FORBIDDEN = {
    "hydro_env/plant/": HEAVY | {"gymnasium", "pygame"},
    "hydro_env/task/": HEAVY | {"pygame"},
    "hydro_env/": HEAVY,
} | {f"hydro_env/{name}": HEAVY | {"gymnasium", "pygame"} for name in GROUND}


def room_of(module: str) -> str | None:
    """The room of a module by its dotted name; none: it is not of this project."""
    path = module.replace(".", "/") + "/"
    return next((room for room in ROOMS if path.startswith(room)), None)


def name_of(file: str) -> str:
    """The dotted name of the module in a file, with ``__init__``."""
    return file.removeprefix("agents/").removesuffix(".py").replace("/", ".")


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
    here = room_of(name_of(file))
    for name in imports_of(ROOT / file):
        assert name.split(".")[0] not in FORBIDDEN.get(here, set()), f"{file} imports {name}"
        there = room_of(name)
        if there is not None and file != "hydro_env/__init__.py":  # it loads lazily what stands above
            assert ROOMS.index(there) <= ROOMS.index(here), f"{file} imports {name}"


DOORS = sorted(file for file in INSTALLED if file.endswith("__init__.py"))


@pytest.mark.parametrize("file", DOORS)
def test_every_door_says_what_its_room_does(file):
    text = ast.get_docstring(ast.parse((ROOT / file).read_text(encoding="utf-8"))) or ""
    assert text.endswith(".")
    assert len(text.split()) > 4, text
    assert "TODO" not in text


def own_imports() -> dict[str, set[str]]:
    """By module the own modules that it imports when it runs; also within functions."""
    modules = {name_of(file) for file in INSTALLED}
    graph = {}
    for file in INSTALLED:
        tree = ast.parse((ROOT / file).read_text(encoding="utf-8"))
        for branch in ast.walk(tree):
            if isinstance(branch, ast.If) and "TYPE_CHECKING" in ast.unparse(branch.test):
                branch.body = []
        targets = {
            target
            for node in ast.walk(tree)
            if isinstance(node, ast.ImportFrom) and node.module
            for target in (node.module, *(f"{node.module}.{alias.name}" for alias in node.names))
        }
        graph[name_of(file)] = targets & modules - {name_of(file)}
    return graph


def test_no_file_imports_itself_through_others():
    graph = {name: set(targets) for name, targets in own_imports().items()}
    while leaves := [name for name, targets in graph.items() if not targets & graph.keys()]:
        for name in leaves:
            del graph[name]
    assert not graph, f"in circles, or above them: {sorted(graph)}"


def tokens_in(folder: str) -> int:
    """Tokens of all Python files of a folder; a docstring counts as one, a comment as none."""
    skipped = {tokenize.COMMENT, tokenize.NL, tokenize.NEWLINE, tokenize.INDENT, tokenize.DEDENT}
    skipped |= {tokenize.ENCODING, tokenize.ENDMARKER}
    count = 0
    for file in (ROOT / folder).rglob("*.py"):
        with tokenize.open(file) as text:
            count += sum(token.type not in skipped for token in tokenize.generate_tokens(text.readline))
    return count


@pytest.mark.parametrize("package", BUDGET)
def test_the_code_keeps_its_budget(package):
    folder = package if (ROOT / package).is_dir() else f"agents/{package}"
    assert tokens_in(folder) <= BUDGET[package]


def test_tests_stand_where_their_room_stands():
    rooms = {room.rstrip("/") for room in ROOMS} | {"house", "site", "commands", "paper", "benchmarks"}
    strangers = {
        str(file.parent.relative_to(ROOT / "tests"))
        for file in (ROOT / "tests").rglob("test_*.py")
        if str(file.parent.relative_to(ROOT / "tests")) not in rooms
    }
    assert not strangers


def test_nothing_installed_imports_what_is_not():
    for file in INSTALLED:
        assert not {name.split(".")[0] for name in imports_of(ROOT / file)} & NOT_INSTALLED, file


@pytest.mark.parametrize(
    ("code", "absent"),
    [
        (
            "import gymnasium, hydro_env; gymnasium.make('ServoHydraulic-v0').reset(seed=0)",
            HEAVY | {"pygame", "scipy.integrate"},
        ),
        (
            "from hydro_agents.evaluation.study import default_study;default_study().with_weights({})",
            {"torch", "stable_baselines3"},  # an evaluation with shipped policies needs no library of the training
        ),
        (
            "import gymnasium, hydro_env;"
            "assert gymnasium.spec('ServoHydraulic-v0').entry_point == 'hydro_env.env:ServoHydraulicEnv'",
            HEAVY | {"numba", "llvmlite", "scipy", "pydantic", "yaml", "pygame", "hydro_agents"},
        ),
        (
            "import pickle; from hydro_env import PlantParameters, TaskConfig, LEAKAGE_CLASSES;"
            "assert pickle.loads(pickle.dumps(TaskConfig())) == TaskConfig()",
            HEAVY | {"numba", "llvmlite", "scipy", "pygame", "hydro_agents"},
        ),
    ],
)
def test_no_library_is_loaded_without_need(code, absent):
    code += f"; import sys; found = sorted(set(sys.modules) & {absent!r}); assert not found, found"
    subprocess.run([sys.executable, "-c", code], check=True, cwd=ROOT)


def test_every_public_name_can_be_had():
    assert set(hydro_env.__all__) <= set(dir(hydro_env))
    assert all(getattr(hydro_env, name) is not None for name in hydro_env.__all__)
    with pytest.raises(AttributeError, match="'hydro_env' has no attribute 'nothing'"):
        _ = hydro_env.nothing


def test_the_wheel_holds_three_packages_with_names_of_their_own():
    settings = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    wheel = settings["tool"]["hatch"]["build"]["targets"]["wheel"]
    assert [Path(package).name for package in wheel["packages"]] == ["hydro_env", "hydro_agents", "hydro_rig"]
    assert settings["project"]["scripts"]["hydro"].startswith("hydro_agents.")
