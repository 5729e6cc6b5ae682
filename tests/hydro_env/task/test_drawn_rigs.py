"""Tasks whose episodes draw their rig: plausible rigs, disjoint splits, observations in the rig's own units."""

import numpy as np
import pytest
from refusal import refused

from hydro_agents.running.seeds import RIGS, SeedRange
from hydro_env import ServoHydraulicEnv, ServoHydraulicVectorEnv, TaskConfig
from hydro_env.plant.analysis import closed_port_natural_frequency, full_pressure_forces, speed_limits
from hydro_env.task.configuration import task_config
from hydro_env.task.drawn_rigs import DEAD, drawn_figures, drawn_task, rig_tasks
from hydro_env.task.law import RigLaw
from hydro_env.task.paces import full_speed, pace
from hydro_env.task.signals import SHEET, data_sheet

UNTUNED_RIGS = SeedRange(2_140_000, 50_000, "this test")
LAW = RigLaw(count=6)
SMALL = {"rig": "drawn", "law": {"count": 6}, "episode_duration": 0.2}
ROUNDED = 1.05  # masses and volumes have three digits
LARGEST_GAP = np.sqrt(2.0) * ROUNDED  # neighbouring valve sizes are at most a factor of two apart


def test_drawn_rigs_are_plausible_and_differ():
    seen = []
    for seed in [*RIGS.take(12), *UNTUNED_RIGS.take(12)]:
        figures, timing = drawn_figures(LAW, seed)
        assert (figures, timing) == drawn_figures(LAW, seed)
        task = drawn_task(TaskConfig(), LAW, seed)
        plant, period = task.plant, task.control_period
        assert round(1e3 * plant.cylinder.bore_diameter) in LAW.cylinders
        assert 70e5 <= plant.supply.pressure <= 250e5
        assert 30.0 <= plant.valve.natural_frequency / (2.0 * np.pi) <= 150.0
        assert period == timing["control_period"] >= task.command_latency >= 0.5e-3
        assert 0.1 / LARGEST_GAP < np.mean(speed_limits(plant)) < 1.0 * LARGEST_GAP
        assert min(full_pressure_forces(plant)) > 1.2 * plant.load.external_force
        assert len(task.randomisation) > 10
        dead = 0.25 * np.pi * plant.cylinder.bore_diameter**2 * plant.cylinder.stroke * DEAD
        assert plant.cylinder.dead_volume == pytest.approx(dead, rel=0.01)
        # Hoses and piston lower it below the drawn one; a light load that the supply could not move faster raises it.
        assert closed_port_natural_frequency(plant) / (2.0 * np.pi) > 5.0
        seen.append((plant.cylinder.bore_diameter, plant.load.mass, plant.valve.natural_frequency))
    assert len(set(seen)) == len(seen)


def test_splits_share_no_rig():
    tasks = [rig_tasks(task_config(rig="drawn", law={"count": 12, "split": name})) for name in ("training", "test")]
    plants = [repr(task.plant) for split in tasks for task in split]
    assert len(set(plants)) == 24
    later = rig_tasks(task_config(rig="drawn", law={"count": 3, "first": 9}))
    assert [repr(task.plant) for task in later] == plants[9:12]


def test_each_axis_of_a_batch_has_its_rig_bit_for_bit():
    """A rig moves in a batch with others as alone, and as in its own task."""
    batch = ServoHydraulicVectorEnv(12, **SMALL)
    observation, info = batch.reset(seed=3)
    assert len(set(info["rig"])) > 2
    actions = np.random.default_rng(0).uniform(-0.3, 0.3, (20, 12, 1)).astype(np.float32)
    seen, positions = [observation], [info["position"]]
    for action in actions:
        observation, _, _, _, info = batch.step(action)
        seen.append(observation)
        positions.append(info["position"])
    for axis in (0, 5, 11):
        alone = ServoHydraulicEnv(**SMALL)
        first, own = alone.reset(seed=3 + axis)
        np.testing.assert_array_equal(first, seen[0][axis])
        single = ServoHydraulicEnv(batch.rigs[own["rig"]])
        single.reset(seed=3 + axis)
        for step, action in enumerate(actions[:, axis], 1):
            now, _, _, truncated, _ = alone.step(action)
            np.testing.assert_array_equal(now, seen[step][axis])
            assert single.step(action)[4]["position"] == positions[step][axis]
            if truncated:
                break
        assert step == min(20, batch.rigs[own["rig"]].steps)


@pytest.mark.parametrize("paces", [RigLaw().preview_paces, []])
def test_observations_are_in_the_units_of_the_rig(paces):
    env = ServoHydraulicEnv(**{**SMALL, "law": {"count": 6, "preview_paces": paces}}, sensors={"enabled": False})
    for rig, task in enumerate(env.rigs):
        options = {"rig": rig, "initial_position": 0.01, "reference": np.r_[0.01, np.full(3000, 0.012)]}
        observation, info = env.reset(seed=1, options=options)
        assert info["rig"] == rig
        seen = dict(zip(env.observation_names, observation, strict=True))
        plant, travel = task.plant, full_speed(task.plant) * pace(task)
        assert seen["position"] == pytest.approx(0.02 / plant.cylinder.stroke, rel=1e-5)
        ahead = [seen[name] for name in env.observation_names if "preview" in name]
        assert ahead == pytest.approx([0.002 / travel] * (len(paces) or 4), rel=1e-5)
        assert seen["pressure_a"] == pytest.approx(env.axes.state[0][2] / plant.supply.pressure, rel=1e-5)
        for name, value in data_sheet(task).items():
            assert seen[name] == pytest.approx(value, rel=1e-5, abs=1e-7)
        if not task.sensors.spool_position.fitted:
            assert seen["spool_position"] == seen["previous_command"]
        if paces:
            counts = task.preview_samples
            assert counts == tuple(sorted(set(counts)))
            assert counts[-1] * task.control_period == pytest.approx(5.0 * pace(task), abs=task.control_period)
        far = 0.45 * plant.cylinder.stroke  # the limit is this rig's, not that of the shortest
        env.reset(options={"rig": rig, "initial_position": far, "reference": [far]})


def test_an_agent_may_have_to_find_out_and_lengths_are_those_of_the_rigs():
    told, untold = (ServoHydraulicEnv(**{**SMALL, "law": {"count": 6, "sheet": sheet}}) for sheet in (True, False))
    assert told.observation_names == (*untold.observation_names, *SHEET)
    rigs, lengths = [], []
    untold.reset(seed=0)
    for _ in range(6):
        _, info = untold.reset()
        rigs.append(untold.rigs[info["rig"]].steps)
        lengths.append(next(step for step in range(1, 1000) if untold.step([0.0])[3]))
    assert lengths == rigs
    assert len(set(lengths)) > 1


@pytest.mark.parametrize(
    ("law", "message"),
    [
        ({"count": 0}, "law.count = 0"),
        ({"split": "tests"}, "law.split = 'tests'"),
        ({"supplies": []}, "supplies: is empty"),
        ({"supplies": [70, -5]}, "supplies: -5: each must be positive"),
        ({"cylinders": {25: [30]}}, "cylinders: 25: [30]: needs rods, each thinner than the bore"),
        ({"periods": {30.0: 1.0}}, "periods: 30: 1: each must be within 0.5 to 20 ms"),
        ({"full_speed": [1.0, 0.1]}, "full_speed"),
        ({"supplies": [1.5], "weight_share": 1.0, "count": 1}, "law: none of 100 drawn rigs can work; the last one: "),
    ],
)
def test_impossible_laws_are_refused(law, message):
    with refused(message.replace("[", r"\[")) as error:
        ServoHydraulicEnv(rig="drawn", law=law)
    assert "\n" not in str(error.value)


def test_times_of_a_preview_that_the_law_replaces_are_refused():
    with refused("references.preview_times: the law shows paces instead"):
        ServoHydraulicEnv(rig="drawn", references={"preview_times": [0.01]})
    assert task_config(law={"preview_paces": []}, references={"preview_times": [0.01]}).references.preview_times == (
        0.01,
    )


def test_an_axis_of_a_law_with_one_rig_ends_by_the_steps_of_this_rig():
    """One with 2000 steps of 1 ms, and one with 250 of 8 ms; the default task has 400."""
    for first, steps in ((300, 2000), (303, 250)):
        law = {"split": "test", "count": 1, "first": first}
        env = ServoHydraulicVectorEnv(1, rig="drawn", law=law, autoreset_mode="Disabled", info=False)
        env.reset(seed=0, options={"reference": "point_to_point"})
        ended = [env.step([[0.0]])[3][0] for _ in range(steps)]
        assert (env.rigs[0].steps, np.flatnonzero(ended).tolist()) == (steps, [steps - 1])


def test_the_rewards_of_a_pace_weigh_the_same_on_every_rig():
    for task in rig_tasks(task_config(law={"count": 4})):
        env = ServoHydraulicVectorEnv(3, task)
        env.reset(seed=0)
        *_, info = env.step(np.zeros((3, 1), np.float32))
        error = np.abs(env.axes.column("reference") - env.axes.column("position")) / task.reward.error_scale
        paces = task.control_period / pace(task) * 1.54  # 1 in the default task
        np.testing.assert_allclose(info["reward_terms"]["tracking"], -paces * np.minimum(error, 5.0), rtol=1e-9)
        assert task.reward.failure == TaskConfig().reward.failure
