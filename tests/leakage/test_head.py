"""The leakage head learns, round-trips, waits for a whole window, and works under any controller."""

import json
import time

import numpy as np
import pytest
import torch

from agents.controllers import PID, ObservationLayout, PIDGains
from agents.leakage.head import SHORTEST_WINDOW, SIGNALS, LeakageHead, LeakageNetwork, MonitoredController, channels
from agents.leakage.metrics import area_under_roc
from agents.leakage.training import (
    CHECKPOINT_FILE,
    KIND,
    HeadTrainingSettings,
    loss_of,
    make_dataset,
    targets,
    train_head,
)
from agents.running.seeds import TRAINING_SEEDS
from agents.running.weights import load_checkpoint, save_checkpoint
from hydro_env import ConfigurationError, ServoHydraulicVectorEnv, TaskConfig
from hydro_env.files import validate

CONFIG = TaskConfig(episode_duration=0.4)
LAYOUT = ObservationLayout.of(CONFIG)
CONTROLLER = PID(PIDGains(proportional=60.0), CONFIG)
SETTINGS = HeadTrainingSettings(
    episodes=1000, validation_episodes=200, epochs=10, batch=64, width=16, torch_threads=1, highest_flow=4.0
)


@pytest.fixture(scope="module")
def head():
    return train_head(CONFIG, [CONTROLLER], SETTINGS)


SMALL = SETTINGS.model_copy(update={"episodes": 200, "validation_episodes": 100, "epochs": 3})


@pytest.fixture(scope="module")
def small_head():
    return train_head(CONFIG, [CONTROLLER], SMALL)


def test_learns_to_tell_severe_leaks(head):
    data = make_dataset(CONFIG, [CONTROLLER], SETTINGS, 300, TRAINING_SEEDS.start + 900_000)
    kept = (data.flow_lpm <= 0.03) | (data.flow_lpm >= 1.0)
    estimate = head.estimate_signals(data.signals[kept])
    assert area_under_roc(estimate.probability, data.flow_lpm[kept] >= 1.0) > 0.8
    assert np.corrcoef(np.log(estimate.flow_lpm), np.log(data.flow_lpm[kept]))[0, 1] > 0.4


def test_training_data_is_reproducible_and_labelled():
    first, second = (make_dataset(CONFIG, [CONTROLLER], SETTINGS, 120, 5) for _ in range(2))
    np.testing.assert_array_equal(first.signals, second.signals)
    assert first.signals.shape == (120, len(SIGNALS), CONFIG.steps)
    healthy = first.flow_lpm <= 0.03
    assert 0.3 < healthy.mean() < 0.7
    assert first.flow_lpm[~healthy].min() >= 0.1


def test_round_trip(head, tmp_path):
    head.save(tmp_path / "head")
    again = LeakageHead.load(tmp_path / "head.json")
    history = np.random.default_rng(0).standard_normal((5, CONFIG.steps, len(LAYOUT.names))).astype(np.float32)
    for a, b in zip(head.estimate(history), again.estimate(history), strict=True):
        np.testing.assert_array_equal(a, b)
    assert again.settings.threshold == head.settings.threshold
    with pytest.raises(ConfigurationError, match=r"history has shape \(3, 3\)"):
        head.estimate(np.zeros((3, 3)))
    stored = json.loads((tmp_path / "head.json").read_text())
    (tmp_path / "head.json").write_text(json.dumps(stored | {"signals": ["flow"]}))
    with pytest.raises(ConfigurationError, match="other signals than"):
        LeakageHead.load(tmp_path / "head")


@pytest.mark.parametrize(
    ("field", "value", "message"),
    [
        ("threshold", -0.2, "threshold = -0.2: must be a number within 0 to 1"),
        ("threshold", float("nan"), "threshold = nan: must be a number within 0 to 1"),
        ("threshold", "high", "threshold = 'high': must be a number"),
        ("window", -3, "window = -3: must be a whole number within 56"),
        ("window", 10**30, "window: must be a whole number within 56"),
        ("width", 8, "width = 8: its tensors are of another network"),
        ("observation_scale", [], "observation_scale must hold one number other than zero per name"),
        ("observation_names", ["reference_preview_soonms"] * 13, "a preview must say how far it looks"),
        ("observation_names", ["position"] * 13, "the observation holds no 'pressure_a'"),
        ("training", None, "training: must be a group of settings"),
    ],
)
def test_impossible_settings_of_a_file_are_refused_with_one_line(head, tmp_path, field, value, message):
    head.save(tmp_path / "head")
    file = tmp_path / "head.json"
    file.write_text(json.dumps(json.loads(file.read_text()) | {field: value}))
    with pytest.raises(ConfigurationError, match=message) as caught:
        LeakageHead.load(tmp_path / "head")
    assert len(str(caught.value).splitlines()) == 1


def test_monitor_acts_as_its_controller_and_waits_for_a_window(head):
    env = ServoHydraulicVectorEnv(3, CONFIG, autoreset_mode="SameStep")
    observation, _ = env.reset(seed=0)
    monitored = MonitoredController(CONTROLLER, head)
    memory, plain, rows = None, None, []
    for step in range(CONFIG.steps):
        rows.append(observation)
        action, memory = monitored.predict(observation, memory)
        expected, plain = CONTROLLER.predict(observation, plain)
        np.testing.assert_array_equal(action, expected)
        if step < CONFIG.steps - 1:
            assert np.isnan(monitored.estimate(memory).probability).all()
            observation, *_ = env.step(action)
    found = monitored.estimate(memory)
    expected = head.estimate(np.stack(rows, axis=1))
    np.testing.assert_allclose(found.probability, expected.probability, rtol=1e-5)
    assert ((found.probability > 0) & (found.probability < 1)).all()
    _, memory = monitored.predict(observation, memory, np.array([True, False, False]))
    assert np.isnan(monitored.estimate(memory).probability).tolist() == [True, False, False]


def test_predict_watches_with_the_signature_of_a_controller(head):
    rows = np.random.default_rng(0).standard_normal((CONFIG.steps, 2, len(LAYOUT.names))).astype(np.float32)
    state, alone = None, None
    for step, row in enumerate(rows):
        found, state = head.predict(row, state)
        single, alone = head.predict(row[1], alone)
        assert np.isnan(found).all() == (step < CONFIG.steps - 1)
    assert found.shape == (2, 2)
    assert single.shape == (2,)
    np.testing.assert_allclose(single, found[1], rtol=1e-4)
    np.testing.assert_allclose(found, np.column_stack(head.estimate(rows.transpose(1, 0, 2))), rtol=1e-4)


def test_interrupted_training_resumes_to_the_same_head(small_head, tmp_path):
    def interrupt(phase, done, total, loss):
        if phase == "training" and done == 2:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        train_head(CONFIG, [CONTROLLER], SMALL, progress=interrupt, folder=tmp_path)
    tensors, stored = load_checkpoint(tmp_path / CHECKPOINT_FILE, KIND)
    assert stored["epoch"] == 2
    resumed = train_head(CONFIG, [CONTROLLER], SMALL, folder=tmp_path, resume=True)
    for name, value in small_head.network.state_dict().items():
        np.testing.assert_array_equal(resumed.network.state_dict()[name], value)
    assert resumed.settings.threshold == small_head.settings.threshold
    other = SMALL.model_copy(update={"width": 8})
    with pytest.raises(ConfigurationError, match="another seed, settings or task"):
        train_head(CONFIG, [CONTROLLER], other, folder=tmp_path, resume=True)
    save_checkpoint(tmp_path / CHECKPOINT_FILE, KIND, tensors, stored)
    with pytest.raises(ConfigurationError, match="episodes of other controllers"):
        train_head(CONFIG, [PID(PIDGains(), CONFIG)], SMALL, folder=tmp_path, resume=True)
    for change in ({"epoch": 99}, {"epoch": "2"}, {"data": 5}):
        save_checkpoint(tmp_path / CHECKPOINT_FILE, KIND, tensors, stored | change)
        with pytest.raises(ConfigurationError, match="damaged: epoch"):
            train_head(CONFIG, [CONTROLLER], SMALL, folder=tmp_path, resume=True)


def test_inputs_of_the_network_are_normalised_on_training_data():
    began = time.monotonic()
    head = train_head(CONFIG, [CONTROLLER], SMALL.model_copy(update={"epochs": 1}), seed=4)
    assert 0.0 < head.settings.training["seconds"] <= time.monotonic() - began + 0.1
    first = TRAINING_SEEDS.start + len(TRAINING_SEEDS) // 2 + 4 * SMALL.episodes
    data = make_dataset(CONFIG, [CONTROLLER], SMALL, SMALL.episodes, first)
    inputs = (channels(torch.from_numpy(data.signals.astype(np.float32))) - head.network.mean) * head.network.scale
    np.testing.assert_allclose(inputs.mean(dim=(0, 2)), 0.0, atol=1e-3)
    spread = inputs.std(dim=(0, 2)).numpy()
    assert np.all((np.abs(spread - 1.0) < 0.02) | (spread < 1e-3))  # a signal that never changes has no spread


def test_a_training_that_is_stopped_while_it_simulates_can_be_resumed(small_head, tmp_path):
    def interrupt(phase, done, total, loss):
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        train_head(CONFIG, [CONTROLLER], SMALL, progress=interrupt, folder=tmp_path)
    assert load_checkpoint(tmp_path / CHECKPOINT_FILE, KIND)[1]["epoch"] == 0
    resumed = train_head(CONFIG, [CONTROLLER], SMALL, folder=tmp_path, resume=True)
    np.testing.assert_array_equal(
        resumed.network.output[0].weight.detach(), small_head.network.output[0].weight.detach()
    )


def test_leaks_to_train_on_must_suit_the_task():
    for change, message in (
        ({"lowest_healthy_flow": 5.0}, r"lowest_healthy_flow = 5: must be below the task's leakage.class_bounds\[0\]"),
        ({"lowest_healthy_flow": 0.03}, "lowest_healthy_flow = 0.03"),
        ({"highest_flow": 0.1}, "highest_flow = 0.1: must be above"),
    ):
        with pytest.raises(ConfigurationError, match=message):
            train_head(CONFIG, [CONTROLLER], SETTINGS.model_copy(update=change))
    with pytest.raises(ConfigurationError, match="an episode of 55 control periods is its window: must have at least"):
        SETTINGS.check(TaskConfig(episode_duration=0.275))
    SETTINGS.check(TaskConfig(episode_duration=0.28))


def test_the_shortest_window_can_be_judged():
    network = LeakageNetwork(4)
    assert network(torch.zeros(1, len(SIGNALS), SHORTEST_WINDOW)).shape == (1, 2)
    with pytest.raises(RuntimeError, match="Kernel size"):
        network(torch.zeros(1, len(SIGNALS), SHORTEST_WINDOW - 1))


def test_sizes_below_the_healthy_bound_are_not_asked_for():
    label, size = targets(np.array([0.003, 0.03, 0.1, 1.0]), 0.03)
    assert label.tolist() == [0.0, 0.0, 1.0, 1.0]
    np.testing.assert_allclose(size, np.log10([0.03, 0.03, 0.1, 1.0]), rtol=1e-6)


def test_loss_by_hand():
    output = torch.tensor([[0.0, 0.2], [2.0, -1.0]])
    label, size = torch.tensor([1.0, 0.0]), torch.tensor([0.0, 0.0])
    crossing = (np.log(2.0) + np.log(1.0 + np.exp(2.0))) / 2
    huber = (0.5 * 0.2**2 + 0.3 * (1.0 - 0.5 * 0.3)) / 2
    assert float(loss_of(output, label, size, 3.0)) == pytest.approx(crossing + 3.0 * huber, rel=1e-6)


def test_learning_rate_follows_the_share_of_all_batches(monkeypatch):
    plain, shares = HeadTrainingSettings.learning_rate_at, []
    monkeypatch.setattr(
        *(HeadTrainingSettings, "learning_rate_at"),
        lambda self, share: shares.append(share) or plain(self, share),
    )
    seen = []
    train_head(CONFIG, [CONTROLLER], SMALL, progress=lambda *now: seen.append(now))
    batches = 3 * 4  # 200 episodes in batches of 64, the last one smaller
    np.testing.assert_allclose(shares, np.arange(batches) / batches)
    assert [now[:3] for now in seen if now[0] == "training"] == [("training", epoch, 3) for epoch in (1, 2, 3)]
    assert [now[1:3] for now in seen if now[0] == "data"] == [(200, 200)]


def test_learning_rate_rises_and_falls():
    settings = HeadTrainingSettings(learning_rate=0.01)
    rates = [settings.learning_rate_at(share) for share in np.linspace(0.0, 1.0, 101)]
    assert rates[0] == rates[-1] == pytest.approx(1e-5)
    assert rates[5] == pytest.approx(0.01 * 0.5 * (1 + np.cos(0.05 * np.pi)))
    assert np.all(np.diff(rates[:6]) > 0)
    assert np.all(np.diff(rates[5:98]) < 0)
    assert rates[50] == pytest.approx(0.005)


@pytest.mark.parametrize("field", ["learning_rate", "weight_decay", "size_weight", "highest_flow"])
def test_infinite_settings_are_refused(field):
    with pytest.raises(ConfigurationError, match=f"{field} = inf"):
        validate(HeadTrainingSettings, {field: float("inf")}, "head.yaml")


def test_a_state_that_was_given_is_never_changed(head):
    rows = np.random.default_rng(0).standard_normal((CONFIG.steps + 3, 2, len(LAYOUT.names))).astype(np.float32)
    state, states, answers = None, [], []
    for row in rows:
        answer, after = head.predict(row, state, np.array([True, False]))
        states.append(state)
        answers.append(answer)
        state = after
    assert np.isnan(answers[-1][0]).all()  # its episode starts at every step
    assert np.isfinite(answers[-1][1]).all()
    for row, before, answer in zip(rows, states, answers, strict=True):
        np.testing.assert_array_equal(head.predict(row, before, np.array([True, False]))[0], answer)
