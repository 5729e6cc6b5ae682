"""A policy for any axis: inputs of one meaning on every rig, training on drawn rigs, and its way to another rig."""

from copy import copy

import numpy as np
import pandas as pd
import pytest
from driven import commands
from refusal import refused

from hydro_agents.controllers.flow_linearising import FlowLinearising, FlowLinearisingGains
from hydro_agents.learning import any_axis, rig_gains, tuning
from hydro_agents.learning.any_axis import AVERAGING_TIMES, PREVIEW_PACES, USUAL_ERROR, AnyAxisFeatures
from hydro_agents.learning.features import HISTORY_SIGNALS, PREVIEW_SCALE
from hydro_agents.learning.loading import load_controller
from hydro_agents.learning.policy import PolicyController
from hydro_agents.learning.progress import renew_rigs
from hydro_agents.learning.rig_gains import chosen_gains, gain_sets
from hydro_agents.learning.settings import PPOSettings
from hydro_agents.learning.training import make_axes, make_features, make_model, train_policy
from hydro_agents.learning.tuning import Tuned, costs_of_sets
from hydro_agents.learning.vec_env import AxisVecEnv, RigsVecEnv
from hydro_agents.running.cases import family_errors
from hydro_agents.running.folders import pretrained_folder
from hydro_env import ServoHydraulicVectorEnv, TaskConfig
from hydro_env.files import validate
from hydro_env.task.configuration import task_config
from hydro_env.task.drawn_rigs import rig_tasks
from hydro_env.task.paces import full_speed, pace, periods_per_step

TASK = TaskConfig(episode_duration=0.2)
LAW = {"count": 3, "preview_paces": []}
RIGS = rig_tasks(task_config(TASK, law=LAW | {"count": 6}))
SETTINGS = validate(
    PPOSettings,
    {
        "law": LAW,
        "normalise": True,
        "family_units": "sensor",
        "axes": 12,
        "steps_per_rollout": 16,
        "total_steps": 384,
        "minibatches": 2,
        "hidden_sizes": [8],
        "validation_every": 0,
    },
    "test",
)


def untuned(task):
    return FlowLinearising(FlowLinearisingGains(), task)


@pytest.fixture(autouse=True, scope="module")
def short_search():
    """Few cases and candidates for the choice and the search of gains."""
    all_sets = rig_gains.gain_sets
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(tuning, "REST", 1.6)
        patch.setattr(any_axis, "ERROR_PLANTS", 2)
        for name, size in (("NEARBY", 14), ("TRIALS", (1,)), ("CHOICE_CASES", 7), ("SEARCH_CASES", 7)):
            patch.setattr(rig_gains, name, size)
        for name, size in (("TRIAL_CASES", 14), ("RESTS", 6)):
            patch.setattr(rig_gains, name, size)
        patch.setattr(rig_gains, "gain_sets", lambda *rig: all_sets(*rig)[:3])
        yield


@pytest.fixture(scope="module")
def policy(tmp_path_factory):
    folder = tmp_path_factory.mktemp("any_axis")
    trained = train_policy(TASK, SETTINGS, untuned(TASK), seed=1, folder=folder)
    trained.save(folder / "policy")
    return folder, trained


def test_a_network_with_nothing_underneath_is_taught_on_drawn_rigs_and_moves_to_another(tmp_path):
    more = {"residual": False, "teacher": "ppo", "imitated_share": 1.0, "family_units": False}
    settings = validate(PPOSettings, SETTINGS.model_dump(mode="json") | more | {"total_steps": 1920}, "test")
    trained = train_policy(TASK, settings, seed=1, folder=tmp_path)
    miss = pd.read_csv(tmp_path / "progress.csv")["train/miss_of_teacher"]
    assert miss.iloc[-1] < miss.iloc[0]
    loaded = PolicyController.load(trained.save(tmp_path / "policy").with_suffix(""))
    here, there = (policy.moved_to(RIGS[4]) for policy in (trained, loaded))
    assert here.features.base is None
    assert commands(here, RIGS[4], 3) == pytest.approx(commands(there, RIGS[4], 3))
    assert np.ptp(commands(here, RIGS[4], 3)) > 0.0


def test_inputs_have_the_same_number_on_every_rig():
    without = [task for task in RIGS if not task.sensors.spool_position.fitted]
    assert 0 < len(without) < len(RIGS)
    assert len({AnyAxisFeatures(task, untuned(task)).size for task in (TASK, *RIGS)}) == 1


@pytest.mark.parametrize("task", [TASK, *RIGS[:3]])
def test_the_preview_is_that_of_the_reference_some_paces_ahead(task):
    """A ramp is as far ahead as its speed takes it, up to the horizon; a change of the reference counts per pace."""
    features = AnyAxisFeatures(task, untuned(task))
    speed = 0.2 * full_speed(task.plant)
    env = ServoHydraulicVectorEnv(1, task, info=False, sensors={"enabled": False})
    ramp = speed * task.control_period * np.arange(task.steps + 400)
    observation, _ = env.reset(seed=0, options={"reference": np.minimum(ramp, 0.02)})
    inputs, state = features(observation, None, None)
    observation, *_ = env.step([[0.0]])
    inputs, _ = features(observation, state, None)
    ahead = inputs[0, len(HISTORY_SIGNALS) :][: len(PREVIEW_PACES) + 1] * PREVIEW_SCALE
    horizon = task.preview_samples[-1] * task.control_period
    times = np.minimum(np.array(PREVIEW_PACES) * pace(task), horizon)
    np.testing.assert_allclose(ahead, [*(speed * times), speed * pace(task)], rtol=1e-3, atol=2e-6)


def test_a_correction_is_in_proportion_to_the_error_that_the_rig_allows():
    task = RIGS[0]
    sizes = [
        AnyAxisFeatures(task, untuned(task), 0.2, error=USUAL_ERROR * f).residual_scale for f in (1e-3, 0.5, 1, 99)
    ]
    assert sizes == pytest.approx([0.02, 0.1, 0.2, 0.6])


def test_a_simulation_chooses_the_gains_that_the_policy_corrects(policy):
    assert len(gain_sets("flow_linearising", RIGS[0])) == 9
    sets = rig_gains.gain_sets("flow_linearising", RIGS[0])
    assert sets[0] == FlowLinearisingGains()
    chosen = chosen_gains("flow_linearising", RIGS[0])
    costs = list(costs_of_sets("flow_linearising", sets, [RIGS[0]], rig_gains.CHOICE_CASES, 0)["costs"])
    clearly = min(costs) < 0.9 * costs[0]
    assert sets.index(chosen) == (int(np.argmin(costs)) if clearly else 0)
    assert policy[1].moved_to(RIGS[0], chosen_gains).features.base.gains == chosen


def test_a_search_counts_where_its_candidates_are_better_on_other_cases(monkeypatch):
    good, task = FlowLinearisingGains(), RIGS[1]
    slow = good.model_copy(update={"position_gain": 0.2 * good.position_gain})
    for known, found in ((slow, good), (good, slow)):
        monkeypatch.setattr(rig_gains, "gain_sets", lambda *_, known=known: [known, known])
        monkeypatch.setattr(rig_gains, "chosen_gains", lambda *_, known=known: known)
        monkeypatch.setattr(rig_gains, "tune", lambda *_, progress, found=found, **__: progress(Tuned(found, None, 0)))
        assert rig_gains.gains_by_search("flow_linearising", task) == good


def test_a_search_asks_what_its_nameplates_may_not_tell():
    """A load that bends, and sharp edges that let the same flow pass at the null; each only where the rig lacks it."""
    bare = task_config(TASK, plant={"valve": {"underlap": 0.02}})
    rig, bending, sharp = rig_gains.neighbours(bare)
    assert rig == bare
    assert (bending.plant.structure.tip, sharp.plant.structure.sharp_edges) == (True, True)
    lap = -sharp.plant.valve.overlap
    assert lap / (1.0 + lap) == pytest.approx(0.5 * 0.02)  # opening of each edge at the null, in parts of full stroke
    assert len(rig_gains.neighbours(bending)) == len(rig_gains.neighbours(sharp)) == 2


def test_a_training_may_begin_with_weights_and_teach_its_critic_first(policy, tmp_path):
    folder, first = policy
    more = {"start": str(folder / "policy"), "critic_first": 0.9, "total_steps": 192}
    waits = train_policy(TASK, SETTINGS.model_copy(update=more), untuned(TASK), seed=2)
    for mine, his in zip(waits.layers, first.layers, strict=True):
        assert np.array_equal(mine[0], his[0])
        assert np.array_equal(mine[1], his[1])
    learns = train_policy(TASK, SETTINGS.model_copy(update=more | {"critic_first": 0.0}), untuned(TASK), seed=2)
    moved = np.abs(learns.layers[0][0] - first.layers[0][0]).max()
    assert 0.0 < moved < 0.5 * np.abs(first.layers[0][0]).max()
    wider = SETTINGS.model_copy(update=more | {"hidden_sizes": (9,)})
    with refused("start: its weights have other inputs or layers"):
        train_policy(TASK, wider, untuned(TASK))


def test_an_untrained_policy_is_the_corrected_controller_on_every_rig(policy):
    zero = [(np.zeros_like(weight), np.zeros_like(bias)) for weight, bias in policy[1].layers]
    for task in RIGS[:2]:
        moved = PolicyController(policy[1].features, zero).moved_to(task, chosen_gains)
        corrected = FlowLinearising(chosen_gains("flow_linearising", task), task)
        np.testing.assert_array_equal(commands(moved, task), commands(corrected, task))


def test_stored_weights_serve_another_rig(policy, monkeypatch):
    monkeypatch.delattr(np.linalg, "eigh")  # which eigenvectors it finds depends on the processor
    folder, trained = policy
    task = RIGS[2]
    stored = PolicyController.load(folder / "policy")
    np.testing.assert_array_equal(commands(stored, TASK), commands(trained, TASK))
    moved = trained.moved_to(task)
    assert not np.array_equal(commands(moved, task), commands(untuned(task), task))
    np.testing.assert_array_equal(
        commands(load_controller(folder / "policy", task, "mine"), task), commands(moved, task)
    )
    moved.save(folder / "own")
    np.testing.assert_array_equal(commands(PolicyController.load(folder / "own"), task), commands(moved, task))


def test_training_continues_bit_for_bit(policy, tmp_path):
    options = {"base": untuned(TASK), "seed": 1, "folder": tmp_path}

    def stop(progress):
        if progress.steps >= 384:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        train_policy(TASK, SETTINGS, **options, progress=stop)
    again = train_policy(TASK, SETTINGS, **options, resume=True)
    for (weight, bias), (same, also) in zip(again.layers, policy[1].layers, strict=True):
        np.testing.assert_array_equal(weight, same)
        np.testing.assert_array_equal(bias, also)
    with refused("was made with other settings"):
        train_policy(TASK, SETTINGS.model_copy(update={"axes": 24}), **options, resume=True)


def test_a_share_of_the_correction_acts_after_the_training(policy, tmp_path):
    weaker = copy(policy[1])
    weaker.features = policy[1].features.applied(0.5)
    weaker.save(tmp_path / "weaker")
    stored = PolicyController.load(tmp_path / "weaker")
    whole, half = (commands(each.moved_to(RIGS[0], chosen_gains), RIGS[0]) for each in (policy[1], stored))
    own = commands(policy[1].moved_to(RIGS[0], chosen_gains).features.base, RIGS[0])
    np.testing.assert_allclose(half[0] - own[0], 0.5 * (whole[0] - own[0]), atol=1e-6)
    assert np.abs(whole[0] - own[0]).max() > 1e-6


def test_each_rig_has_its_axes_rewards_and_discount():
    features = make_features(TASK, SETTINGS, untuned(TASK))
    env = make_axes(TASK, SETTINGS, features, 0)
    assert isinstance(env, RigsVecEnv)
    periods = env.periods_per_step()
    assert len(np.unique(periods)) == 3
    weights = [part.env.config.reward.tracking for part in env.envs]
    np.testing.assert_allclose(weights, TASK.reward.tracking / periods[::4])
    model = make_model(env, SETTINGS, 0)
    renew_rigs(model, SETTINGS, 0.0)
    np.testing.assert_allclose(model.rollout_buffer.gamma**periods, SETTINGS.discount)
    inputs = env.reset()
    assert inputs.shape == (12, features.size)
    env.step_async(np.zeros((12, 1)))
    inputs, rewards, done, infos = env.step_wait()
    assert (inputs.shape, rewards.shape, done.shape, len(infos)) == ((12, features.size), (12,), (12,), 12)
    assert not np.array_equal(inputs[:4], inputs[4:8])
    state = env.get_state()
    after = [env.step_async(np.ones((12, 1))), env.step_wait()][1][0]
    env.set_state(state)
    env.step_async(np.ones((12, 1)))
    np.testing.assert_array_equal(env.step_wait()[0], after)
    env.close()


ALONE = {"residual": False, "teacher": "flow_linearising", "imitated_share": 0.5, "family_units": "sensor"}


def test_rigs_give_way_to_the_next_and_a_resumed_training_goes_on_with_them(policy, tmp_path, monkeypatch):
    more = ALONE | {"law": LAW | {"count": 7}, "rigs_together": 3}
    settings = validate(PPOSettings, SETTINGS.model_dump(mode="json") | more, "test")
    seen, renew = [], RigsVecEnv.renew

    def watched(env, first):
        renewed = renew(env, first)
        seen.append((first, [part.env.config.plant for part in env.envs]))
        return renewed

    monkeypatch.setattr(RigsVecEnv, "renew", watched)
    whole = train_policy(TASK, settings, seed=1, folder=tmp_path / "whole")
    assert [first for first, _ in seen] == [0, 2, 4]
    rigs = [task.plant for task in rig_tasks(task_config(TASK, law=more["law"]))]
    assert seen[1][1] == [rigs[3], rigs[4], rigs[2]]
    assert seen[2][1] == [rigs[6], rigs[4], rigs[5]]

    def interrupt(progress):
        if progress.steps > 192:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        train_policy(TASK, settings, seed=1, folder=tmp_path / "parts", progress=interrupt)
    resumed = train_policy(TASK, settings, seed=1, folder=tmp_path / "parts", resume=True)
    np.testing.assert_equal([bias for _, bias in resumed.layers], [bias for _, bias in whole.layers])
    with refused("rigs_together = 8: must not exceed law.count = 7"):
        validate(PPOSettings, settings.model_dump() | {"rigs_together": 8}, "test")
    with refused("law.split = test: nobody trains on test rigs"):
        validate(PPOSettings, settings.model_dump() | {"law": {"split": "test"}}, "test")
    with refused("total_steps = 100: .* are done already"):
        train_policy(TASK, settings.changed(total_steps=100), seed=1, folder=tmp_path / "parts", resume=True)


def test_a_resumed_training_makes_only_the_rigs_that_it_needs():
    made = []

    def make(number):
        made.append(number)
        return AxisVecEnv(TASK, 2)

    env = RigsVecEnv(make, 3, AnyAxisFeatures(TASK, None))
    places = [part.start for part, _ in env.renew(10)]
    assert (made, env.first) == ([0, 1, 2, 10, 11, 12], 10)
    assert sorted(places) == [0, 2, 4]
    assert env.renew(10) == []
    env.close()


def test_the_units_of_rewards_are_the_errors_of_the_policy_that_a_training_starts_with(tmp_path):
    settings = validate(PPOSettings, SETTINGS.model_dump(mode="json") | ALONE, "test")
    train_policy(TASK, settings, seed=1).save(tmp_path / "policy")
    settings = settings.model_copy(update={"start": str(tmp_path / "policy"), "axes": 3})
    env = make_axes(TASK, settings, make_features(TASK, settings, None), 0)
    student = PolicyController.load(tmp_path / "policy")
    for part, task in zip(env.envs, rig_tasks(task_config(TASK, law=LAW)), strict=True):
        student.features = part.features
        errors = family_errors(task, student, sensor_frame=True)
        scales = {name: error / task.reward.error_scale for name, error in errors.items()}
        assert part.env.config.reward.family_scale == pytest.approx(scales)
    env.close()


def test_a_policy_that_acts_alone_has_units_by_similarity_and_simulates_no_other_rig(monkeypatch):
    here = AnyAxisFeatures(TASK, None).normalised()
    monkeypatch.setattr(any_axis, "family_errors", None)
    monkeypatch.setattr("hydro_agents.learning.features.ServoHydraulicVectorEnv", None)

    def units(features, name):
        """Of the signal now and of its change in the last step of the history, SI."""
        place, scale = HISTORY_SIGNALS.index(name), features.layout.scale[features.layout.index(name)]
        latest = features.moving - len(features.lags) * len(HISTORY_SIGNALS) + place
        return scale * features.normalisation.unit[[place, latest]]

    for task in RIGS[:3]:
        there = here.moved_to(task)
        speeds, paces = full_speed(task.plant) / full_speed(TASK.plant), pace(task) / pace(TASK)
        lags = there.lags[0] * task.control_period / (here.lags[0] * TASK.control_period)
        expected = {
            "position": (task.plant.cylinder.stroke / TASK.plant.cylinder.stroke, speeds * lags),
            "velocity_estimate": 2 * (speeds,),
            "pressure_b": 2 * (task.plant.supply.pressure / TASK.plant.supply.pressure,),
            "tracking_error": 2 * (speeds * paces,),
            "previous_command": (1.0, 1.0),
        }
        for name, ratio in expected.items():
            assert units(there, name) / units(here, name) == pytest.approx(ratio, rel=1e-5), name


def test_a_policy_that_acts_alone_remembers_slow_averages_by_direction():
    features, task = AnyAxisFeatures(RIGS[0], None), RIGS[0]
    rest = np.zeros((2, len(features.layout.names)), np.float32)
    moves = rest.copy()
    columns = [features.layout.index(name) for name in ("tracking_error", "spool_position", "velocity_estimate")]
    moves[:, columns] = [[0.02, 0.3, 0.5], [-0.02, -0.3, 0.1]]
    _, state = features(rest, None, None)
    for _ in range(7):
        inputs, state = features(moves, state, None)
    last = features.moving - len(features.lags) * len(HISTORY_SIGNALS)
    averages = inputs[:, last - 15 : last].reshape(2, 3, 5)
    share = 1.0 - (1.0 - 1.0 / (1.0 + periods_per_step(task) * np.array(AVERAGING_TIMES))) ** 7
    whole = np.array([[0.02, 0.3, 0.0, 0.5, 0.0], [-0.02, 0.0, -0.3, 0.0, 0.1]])
    np.testing.assert_allclose(averages, share[:, None] * whole[:, None], rtol=1e-5)
    inputs, _ = features(moves, state, np.array([True, False]))  # begins again
    np.testing.assert_allclose(inputs[0, last - 15 : last].reshape(3, 5), np.tile(whole[0], (3, 1)), rtol=1e-6)


def test_what_cannot_be_is_refused(policy):
    with refused("axes = 13: must be a multiple of law.count = 3"):
        validate(PPOSettings, SETTINGS.model_dump() | {"axes": 13, "minibatches": 1}, "test")
    with refused("moved_to: must be a policy for any axis"):
        PolicyController.load(pretrained_folder() / "policy").moved_to(RIGS[0])
    blind = task_config(TASK, sensors={"pressure_a": {"fitted": False}})
    with refused("flow linearisation: reads pressure_a"):
        policy[1].moved_to(blind)
