"""A leak of 2 l/min at 100 bar is 2 l/min by every law, wherever the project speaks of leaks.

``tests/house/test_recipes.py`` runs these tests with a further law.
"""

from types import SimpleNamespace
from typing import get_args

import numpy as np
import pytest

from hydro_agents.controllers.registry import make_controller
from hydro_agents.running.seeds import THRESHOLDS
from hydro_env import PlantParameters, ServoHydraulicVectorEnv, TaskConfig, simulate
from hydro_env.plant.analysis import leak_at_test_pressure
from hydro_env.plant.equations import Coefficients
from hydro_env.plant.parts.leakage import LEAK_LAWS, ROD_SEAL, Leakage, LeakLaw, internal_leakage, leak_past_piston
from hydro_env.task.configuration import task_config
from hydro_env.units import LEAKAGE_TEST_PRESSURE, LITRE_PER_MINUTE
from hydro_rig.estimation.estimate import estimate
from hydro_rig.estimation.known_windows import known_windows, leak_cases
from hydro_rig.estimation.model import Model
from hydro_rig.estimation.unknowns import EXTERNAL_LEAKAGE, LEAKAGE, priors_of
from hydro_rig.export.plant import fmu_variables, plant_code
from hydro_rig.identification.found_rig import found_plant

FLOW = 2.0  # l/min at 100 bar
TWO = pytest.approx(FLOW, rel=1e-4)  # every law is smooth about zero, which costs some 1e-5 of the flow
ANY_LAW = pytest.mark.parametrize("law", get_args(LeakLaw))
THROTTLED = PlantParameters().replace(leakage={"orifice_gain": 5e-9})  # 1 l/min


def plant_with(law: LeakLaw) -> PlantParameters:
    return THROTTLED.replace(leakage=leak_past_piston(FLOW, law))


def task_with(law: LeakLaw, **settings) -> TaskConfig:
    return task_config(plant=THROTTLED.model_dump(), leakage={"law": law}, **settings)


def flow_of(coefficient) -> float:
    return internal_leakage(LEAKAGE_TEST_PRESSURE, 0.0, Coefficients(*coefficient)) / LITRE_PER_MINUTE


def test_each_law_has_a_parameter_and_a_coefficient_of_its_own():
    assert tuple(LEAK_LAWS) == get_args(LeakLaw)
    every = [*LEAK_LAWS.values(), ROD_SEAL]
    assert {law.parameter for law in every} == set(Leakage.model_fields)
    assert {law.coefficient for law in every} <= set(Coefficients._fields)
    assert len({law.coefficient for law in every}) == len(every)


@ANY_LAW
def test_flow_and_parameter_are_inverse(law):
    flows = np.array([-0.1, 0.003, FLOW, 8.0])
    np.testing.assert_allclose(LEAK_LAWS[law].flow(LEAK_LAWS[law].value(flows)), flows, rtol=1e-12)
    assert leak_past_piston(0.0, law) == {each.parameter: each.value(0.0) for each in LEAK_LAWS.values()}
    assert leak_at_test_pressure(THROTTLED.replace(leakage=leak_past_piston(0.0, law))) == 0.0


@ANY_LAW
def test_plant_and_trajectory(law):
    plant = plant_with(law)
    assert leak_at_test_pressure(plant) == TWO
    start = {"pressure_a": LEAKAGE_TEST_PRESSURE, "pressure_b": 0.0}
    assert simulate(plant, [0.0], 1e-4, start).leakage_flow[0] / LITRE_PER_MINUTE == TWO


@ANY_LAW
def test_environment(law):
    for schedule in ("constant", "growth", "onset"):
        config = task_with(law, episode_duration=0.05)
        leakage = {"law": law, "schedule": schedule, "start_range": (0.2, 0.2)}
        env = ServoHydraulicVectorEnv(2, task_config(config, leakage=leakage), autoreset_mode="Disabled")
        env.reset(seed=[1, 2], options={"leakage_flow_lpm": FLOW})
        for _ in range(config.steps):
            *_, info = env.step(np.zeros((2, 1), dtype=np.float32))
        share = info["leakage_flow_lpm"] / FLOW  # a growing leak reaches its size at the end
        assert (schedule == "growth") == (share < 1.0).all()
        for axis in range(2):
            assert flow_of(env.axes.coefficient[axis]) == pytest.approx(share[axis] * FLOW, rel=1e-4)
            assert leak_at_test_pressure(env.axes.parameters(axis)) == pytest.approx(share[axis] * FLOW, rel=1e-4)


@ANY_LAW
def test_estimator(law):
    config = task_with(law)
    cases = leak_cases(THRESHOLDS.take(2), 2, FLOW)
    windows = known_windows(config, make_controller("pid", config), cases, 0.2, 0.6)
    assert windows.value(LEAKAGE) == TWO
    found = estimate(windows.signals, config, physical=windows.physical)
    assert found.deviation(LEAKAGE).max() < 0.05
    assert (np.abs(found.value(LEAKAGE) - FLOW) < 4.0 * found.deviation(LEAKAGE)).all()


@ANY_LAW
def test_model_of_the_estimator(law):
    config = task_with(law)
    commands = np.linspace(-0.2, 0.2, 40)[None]
    unknown = Model(config, priors_of(config, (LEAKAGE, EXTERNAL_LEAKAGE)), commands)
    leakage = {**leak_past_piston(FLOW, law), ROD_SEAL.parameter: ROD_SEAL.value(0.5)}
    whole = config.plant.replace(leakage=leakage).model_dump()
    known = Model(task_config(config, plant=whole), {}, commands)
    read = unknown.readings(unknown.prior.scaled(np.array([[FLOW, 0.5]])))
    np.testing.assert_allclose(read, known.readings(np.empty((1, 0))), rtol=1e-9)


@ANY_LAW
def test_identified_rig(law):
    fit = SimpleNamespace(own=lambda: {LEAKAGE: FLOW})
    assert leak_at_test_pressure(found_plant(fit, task_with(law))) == TWO


@ANY_LAW
def test_exported_plant(law):
    config = task_config(plant=plant_with(law).model_dump(), leakage={"law": law})
    variables = {variable.name: variable for variable in fmu_variables(config)}
    assert variables["leakage"].start == TWO
    assert f"rig.leakage.{LEAK_LAWS[law].parameter}" not in variables
    plant_code(plant_with(law))  # every line of the law can be translated
