"""The leakage head learns, round-trips, waits for a whole window, and works under any controller."""

import json

import numpy as np
import pytest

from agents.controllers import PID, ObservationLayout, PIDGains
from agents.leakage.head import SIGNALS, LeakageHead, MonitoredController
from agents.leakage.metrics import area_under_roc
from agents.leakage.training import HeadTrainingSettings, make_dataset, train_head
from agents.running.seeds import TRAINING_SEEDS
from hydro_env import ConfigurationError, ServoHydraulicVectorEnv, TaskConfig

CONFIG = TaskConfig(episode_duration=0.4)
LAYOUT = ObservationLayout.of(CONFIG)
CONTROLLER = PID(PIDGains(proportional=60.0), LAYOUT)
SETTINGS = HeadTrainingSettings(
    episodes=1000, validation_episodes=200, epochs=10, batch=64, width=16, torch_threads=1, highest_flow=4.0
)


@pytest.fixture(scope="module")
def head():
    return train_head(CONFIG, [CONTROLLER], SETTINGS)


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
    with pytest.raises(ConfigurationError, match="other signals"):
        LeakageHead.load(tmp_path / "head")


@pytest.mark.parametrize(
    ("field", "value", "message"),
    [
        ("threshold", -0.2, "threshold = -0.2: must be a probability, within 0 to 1"),
        ("threshold", float("nan"), "threshold = nan: must be a probability"),
        ("window", -3, "window = -3 observations: must be within 1 to"),
        ("window", 0, "window = 0 observations"),
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


def test_interrupted_training_resumes_to_the_same_head(head, tmp_path):
    def interrupt(phase, done, total, loss):
        if phase == "training" and done == 2:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        train_head(CONFIG, [CONTROLLER], SETTINGS, progress=interrupt, folder=tmp_path)
    assert json.loads((tmp_path / "head_checkpoint.json").read_text())["epoch"] == 2
    resumed = train_head(CONFIG, [CONTROLLER], SETTINGS, folder=tmp_path, resume=True)
    for name, value in head.network.state_dict().items():
        np.testing.assert_allclose(resumed.network.state_dict()[name], value, rtol=1e-4, atol=1e-6)
    other = SETTINGS.model_copy(update={"width": 8})
    with pytest.raises(ConfigurationError, match="another seed, settings or task"):
        train_head(CONFIG, [CONTROLLER], other, folder=tmp_path, resume=True)
