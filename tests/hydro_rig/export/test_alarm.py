"""The exported alarm: its C code says the same as Python, bit by bit; own heads and alarms leave Python too."""

import pytest
import yaml
from command_line import assert_one_clear_line, hydro
from untrained import untrained_head

from hydro_agents.detection.alarm import AlarmSettings
from hydro_env import HydroError, TaskConfig
from hydro_rig.export.alarm import EPISODES, FILES, LOOKS, exported_alarm
from hydro_rig.export.c_files import c_compiler, compared

SCALES = {
    "standing": {"highest_baseline": 0.03, "learning": 0, "spread": 0.03, "shift": 0.06},
    "slow": {"highest_baseline": 0.02, "learning": 5, "spread": 0.01, "shift": 0.05},
    "moving": {"highest_baseline": 0.015, "learning": 30, "spread": 0.005, "shift": 0.02},
}
SETTINGS = AlarmSettings(scales=SCALES, threshold=8.0)


@pytest.fixture(scope="module")
def alarm_export():
    return exported_alarm(SETTINGS, "hydro export alarm")


@pytest.mark.skipif(c_compiler() is None, reason="no C compiler")
def test_the_c_code_equals_python_bit_by_bit(alarm_export):
    files, report = alarm_export
    assert set(files) == set(FILES)
    assert report[0].startswith(f"alarm.c: {EPISODES * LOOKS} looks, ")
    assert report[0].endswith(", 0 different")
    texts = {name: content.decode() for name, content in files.items()}
    wrong = texts["alarm.c"].replace("0.015", "0.0150000001")
    assert wrong != texts["alarm.c"]
    with pytest.raises(HydroError, match="differs from the alarm in Python"):
        compared("alarm", {**texts, "alarm.c": wrong})


def test_the_vectors_hold_alarms_resets_and_named_causes(alarm_export):
    rows = [line.split(",") for line in alarm_export[0]["vectors.csv"].decode().splitlines()]
    columns = {name: [float(row[place]) for row in rows[1:]] for place, name in enumerate(rows[0])}
    assert set(columns["action"]) == {0.0, 1.0, 2.0}
    assert 100 < sum(columns["now_alarm"]) < len(rows) - 100
    assert set(columns["activity"]) == {0.0, 1.0, 2.0}
    assert set(columns["now_learnt"]) == {0.0, 1.0}
    assert max(columns["now_cause"]) > 1.0


def test_own_alarm_and_own_head_are_exported(tmp_path):
    SETTINGS.save(tmp_path / "alarm.yaml")
    hydro("export", tmp_path / "alarm.yaml", "--output", tmp_path / "alarm")
    assert {each.name for each in (tmp_path / "alarm").iterdir()} >= set(FILES)
    assert "0.015" in (tmp_path / "alarm" / "alarm.c").read_text()
    head = untrained_head(TaskConfig(episode_duration=0.5))
    head.save(tmp_path / "study" / "leakage_head")
    hydro("export", tmp_path / "study" / "leakage_head", "--output", tmp_path / "head")
    assert (tmp_path / "head" / "leakage_head.c").is_file()
    refused = hydro("export", tmp_path / "study" / "leakage_head", "--period", "2ms", "--output", tmp_path / "x")
    assert_one_clear_line(refused, "was trained for another rig or period")


def test_a_broken_alarm_is_refused_with_one_line(tmp_path):
    values = SETTINGS.model_dump(mode="json") | {"threshold": -1.0}
    (tmp_path / "alarm.yaml").write_text(yaml.safe_dump(values))
    answer = hydro("export", tmp_path / "alarm.yaml", "--output", tmp_path / "out")
    assert_one_clear_line(answer, "alarm.yaml", "threshold = -1")
    assert not (tmp_path / "out").exists()
