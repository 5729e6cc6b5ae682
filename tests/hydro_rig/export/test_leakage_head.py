"""The exported leakage head answers as the one in Python; wrong answers are refused."""

import numpy as np
import pytest
from command_line import assert_one_clear_line, hydro
from structured_text import FunctionBlock
from untrained import untrained_head

from hydro_agents.detection.alarm import AlarmSettings, LeakAlarm
from hydro_agents.detection.balance import ITERATIONS
from hydro_agents.detection.detector import SIGNALS, Reading
from hydro_agents.detection.head import LeakageHead
from hydro_agents.running.folders import pretrained_folder
from hydro_env import HydroError, TaskConfig
from hydro_env.folders import config_folder
from hydro_rig.export.c_files import c_compiler, compared
from hydro_rig.export.leakage_head import ESTIMATES, FIELDS, FILES, exported_head, head_code, head_vectors


@pytest.fixture(scope="module")
def head_export():
    return exported_head(LeakageHead.load(pretrained_folder() / "leakage_head"), "hydro export leakage_head")


def test_the_c_code_gives_the_answers_of_python(head_export):
    files, report = head_export
    assert set(files) == set(FILES)
    if c_compiler() is None:
        pytest.skip("this machine has no C compiler")
    assert f"{3 * ESTIMATES} estimates" in report[0]


def test_the_vectors_hold_a_leak_that_is_found_lost_samples_and_a_sensor_that_stands_still(head_export):
    rows = np.genfromtxt(head_export[0]["vectors.csv"].decode().splitlines(), delimiter=",", names=True)
    per_episode = len(rows) // 3
    ends = rows[per_episode - 1 :: per_episode]
    assert ends["probability"][0] < 0.5 < ends["probability"][1]
    assert ends["outside"][2] == ends["sensor_fault"][2] == 1.0
    assert np.isnan(rows["position"]).sum() == 3
    assert np.isnan(rows["probability"][:399]).all()
    assert not np.isnan(rows["probability"][399])


@pytest.fixture(scope="module")
def short():
    """An untrained head for windows of 0.3 s, and the texts of its two function blocks."""
    head = untrained_head(TaskConfig(episode_duration=0.3))
    return head, *head_code(head)["leakage_head.st"].split("(* Call it after the head")


def test_structured_text_gives_the_answers_of_python_some_calls_later(short):
    head, text, _ = short
    signals = head_vectors(head)[0][-1, -head.settings.window :]  # some are lost
    for stuck in (False, True):
        if stuck:
            signals[-25:, 1] = signals[-1, 1]
        block, found = FunctionBlock(text), []
        for row in [*signals, *[signals[-1]] * (ITERATIONS + 3)]:
            valid = {f"valid_{name}": bool(np.isfinite(value)) for name, value in zip(SIGNALS, row, strict=True)}
            found.append(block({"enable": True, **valid, **dict(zip(SIGNALS, row.tolist(), strict=True))}))
        assert [one["fresh"] for one in found].count(True) == 1
        expected = np.ravel(head.estimate_windows(signals.T[None]))
        np.testing.assert_allclose([found[-1][name] for name in FIELDS], expected, atol=1e-4)
        assert (found[-1]["sensor_fault"] == 1.0) == stuck


def test_the_alarm_in_structured_text_is_that_of_python(short):
    alarm, block = LeakAlarm(AlarmSettings.load(config_folder() / "agents" / "alarm.yaml")), FunctionBlock(short[2])
    state, generator, calls = alarm.begin(1), np.random.default_rng(5), round(alarm.settings.interval / 0.005)
    assert not any(block({"fresh": True, "valid": True, "activity": 2, "flow_lpm": 9.0})["sum"] for _ in range(calls))
    for look in range(300):
        activity, sigma, valid = int(generator.integers(3)), max(generator.uniform(-0.02, 0.02), 0.0), look % 5 > 0
        flow = generator.normal(0.02, 0.01) + 1e-4 * look
        state = alarm.update(Reading.of([flow], 0 if valid else 7, sigma=sigma), np.array([activity]), state)
        block.memory["waited"] = calls
        found = block({"flow_lpm": flow, "sigma": sigma, "activity": activity, "valid": valid})
        assert found == {"alarm": state.alarm[0], "sum": pytest.approx(state.total[0], abs=1e-9)}
        assert look > 40 or not found["alarm"]
    assert found["alarm"]
    assert block({"acknowledge": True}) == {"alarm": False, "sum": 0.0}


def test_wrong_answers_are_refused(head_export):
    if c_compiler() is None:
        pytest.skip("this machine has no C compiler")
    texts = {name: content.decode() for name, content in head_export[0].items()}
    wrong = texts["leakage_head.c"].replace("* scale[i];", "* scale[i] * 1.001;")
    assert wrong != texts["leakage_head.c"]
    with pytest.raises(HydroError, match="differs from the leakage head in Python"):
        compared("leakage_head", {**texts, "leakage_head.c": wrong})


def test_an_own_head_is_exported_for_the_rig_of_its_training_alone(tmp_path):
    head = untrained_head(TaskConfig(episode_duration=0.5))
    head.save(tmp_path / "study" / "leakage_head")
    hydro("export", tmp_path / "study" / "leakage_head", "--output", tmp_path / "head")
    assert f"after {head.settings.window} samples" in (tmp_path / "head" / "README.md").read_text()
    refused = hydro("export", tmp_path / "study" / "leakage_head", "--period", "2ms", "--output", tmp_path / "x")
    assert_one_clear_line(refused, "was trained for another rig or period")
