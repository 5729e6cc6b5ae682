"""The recipes of docs/extend.md: their steps are read from the page, applied to a copy of the sources, and tried.

Run as a program, in a copy, this file carries out the ``try_…`` functions that it is given.
"""

import os
import re
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
import pytest

import hydro_env
from hydro_env import PlantParameters, ServoHydraulicEnv, equilibrium, simulate
from hydro_env.plant.linearisation import linearise
from hydro_env.plant.simulate import TRAJECTORY_UNITS, valid_ranges
from hydro_env.plant.states import STATE_NAMES
from hydro_env.task.configuration import task_config

ROOT = Path(__file__).resolve().parents[2]
PLANT_RECIPES = {"A second valve model": 3, "A new state": 4}
TASK_RECIPES = {"A leak law": 1, "A new measured signal": 3, "A reward term": 2, "A reference family": 1}
EVALUATION_RECIPES = {"A metric": 1, "A condition": 0, "A section of a page": 1}
IN_YAML = ("A condition", "A controller", "A detector", "Another algorithm")
AGENT_RECIPES = {"A controller": 1, "A detector": 1, "Another algorithm": 1}
MOST_SOURCE_FILES = {**PLANT_RECIPES, **TASK_RECIPES, **EVALUATION_RECIPES, **AGENT_RECIPES}


def steps_of(recipe: str) -> list[tuple[str, list[tuple[str, str]]]]:
    """The files that a recipe changes: name, and pairs of old text (empty in a new file) and new text."""
    page = (ROOT / "docs" / "extend.md").read_text(encoding="utf-8")
    section = re.search(rf"^### {re.escape(recipe)}\n(.*?)(?=^##|\Z)", page, re.M | re.S)
    assert section, f"docs/extend.md has no recipe '{recipe}'"
    steps = []
    for kind, header, body in re.findall(r"^```(diff|python)\n(.*?)\n(.*?)^```$", section[1], re.M | re.S):
        name = header.removeprefix("+++ " if kind == "diff" else "# ")
        if kind == "python":
            steps.append((name, [("", body)]))
            continue
        hunks = []
        for hunk in body.split("@@\n")[1:]:
            lines = hunk.splitlines(keepends=True)
            assert all(line[0] in " +-\n" for line in lines), f"{recipe}, {name}: not a diff:\n{hunk}"
            old, new = ("".join(line[1:] or "\n" for line in lines if line[0] not in skip) for skip in "+-")
            hunks.append((old, new))
        steps.append((name, hunks))
    assert steps, f"recipe '{recipe}' has no steps"
    return steps


def apply(recipe: str, root: Path) -> set[str]:
    """Carry out the steps of a recipe; returns the files that it changed."""
    changed = set()
    for name, hunks in steps_of(recipe):
        file = root / name
        changed.add(name)
        for old, new in hunks:
            assert bool(old) == file.exists(), f"recipe '{recipe}': {name}"
            text = file.read_text(encoding="utf-8") if old else ""
            assert text.count(old) == 1 or not old, f"recipe '{recipe}': {text.count(old)} places in {name}:\n{old}"
            file.write_text(text.replace(old, new) if old else new, encoding="utf-8")
    return changed


@pytest.fixture
def sources(tmp_path):
    for folder in ("hydro_env", "agents", "configs"):
        shutil.copytree(ROOT / folder, tmp_path / folder, ignore=shutil.ignore_patterns("__pycache__"))
    return tmp_path


def run(root, *trials):
    variables = {key: value for key, value in os.environ.items() if key != "NUMBA_CACHE_DIR"}
    command = [sys.executable, __file__, *trials]
    done = subprocess.run(
        command,
        env={**variables, "PYTHONPATH": os.pathsep.join([str(root), str(root / "agents")])},
        cwd=root,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize("recipe", MOST_SOURCE_FILES)
def test_a_recipe_fits_the_sources_and_takes_few_files(recipe, sources):
    settings = {file: file.read_text(encoding="utf-8") for file in (sources / "configs").rglob("*.yaml")}
    changed = apply(recipe, sources)
    in_yaml = {name for name in changed if name.endswith(".yaml")}
    assert min(1, MOST_SOURCE_FILES[recipe]) <= len(changed - in_yaml) <= MOST_SOURCE_FILES[recipe]
    assert all(name.startswith(("hydro_env/", "agents/hydro_agents/")) for name in changed - in_yaml)
    more_lines = sum(len(file.read_text().splitlines()) - len(text.splitlines()) for file, text in settings.items())
    assert (len(in_yaml), more_lines) == ((1, 1) if recipe in IN_YAML else (0, 0))


def test_the_page_has_no_other_recipes():
    page = (ROOT / "docs" / "extend.md").read_text(encoding="utf-8")
    assert re.findall(r"^### (.*)$", page.split("## Recipes")[1], re.M) == list(MOST_SOURCE_FILES)


@pytest.fixture
def changed_sources(sources, tmp_path):
    """A copy of the sources with all recipes: it is compiled once."""
    np.save(tmp_path / "before.npy", lively_episode())
    for recipe in MOST_SOURCE_FILES:
        apply(recipe, sources)
    return sources


def test_the_recipes_do_what_they_say(changed_sources):
    run(changed_sources, "try_plant", "try_task", "try_leak_law", "try_agents", "try_detector", "try_evaluation")


def lively_episode(**task) -> np.ndarray:
    """Observations and true supply pressures of an episode with a given seed and reference, (steps + 1, n + 1)."""
    env, supply = ServoHydraulicEnv(episode_duration=0.2, **task), STATE_NAMES.index("supply_pressure")
    observation, _ = env.reset(seed=5, options={"reference": "sine"})
    rows = [[*observation, env.axes.state[0, supply]]]
    for step in range(40):
        observation, *_ = env.step(np.array([0.8 if step % 20 < 10 else -0.6]))
        rows.append([*observation, env.axes.state[0, supply]])
    return np.array(rows)


FITTED = {"supply_pressure": {"fitted": True}}


def try_leak_law():
    """Two litres per minute are two, by the new law too, wherever the project speaks of leaks: the new cases run."""
    leak_cases("turbulent and not estimator")


def leak_cases(chosen):
    tests = str(ROOT / "tests/hydro_env/test_leak_laws.py")
    assert pytest.main(["-q", "-x", "-p", "no:cacheprovider", "-k", chosen, tests]) == 0


def try_plant():
    voltage = np.repeat([8.0, -8.0, 0.4, -10.0], 10)
    plain = PlantParameters()
    notched = plain.replace(valve={"edges": "notched"})

    # The valve: equilibrium, both solvers, and what notches do.
    for position in (-0.02, 0.03):
        state, holding = equilibrium(notched, position)
        held = simulate(notched, np.full(40, holding), 5e-3, initial_state=state)
        assert np.ptp(held.position) < 1e-7
        assert np.ptp(held.pressure_a) < 1.0
    small = {kind: simulate(p, np.full(40, 0.4), 5e-3).position for kind, p in (("plain", plain), ("notched", notched))}
    assert abs(small["notched"][-1]) < 0.2 * abs(small["plain"][-1])
    open_wide = [abs(simulate(p, np.full(20, 10.0), 5e-3).position[-1]) for p in (plain, notched)]
    assert 0.8 * open_wide[0] < open_wide[1] < open_wide[0]
    fast, exact = (simulate(notched, voltage, 5e-3, method=method) for method in ("fast", "radau"))
    ranges = np.maximum(np.ptp(exact.states, axis=0), 1e-9)
    assert (np.abs(fast.states - exact.states) / ranges).max() < 1e-3

    # The state: named everywhere, within its range, at rest, and heated by what the valve draws.
    row = STATE_NAMES.index("oil_temperature")
    assert TRAJECTORY_UNITS["oil_temperature"] == "K"
    assert (valid_ranges(plain)[0][row], valid_ranges(plain)[1][row]) == (200.0, 500.0)
    with pytest.raises(hydro_env.HydroError, match="oil_temperature left its valid range"):
        simulate(plain, [0.0], 1e-3, initial_state={"oil_temperature": 600.0})
    state, holding = equilibrium(plain, 0.01)
    rest = simulate(plain, np.full(40, holding), 5e-3, initial_state=state)
    assert np.ptp(rest["oil_temperature"]) < 1e-6
    assert state["oil_temperature"] > 293.0
    np.testing.assert_allclose(linearise(plain).a[row, row], -20.0 / 4e3, rtol=1e-6)
    warm = simulate(plain, np.repeat(voltage, 5), 1e-3)
    losses = (warm.supply_pressure - plain.supply.tank_pressure) * warm.supply_flow
    heat = losses - 20.0 * (warm["oil_temperature"] - 293.0)
    stored = 4e3 * (warm["oil_temperature"][-1] - warm["oil_temperature"][0])
    assert stored > 10.0
    np.testing.assert_allclose(np.trapezoid(heat, warm.time), stored, rtol=0.02)


def try_task():
    # The signal: observed with its own noise; all others as without it, bit for bit, and as before the recipes.
    before, after = lively_episode(), lively_episode(sensors=FITTED)
    np.testing.assert_allclose(before[:, :-1], np.load("before.npy")[:, :-1], rtol=0, atol=1e-3)
    env = ServoHydraulicEnv(reward={"speed": 2.0}, references={"weights": {"sweep": 1.0}}, sensors=FITTED)
    assert env.axes.observation_names[-1] == "supply_pressure"
    assert env.axes.observation_units[-1] == "Pa"
    np.testing.assert_array_equal(after[:, :-2], before[:, :-1])
    error = 50e5 * after[:, -2] - after[:, -1]
    assert 0.5 * 0.1e5 < error.std() < 2.0 * 0.1e5
    assert abs(error.mean()) < 0.5e5 + 0.1e5

    # The reward term, and the reference: within the range of references, faster at the end than at the beginning.
    env.reset(seed=1)
    total = 0.0
    for _ in range(100):
        _, reward, _, _, info = env.step(np.array([0.5]))
        terms = info["reward_terms"]
        np.testing.assert_allclose(terms["speed"], -2.0 * info["velocity"] ** 2, rtol=1e-12)
        np.testing.assert_allclose(reward, sum(terms.values()), rtol=1e-6)
        total += terms["speed"]
    assert total < 0.0
    assert info["reference_family"] == "sweep"
    steps = env.config.steps
    for seed in range(5):
        env.reset(seed=seed)
        row = env.axes.reference[0, : steps + 1]
        assert np.abs(row).max() <= 0.1
        turns = np.flatnonzero(np.diff(np.sign(np.diff(row))))
        assert (turns > steps / 2).sum() > (turns < steps / 2).sum() >= 1


def try_agents():
    from hydro_agents import evaluate
    from hydro_agents.evaluation.study import StudySettings
    from hydro_agents.evaluation.study_run import train_controller
    from hydro_agents.running.console import ProgressDisplay

    study = StudySettings.from_yaml("configs/studies/quick.yaml")
    assert list(study.controllers) == ["PID", "damped", "Flow linearisation", "PPO on flow linearisation", "TD3"]
    assert study.trained == ["PPO on flow linearisation", "TD3"]
    damped = study.make("damped")
    trainer = study.controllers["TD3"].trainer
    assert trainer is not None
    with tempfile.TemporaryDirectory() as name, ProgressDisplay() as display:
        folder = Path(name)
        short = study.controllers["TD3"].changed(settings=trainer.settings(total_steps=160))
        study = study.model_copy(update={"controllers": study.controllers | {"TD3": short}})
        trained = train_controller(study, "TD3", folder, 0, None, display)
        loaded = trainer.load(folder / "policy")
    observation = np.random.default_rng(0).normal(size=(7, len(study.make("PID").layout.names))).astype(np.float32)
    np.testing.assert_array_equal(loaded.predict(observation)[0], trained.predict(observation)[0])
    sizes = {"leak_levels": [0.1, 2.0], "families": ["sweep"], "plants": 3}
    made = evaluate(study.task, {"PID": study.make("PID"), "damped": damped, "TD3": loaded}, settings=sizes)
    assert not made.errors
    error = made.table("cases").groupby("controller")["mean_error_mm"].mean()
    assert error["damped"] < error["TD3"]  # which has hardly learned


def try_detector():
    from hydro_agents.detection.detector import Windows
    from hydro_agents.evaluation.leak_protocol import LeakProtocol, make_detector, simulated_windows

    # In the protocol, a leak scores higher on the same plants, and a window with motion has no answer.
    protocol = LeakProtocol.from_yaml("configs/protocols/leakage.yaml")
    detector = make_detector(protocol.detectors["held"])
    task, signals = protocol.known_task("standing"), {}
    for level in (0.0, 1.0):
        cases = protocol.cases_in("standing", level, 3)
        signals[level] = simulated_windows(protocol.tasks["standing"], "PID", cases, 400)[0]
    healthy, leaking = (detector.read(Windows.of(each), task) for each in signals.values())
    assert healthy.answers.all()
    assert (leaking.score > 2.0 * healthy.score).all()
    moving = simulated_windows(protocol.tasks["ordinary"], "PID", protocol.cases_in("ordinary", 1.0, 3), 400)[0]
    assert not detector.read(Windows.of(moving), task).answers.all()
    assert "needs the position" in detector.refuses(task_config(sensors={"spool_position": {"fitted": False}}), 400)


def try_evaluation():
    from hydro_agents.evaluation.robustness_protocol import RobustnessProtocol, participants
    from hydro_agents.evaluation.runner import run as run_protocol
    from hydro_agents.report.controllers_page import controllers_page, overview
    from hydro_agents.running.text import number

    # The condition of the file, which no controller knows.
    quick = RobustnessProtocol.from_yaml("configs/protocols/quick.yaml")
    conditions = {name: quick.conditions[name] for name in ("leak_8", "thin_oil")}
    task = {"episode_duration": 0.3}
    protocol = RobustnessProtocol(task=task, plants=3, families=["step"], standstill_plants=0, conditions=conditions)
    thin = protocol.cases_of("thin_oil", protocol.cases_in("thin_oil")).parameters
    assert thin is not None
    assert thin["fluid"]["bulk_modulus"] == 0.7 * protocol.task.plant.fluid.bulk_modulus
    assert protocol.tasks["thin_oil"].plant == protocol.task.plant
    chosen = participants({"PID": "pid", "Flow linearisation": "flow_linearising"}, protocol)
    tables = run_protocol(protocol, chosen).tables()
    compared = tables["comparison"]
    assert set(compared.loc[compared["group"] == "condition", "value"]) == {"leak_8", "thin_oil"}

    # The metric: in the table of cases, in the comparisons, and on the page.
    assert tables["cases"]["saturated_share"].between(0.01, 0.99).any()
    for name in ("comparison", "ranking"):
        assert "saturation_ratio" in tables[name]
    assert "saturated_share" in set(tables["summary"]["metric"])
    assert "command at its limit, % of the time" in overview(tables)["cost"]

    # The section: on the page at its place, and not without its table.
    page = controllers_page("Mine", tables)
    named = list(page.headings)
    assert named[named.index("largest-errors") - 1] == "by-kind-of-reference"
    worst = tables["cases"].query("controller == 'Flow linearisation'").nlargest(1, "peak_error_mm").iloc[0]
    cells = [number(worst["peak_error_mm"]), worst["condition"]]
    assert ">".join(cells) in re.sub(r"</td>\s*<td[^>]*", "", page.html())
    rest = {name: table for name, table in tables.items() if name != "cases"}
    assert "largest-errors" not in controllers_page("Mine", rest).headings


if __name__ == "__main__":
    for trial in sys.argv[1:]:
        globals()[trial]()
