"""Leakage of an episode: distribution, classes, schedules, laws; known to the judge, hidden from the controller."""

import numpy as np
import pytest
from refusal import refused
from scipy import stats

from hydro_env import PlantParameters, ServoHydraulicEnv, ServoHydraulicVectorEnv, TaskConfig
from hydro_env.units import LITRE_PER_MINUTE

COUNT = 4000
PERIOD = 5e-3


def leaks(count=COUNT, seed=0, **leakage):
    _, info = ServoHydraulicVectorEnv(count, leakage=leakage).reset(seed=seed)
    return info


def test_leaks_are_log_uniform_within_healthy_and_faulty_range():
    flow = leaks()["leakage_flow_lpm"]
    healthy = flow <= 0.03
    assert flow[healthy].min() >= 0.003
    assert flow[~healthy].min() >= 0.1
    assert flow.max() <= 4.0
    assert stats.kstest(flow[healthy], stats.loguniform(0.003, 0.03).cdf).pvalue > 1e-3
    assert stats.kstest(flow[~healthy], stats.loguniform(0.1, 4.0).cdf).pvalue > 1e-3


@pytest.mark.parametrize("share", [0.0, 0.25, 0.6, 1.0])
def test_share_of_healthy_seals(share):
    info = leaks(healthy_share=share)
    assert stats.binomtest(int((info["leakage_flow_lpm"] <= 0.03).sum()), COUNT, share).pvalue > 1e-3
    assert (set(info["leakage_class"]) == {0}) == (share == 1.0)
    assert (0 in info["leakage_class"]) == (share > 0.0)


BOUNDS = [(0.0, 0), (0.03, 0), (0.0301, 1), (0.1, 1), (0.3, 1), (0.301, 2), (1.0, 2), (1.001, 3), (4.0, 3)]


@pytest.mark.parametrize("factor", [1.0, 2.0])
def test_labels_at_the_bounds_belong_to_the_lower_class(factor):
    envs = ServoHydraulicVectorEnv(len(BOUNDS), leakage={"class_bounds": factor * np.array([0.03, 0.3, 1.0])})
    _, info = envs.reset(options={"leakage_flow_lpm": factor * np.array([flow for flow, _ in BOUNDS])})
    assert info["leakage_class"].tolist() == [label for _, label in BOUNDS]


def test_the_leak_of_the_task_replaces_that_of_the_plant():
    """Else the labels would not tell the leak that acts."""
    plant = PlantParameters().replace(leakage={"internal_resistance": 1e11, "orifice_gain": 1e-7})
    env = ServoHydraulicEnv(TaskConfig(plant=plant))
    env.reset(seed=0, options={"leakage_flow_lpm": 0.02})
    assert env.parameters.leakage.orifice_gain == 0.0
    assert env.parameters.leakage.internal_resistance == pytest.approx(3e13)
    for field in ("internal_resistance", "orifice_gain"):
        with refused(f"parameters.leakage.{field}: give leakage_flow_lpm"):
            env.reset(options={"parameters": {"leakage": {field: 1e12}}})
    env.reset(options={"parameters": {"leakage": {"external_resistance": 4e12}}})
    assert env.parameters.leakage.external_resistance == 4e12


def along_an_episode(schedule, count=200, seed=0, **leakage):
    """Leak of each axis (step, axis) through one episode, target, start flow and start time of its schedule."""
    envs = ServoHydraulicVectorEnv(count, leakage={"schedule": schedule, **leakage}, autoreset_mode="Disabled")
    _, info = envs.reset(seed=seed)
    axes = envs.axes
    drawn = [axes.column(name).copy() for name in ("leak_target_flow", "leak_start_flow", "leak_start_time")]
    flow, conductance = [info["leakage_flow_lpm"]], []
    truncated = np.zeros(count, dtype=bool)
    rng = np.random.default_rng(0)
    while not truncated.all():
        _, _, terminated, truncated, info = envs.step(rng.uniform(-0.3, 0.3, (count, 1)))
        assert not terminated.any()
        flow.append(info["leakage_flow_lpm"])
        conductance.append([1.0 / axes.parameters(axis).leakage.internal_resistance for axis in (0, 7, count - 1)])
    return np.array(flow), *drawn, np.array(conductance)


@pytest.mark.parametrize("schedule", ["constant", "onset", "growth"])
def test_a_leak_follows_its_schedule(schedule):
    flow, target, start, begin, conductance = along_an_episode(schedule, healthy_share=0.0)
    np.testing.assert_allclose(conductance, flow[1:, [0, 7, -1]] * LITRE_PER_MINUTE / 100e5, rtol=1e-12)
    if schedule == "constant":
        assert (flow == target).all()
        return
    assert (flow[0] == start).all()
    assert start.max() <= 0.03 < 0.1 <= target.min()
    assert 0.25 * 2.0 <= begin.min() <= begin.max() <= 0.75 * 2.0
    assert stats.kstest(begin, stats.uniform(0.5, 1.0).cdf).pvalue > 1e-3
    # After k steps the info tells the leak that acted in period k − 1.
    times = PERIOD * np.arange(400)[:, None]
    if schedule == "onset":
        np.testing.assert_array_equal(flow[1:], np.where(times < begin, start, target))
        return
    share = np.clip((times - begin) / (2.0 - begin), 0.0, 1.0)
    np.testing.assert_allclose(flow[1:], start * (target / start) ** share, rtol=1e-9)
    # The straight line in the logarithm meets the target at the end of the episode.
    np.testing.assert_allclose(flow[-1] * flow[-1] / flow[-2], target, rtol=1e-6)


def test_the_leak_is_no_part_of_the_observation():
    """Two leaks, the same seed: before anything has moved, only what the leak does to pressures and spool differs."""
    env = ServoHydraulicEnv()
    assert not any("leak" in name for name in env.observation_names)
    seen = {}
    for flow in (0.003, 4.0):
        observation, _ = env.reset(seed=8, options={"leakage_flow_lpm": flow})
        seen[flow] = dict(zip(env.observation_names, observation.tolist(), strict=True))
    differing = {name for name in env.observation_names if seen[0.003][name] != seen[4.0][name]}
    assert differing <= {"pressure_a", "pressure_b", "spool_position", "previous_command"}
    assert "previous_command" in differing  # physics: a leak needs a spool offset to be held
    # And with equal measured signals equal observations: a schedule that has not begun cannot be seen.
    rows = []
    for schedule in ("onset", "growth"):
        late = ServoHydraulicEnv(leakage={"schedule": schedule, "start_range": [1.0, 1.0], "healthy_share": 0.0})
        observation, _ = late.reset(seed=9)
        rows.append([observation] + [late.step(np.full(1, 0.1))[0] for _ in range(50)])
    np.testing.assert_array_equal(rows[0], rows[1])


def test_where_a_leak_begins_says_nothing_about_where_it_ends():
    envs = ServoHydraulicVectorEnv(COUNT, leakage={"schedule": "growth", "healthy_share": 0.0})
    envs.reset(seed=0)
    start, target = (np.log(envs.axes.column(name)) for name in ("leak_start_flow", "leak_target_flow"))
    assert stats.pearsonr(start, target).pvalue > 1e-3
