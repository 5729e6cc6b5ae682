"""The exported leakage head answers as the one in Python; wrong answers are refused."""

import hashlib
import json

import numpy as np
import pytest

from hydro_agents.detection.head import LeakageHead
from hydro_agents.running.folders import pretrained_folder
from hydro_env import HydroError
from hydro_rig.export.c_files import c_compiler, compared
from hydro_rig.export.leakage_head import ESTIMATES, FILES, LARGEST_DIFFERENCE, exported_head


@pytest.fixture(scope="module")
def head_export():
    pytest.importorskip("onnxruntime")
    return exported_head(LeakageHead.load(pretrained_folder() / "leakage_head"), "hydro export leakage_head")


def test_c_and_network_give_the_answers_of_python(head_export):
    files, report = head_export
    assert set(files) == set(FILES)
    checked = json.loads(files["contract.json"])["checked"]
    assert checked["leakage_head_network.onnx"]["largest_difference"] <= LARGEST_DIFFERENCE
    if c_compiler() is None:
        pytest.skip("this machine has no C compiler")
    assert f"{3 * ESTIMATES} estimates" in report[1]


def test_the_vectors_hold_a_leak_that_is_found_lost_samples_and_a_sensor_that_stands_still(head_export):
    rows = np.genfromtxt(head_export[0]["vectors.csv"].decode().splitlines(), delimiter=",", names=True)
    per_episode = len(rows) // 3
    ends = rows[per_episode - 1 :: per_episode]
    assert ends["probability"][0] < 0.5 < ends["probability"][1]
    assert ends["outside"][2] == ends["sensor_fault"][2] == 1.0
    assert np.isnan(rows["position"]).sum() == 3
    assert np.isnan(rows["probability"][:399]).all()
    assert not np.isnan(rows["probability"][399])


def test_the_contract_names_signals_answers_and_files(head_export):
    files, _ = head_export
    contract = json.loads(files["contract.json"])
    assert [signal["unit"] for signal in contract["signals"]] == ["m", "Pa", "Pa", "1", "1"]
    assert contract["window"] == 400
    assert contract["outputs"]["flow_lpm"].endswith("l/min at 100 bar")
    for name, digest in contract["files"].items():
        assert hashlib.sha256(files[name]).hexdigest() == digest


def test_wrong_answers_are_refused(head_export):
    if c_compiler() is None:
        pytest.skip("this machine has no C compiler")
    texts = {name: content.decode() for name, content in head_export[0].items() if not name.endswith(".onnx")}
    wrong = texts["leakage_head.c"].replace("* scale[i];", "* scale[i] * 1.001;")
    assert wrong != texts["leakage_head.c"]
    with pytest.raises(HydroError, match="differs from the leakage head in Python"):
        compared("leakage_head", {**texts, "leakage_head.c": wrong})
