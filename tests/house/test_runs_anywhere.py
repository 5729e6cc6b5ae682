"""It runs where the fast path cannot: no folder for the cache, many threads.

tests/hydro_env/plant/test_compiled_code.py runs it without a compiler.
"""

import json
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import llvmlite.binding as llvm
import numpy as np
import pytest

from hydro_env import PlantParameters, ServoHydraulicVectorEnv, simulate

ROOT = Path(__file__).parents[2]
STEPS = 40
RUN = f"""
import json
import hydro_env
from hydro_env.plant import kernel
run = hydro_env.simulate(hydro_env.PlantParameters(), [4.0, -2.0] * {STEPS}, 1e-3)
dispatcher = kernel.integrate.dispatcher
stats, (code,) = getattr(dispatcher, "stats", None), dispatcher.inspect_asm().values()
found = {{"rows": run.states.tolist(), "kept": bool(stats and stats.cache_path), "assembly": code}}
print(json.dumps({{**found, "module": hydro_env.__file__}}))
"""


def elsewhere(code, folder, **variables):
    """What code prints in a fresh process with other environment variables, with the package in ``folder``."""
    answer = subprocess.run(
        [sys.executable, "-c", code],
        env={**os.environ, "PYTHONPATH": str(folder), "PYTHONDONTWRITEBYTECODE": "1", **variables},
        cwd=folder,
        capture_output=True,
        text=True,
        check=False,
    )
    assert answer.returncode == 0, answer.stderr
    found = json.loads(answer.stdout)
    assert Path(found["module"]).parents[1] == Path(folder)
    return found


@pytest.fixture(scope="module")
def without_cache(tmp_path_factory):
    """A run with a file where each folder would have to be: that denies root as well, unlike permissions."""
    folder = tmp_path_factory.mktemp("sources")
    shutil.copytree(ROOT / "hydro_env", folder / "hydro_env", ignore=shutil.ignore_patterns("__pycache__"))
    for source in (folder / "hydro_env").rglob("*.py"):
        (source.parent / "__pycache__").touch()
    (folder / "file").touch()
    nowhere = str(folder / "file" / "folder")
    variables = dict.fromkeys(("HOME", "XDG_CACHE_HOME", "NUMBA_CACHE_DIR", "IPYTHONDIR"), nowhere)
    return elsewhere(RUN, folder, **variables)  # code from a cache cannot be inspected


def test_without_any_folder_for_the_cache_the_integration_uses_the_widest_vector_instructions(without_cache):
    """Products of whole registers of doubles must outnumber those of single ones, with square roots and quotients.

    With AVX-512 both widths count: for some processors LLVM prefers the half, at which they run faster.
    """
    assert not without_cache["kept"]
    here = simulate(PlantParameters(), [4.0, -2.0] * STEPS, 1e-3)
    np.testing.assert_array_equal(without_cache["rows"], here.states)
    features = llvm.get_host_cpu_features()
    register = "[yz]mm" if features.get("avx512f") else "ymm" if features.get("avx") else None
    if register is None or not llvm.get_process_triple().startswith("x86_64"):
        pytest.skip("this processor has no vector instructions that are known here")
    code = without_cache["assembly"]
    packed = {name: len(re.findall(rf"\bv{name}pd\b[^\n]*%{register}", code)) for name in ("mul", "sqrt", "div")}
    scalar = len(re.findall(r"\bv?mulsd\b", code))
    assert packed["mul"] > 100, packed
    assert packed["mul"] > scalar / 4, (packed, scalar)
    assert packed["sqrt"] >= 8, packed
    assert packed["div"] >= 8, packed


@pytest.fixture(scope="module")
def many():
    """1000 axes through 12 steps and one restart, with one thread: observations, rewards, commands."""
    commands = np.random.default_rng(4).uniform(-1, 1, (12, 1000, 1)).astype(np.float32)
    return commands, vector_numbers(commands, 1)


def vector_numbers(commands, threads):
    envs = ServoHydraulicVectorEnv(commands.shape[1], threads=threads, episode_duration=0.04)
    observations, rewards = [envs.reset(seed=9)[0]], []
    for action in commands:
        observation, reward, *_ = envs.step(action)
        observations.append(observation)
        rewards.append(reward)
    threaded = envs.axes._pool is not None
    envs.close()
    return np.array(observations), np.array(rewards), threaded


@pytest.mark.parametrize(("count", "threads"), [(1, 1), (7, 2), (8, 1), (9, 3), (64, 2), (1000, 2), (1000, 3)])
def test_bit_for_bit_whatever_the_number_of_axes_blocks_and_threads(many, count, threads):
    commands, (observations, rewards, _) = many
    mine = vector_numbers(commands[:, :count], threads)
    assert mine[2] == (threads > 1 and count == 1000)
    np.testing.assert_array_equal(mine[0], observations[:, :count])
    np.testing.assert_array_equal(mine[1], rewards[:, :count])


WITHOUT_RIG = """
import sys
from pathlib import Path
sys.path[:] = [place for place in sys.path if not (Path(place) / "hydro_rig").exists()]
"""
"""A ``sitecustomize`` of an installation that has the core alone, for this process and its workers."""

SMALL_STUDY = """
task: {episode_duration: 0.4}
controllers: {PID: {kind: pid}}
evaluation: {plants: 3, leak_levels: [0.01], families: [step]}
"""


EACH_LINE = """
import sys
from hydro_agents.commands.application import main
for line in sys.argv[1:]:
    sys.argv = ["hydro", *line.split()]
    try:
        main()
    except SystemExit as end:
        assert not end.code, line
"""


def test_a_study_needs_no_rig_package(tmp_path):
    shutil.copytree(ROOT / "agents/hydro_agents", tmp_path / "hydro_agents")
    (tmp_path / "sitecustomize.py").write_text(WITHOUT_RIG)
    (tmp_path / "study.yaml").write_text(SMALL_STUDY)
    lines = ("study --config study.yaml --jobs 2 --output study", "--help")
    answer = subprocess.run(
        [sys.executable, "-c", EACH_LINE, *lines],
        env={**os.environ, "PYTHONPATH": os.pathsep.join([str(tmp_path), str(ROOT)])},
        cwd=tmp_path,
        capture_output=True,
        text=True,
        check=False,
    )
    assert answer.returncode == 0, answer.stderr
    assert "check-rig" in answer.stdout
    assert "diagnose" not in answer.stdout
