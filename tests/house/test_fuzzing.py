"""Random damage to settings and arrays that a user can give: the answer is a result or one clear line.

Each target draws a valid input and damages it. A hundred cases run always, thousands with ``-m slow``. Damaged files:
tests/hydro_env/test_files.py, benchmarks/hostile_inputs.py.
"""

import contextlib
import json
import math
from typing import Any

import numpy as np
import pytest
import yaml
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from hydro_agents.evaluation.study import StudySettings
from hydro_env import (
    HydroError,
    PlantParameters,
    ServoHydraulicEnv,
    ServoHydraulicVectorEnv,
    TaskConfig,
    equilibrium,
    simulate,
)
from hydro_env.files import read_yaml
from hydro_env.folders import config_folder
from hydro_env.plant.workable import refuse_unworkable

NUMBERS = st.one_of(
    st.integers(-3, 3),
    st.integers(),
    st.sampled_from([10**30, -(10**400), 2**63, 2**32, 10**9]),
    st.floats(),
    st.sampled_from([0.0, -0.0, math.inf, -math.inf, math.nan, 1e308, -1e308, 5e-324, 1e9, 1e-9]),
)
WORDS = st.one_of(
    st.text(max_size=20),
    st.sampled_from(["", "1e5", "nan", "step", "user", "../x.yaml", "absent.yaml", "a\0b", "x" * 5000, "[b]", "null"]),
)
PLAIN = st.one_of(st.none(), st.booleans(), NUMBERS, WORDS)
ANYTHING = st.recursive(
    PLAIN,
    lambda inner: st.one_of(st.lists(inner, max_size=4), st.dictionaries(st.one_of(WORDS, PLAIN), inner, max_size=3)),
    max_leaves=6,
)
ARRAYS = st.one_of(
    ANYTHING,
    st.tuples(
        st.lists(st.integers(0, 4), max_size=3),
        st.sampled_from(["f4", "f8", "i8", "?", "U3", "O", "c16", "M8[s]", "f2"]),
        NUMBERS,
    ).map(lambda drawn: filled(*drawn)),
)


def filled(shape, kind, value):
    """An array of this shape and type, filled with a value where the type can hold it."""
    array = np.zeros(shape, dtype=kind)
    with np.errstate(all="ignore"), contextlib.suppress(ValueError, TypeError, OverflowError):
        array[...] = value
    return array


@st.composite
def damaged(draw, base):
    """A copy of nested mappings and lists in which a few places hold something else, are gone, or are new."""
    tree = json.loads(json.dumps(base))
    for _ in range(draw(st.integers(1, 3))):
        place = tree
        while True:
            keys = list(place) if isinstance(place, dict) else list(range(len(place)))
            if not keys:
                break
            key = draw(st.sampled_from(keys))
            if isinstance(place[key], dict | list) and draw(st.integers(0, 9)):
                place = place[key]
                continue
            what = draw(st.integers(0, 9))
            if what == 0:
                del place[key]
            elif what == 1 and isinstance(place, dict):
                place[draw(WORDS)] = draw(ANYTHING)
            else:
                old = place[key]
                numeric = isinstance(old, int | float) and not isinstance(old, bool) and draw(st.booleans())
                place[key] = (
                    old * draw(st.sampled_from([-1, 0, 1e-6, 1e-3, 0.1, 10, 1e3, 1e6])) if numeric else draw(ANYTHING)
                )
            break
    return tree


def refused_or_done(call, *arguments, **keywords):
    """The result, or ``None`` after an error of this project: one line, or a heading and one line per mistake."""
    try:
        return call(*arguments, **keywords)
    except HydroError as error:
        heading, *mistakes = str(error).split("\n")
    assert not mistakes or ("mistakes" in heading and all(line.startswith("  ") for line in mistakes))
    assert all(0 < len(line) < 3000 for line in (heading, *mistakes))
    return None


# --- targets: a strategy, and what is done with each case (in a folder of its own) ---

STUDY = read_yaml(config_folder() / "studies" / "default.yaml")
SMALL_TASK = {**TaskConfig().model_dump(mode="json"), "episode_duration": 0.05}


def use_rig(folder, values):
    parameters = refused_or_done(PlantParameters.from_dict, values)
    if parameters is not None:
        refused_or_done(refuse_unworkable, parameters)
        refused_or_done(equilibrium, parameters)
        refused_or_done(simulate, parameters, [1.0, -1.0], 1e-3)


def use_task(folder, values):
    env = refused_or_done(ServoHydraulicEnv, values)
    if env is not None and refused_or_done(env.reset, seed=0) is not None:
        refused_or_done(env.step, np.zeros(1, dtype=np.float32))


def use_study(folder, values):
    try:
        content = yaml.safe_dump(values, allow_unicode=True).encode("utf-8", "surrogatepass")
    except yaml.YAMLError:
        return
    (folder / "a.yaml").write_bytes(content)
    study = refused_or_done(StudySettings.from_yaml, folder / "a.yaml")
    if study is not None:
        refused_or_done(study.check)


def use_options(folder, options):
    for env in (ServoHydraulicEnv(SMALL_TASK), ServoHydraulicVectorEnv(3, SMALL_TASK)):
        if refused_or_done(env.reset, seed=0, options=options) is None:
            env.reset(seed=1)
        env.step(np.zeros(env.action_space.shape, dtype=np.float32))


def use_actions(folder, drawn):
    action, seed = drawn
    for each in (ServoHydraulicEnv(SMALL_TASK), ServoHydraulicVectorEnv(2, SMALL_TASK)):
        each.reset(seed=0)
        refused_or_done(each.step, action)
        refused_or_done(each.reset, seed=seed)
        refused_or_done(each.reset, seed=0)


OPTIONS = {
    "leakage_flow_lpm": 1.0,
    "reference": [0.0, 0.01],
    "parameters": {"load": {"mass": 80.0}, "valve": {"model": "spool"}},
    "initial_position": 0.01,
    "reset_mask": [True, False, True],
}

TARGETS: dict[str, tuple[Any, Any]] = {
    "rig": (damaged(PlantParameters().model_dump(mode="json")), use_rig),
    "task": (damaged(SMALL_TASK), use_task),
    "study": (damaged(STUDY), use_study),
    "reset options": (
        st.one_of(damaged(OPTIONS), st.fixed_dictionaries({}, optional=dict.fromkeys(OPTIONS, ARRAYS))),
        use_options,
    ),
    "actions and seeds": (st.tuples(ARRAYS, ARRAYS), use_actions),
}


@pytest.mark.parametrize("cases", [25, pytest.param(800, marks=pytest.mark.slow)])
@pytest.mark.parametrize("target", TARGETS)
def test_damage_is_answered_with_one_line(target, cases, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    strategy, check = TARGETS[target]

    @settings(
        max_examples=cases,
        deadline=None,
        derandomize=True,
        database=None,
        suppress_health_check=list(HealthCheck),
        print_blob=False,
    )
    @given(strategy)
    def run(case):
        check(tmp_path, case)

    run()
