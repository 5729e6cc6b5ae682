"""The exported leakage head answers as the one in Python; wrong answers are refused."""

import numpy as np
import pytest
from command_line import assert_one_clear_line, hydro
from untrained import untrained_head

from hydro_agents.detection.head import LeakageHead
from hydro_agents.running.folders import pretrained_folder
from hydro_env import HydroError, TaskConfig
from hydro_rig.export.c_files import c_compiler, compared
from hydro_rig.export.leakage_head import ESTIMATES, FILES, exported_head


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
