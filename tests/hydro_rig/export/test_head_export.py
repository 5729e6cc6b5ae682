"""The exported leakage head answers as the one in Python; what has no translation is refused."""

import hashlib
import json

import numpy as np
import pytest

from hydro_agents.detection.head import LeakageHead
from hydro_agents.running.folders import pretrained_folder
from hydro_env import HydroError
from hydro_env.compiling import inline
from hydro_rig.export.c_files import c_compiler, compared
from hydro_rig.export.expressions import DOUBLE, INT, UINT64, TranslationError, array
from hydro_rig.export.leakage_head import ESTIMATES, FILES, LARGEST_DIFFERENCE, exported_head
from hydro_rig.export.translator import Translator


@pytest.fixture(scope="module")
def exported():
    pytest.importorskip("onnxruntime")
    return exported_head(LeakageHead.load(pretrained_folder() / "leakage_head"), "hydro export leakage_head")


def test_c_and_network_give_the_answers_of_python(exported):
    files, report = exported
    assert set(files) == set(FILES)
    checked = json.loads(files["contract.json"])["checked"]
    assert checked["leakage_head_network.onnx"]["largest_difference"] <= LARGEST_DIFFERENCE
    if c_compiler() is None:
        pytest.skip("this machine has no C compiler")
    assert f"{3 * ESTIMATES} estimates" in report[1]


def test_the_vectors_hold_a_leak_that_is_found_lost_samples_and_a_sensor_that_stands_still(exported):
    rows = np.genfromtxt(exported[0]["vectors.csv"].decode().splitlines(), delimiter=",", names=True)
    per_episode = len(rows) // 3
    ends = rows[per_episode - 1 :: per_episode]
    assert ends["probability"][0] < 0.5 < ends["probability"][1]
    assert ends["outside"][2] == ends["sensor_fault"][2] == 1.0
    assert np.isnan(rows["position"]).sum() == 3
    assert np.isnan(rows["probability"][:399]).all()
    assert not np.isnan(rows["probability"][399])


def test_the_contract_names_signals_answers_and_files(exported):
    files, _ = exported
    contract = json.loads(files["contract.json"])
    assert [signal["unit"] for signal in contract["signals"]] == ["m", "Pa", "Pa", "1", "1"]
    assert contract["window"] == 400
    assert contract["outputs"]["flow_lpm"].endswith("l/min at 100 bar")
    for name, digest in contract["files"].items():
        assert hashlib.sha256(files[name]).hexdigest() == digest


def test_wrong_answers_are_refused(exported, monkeypatch):
    if c_compiler() is None:
        pytest.skip("this machine has no C compiler")
    texts = {name: content.decode() for name, content in exported[0].items() if not name.endswith(".onnx")}
    wrong = texts["leakage_head.c"].replace("* scale[i];", "* scale[i] * 1.001;")
    assert wrong != texts["leakage_head.c"]
    with pytest.raises(HydroError, match="differs from the leakage head in Python"):
        compared("leakage_head", {**texts, "leakage_head.c": wrong})


def test_arrays_loops_and_integers_are_translated():
    @inline
    def scaled(matrix, factors, row):
        row[:] = 0.0
        count = row.shape[0]
        for i in range(1, count):
            for j in range(matrix.shape[1]):
                row[i] += factors[j] * matrix[i, j]
        row[count // 2] = max(count, 2) / 2

    translator = Translator()
    translator.function(scaled, [array(4, 3), array(3, element="const double"), array(4)])
    text = translator.functions[0]
    assert "static void scaled(double *matrix, const double *factors, double *row)" in text
    assert "row[i] = (row[i] + (factors[j] * matrix[3 * i + j]));" in text
    assert "((double)(2 > 4 ? 2 : 4) / 2)" in text


def test_what_could_be_translated_wrongly_is_refused():
    @inline
    def negative_step(row):
        for i in range(3, 0, -1):
            row[i] = 0.0

    @inline
    def by_number(row, place):
        return row[place]

    @inline
    def part(row):
        return row[1:3]

    for function, types in (
        (negative_step, [array(4)]),
        (by_number, [array(4), DOUBLE]),
        (by_number, [array(4), UINT64]),
        (part, [array(4)]),
    ):
        with pytest.raises(TranslationError, match="no translation for"):
            Translator().function(function, types)
    Translator().function(by_number, [array(4), INT])
