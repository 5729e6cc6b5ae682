"""From the recording of a hidden rig to the rig that was found, and recordings that contradict the rig."""

import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import yaml
from command_line import assert_one_clear_line, hydro
from recorded import SEED, recorded_file
from refusal import refused

from hydro_env import PlantParameters, ServoHydraulicVectorEnv
from hydro_env.task.configuration import task_config
from hydro_env.task.randomisation import own_value
from hydro_env.task.rig import read_rig
from hydro_rig.identification.identification_page import identify_to_folder
from hydro_rig.identification.identify import identify

RANGES = {
    "load.mass": {"uniform": [40.0, 80.0]},
    "valve.rated_flow": {"factor": [0.9, 1.1]},
    "load.viscous_damping": {"factor": [0.3, 2.5]},
    "supply.pressure": {"uniform": [6.0e6, 1.0e7]},
}
DURATION, LEAK = 4.0, 0.5


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A rig file with ranges, and the recording of a rig that is drawn from them."""
    folder = tmp_path_factory.mktemp("identify")
    (folder / "rig.yaml").write_text(yaml.safe_dump({"load": {"mass": 60.0}, "randomisation": RANGES}))
    recorded_file(folder / "a.csv", hidden(folder), LEAK, family="multi_sine", duration=DURATION)
    return folder


def hidden(folder):
    """The task of the hidden rig: what the rig file gives no range is known."""
    return task_config("as_given", rig=folder / "rig.yaml", randomisation=RANGES, episode_duration=DURATION)


def identified(folder, name, recording, *options):
    out = folder / name
    return out, hydro("identify", recording, "--rig", folder / "rig.yaml", "--output", out, *options)


@pytest.fixture(scope="module")
def found(folder):
    rig = read_rig(folder / "rig.yaml")
    return identify([folder / "a.csv"], task_config(None, rig=rig.source), rig)


@pytest.fixture(scope="module")
def done(folder, found):
    """The folder of the result, and its last line."""
    return folder / "out", identify_to_folder(folder / "out", found, False, "hydro identify")[-1]


def truth(folder):
    env = ServoHydraulicVectorEnv(1, hidden(folder), info=False)
    env.reset(seed=[SEED], options={"leakage_flow_lpm": np.array([LEAK])})
    return {path: own_value(env.axes.parameters(0), path) for path in RANGES}


def assert_near(unknown, value, halves=2.0):
    """A value lies within some half intervals, four standard deviations, of an unknown of the result."""
    assert abs(2.0 * value - unknown["low"] - unknown["high"]) < halves * (unknown["high"] - unknown["low"]), unknown


def test_the_hidden_rig_is_found(folder, done):
    out, verdict = done
    assert "of the position's variance explained on the held-back part" in verdict
    assert {path.name for path in out.iterdir()} == {
        ".hydro.json", "identification.html", "identification.json", "rig.yaml",
    }  # fmt: skip
    result = json.loads((out / "identification.json").read_text(encoding="utf-8"))
    assert result["describes"]
    assert result["held_back"]["together"]["position_share_of_variance"] > 0.99
    for path, value in truth(folder).items() | {("leakage_flow_lpm", LEAK)}:
        assert result["unknowns"][path]["determined"]
        assert_near(result["unknowns"][path], value)


def test_the_new_rig_file_is_narrower_and_a_rig(folder, done):
    rig = read_rig(done[0] / "rig.yaml")
    before = PlantParameters()
    for path, given in RANGES.items():
        low, high = rig.randomisation[path].bounds(np.nan)
        wide = given.get("uniform") or [own_value(before, path) * end for end in given["factor"]]
        assert high - low < 0.5 * (wide[1] - wide[0]), path
        assert wide[0] <= low <= own_value(rig.plant, path) <= high <= wide[1]
    text = (done[0] / "rig.yaml").read_text(encoding="utf-8")  # for a person
    assert re.search(r"^  rated_flow: [\d.]+ l/min  # found$", text, re.MULTILINE)
    assert re.search(r"^  internal_resistance: .* Pa s/m³  # found: 0\.[45]\d* l/min at 100 bar$", text, re.MULTILINE)
    assert re.search(r"^  valve.rated_flow: {uniform: \[[\d.]+ l/min, [\d.]+ l/min\]}$", text, re.MULTILINE)
    assert rig.plant.load.spring_stiffness == before.load.spring_stiffness  # given no range: known
    task_config(None, rig=done[0] / "rig.yaml")


def test_nothing_is_overwritten(folder, done):
    assert (done[0] / "identification.html").stat().st_size > 0
    assert_one_clear_line(identified(folder, "out", folder / "a.csv")[1], "holds results already")


def test_recordings_with_their_own_sensors_share_the_unknowns(folder, tmp_path):
    """One file has pressure a, the other pressure b under another heading; a third one tests the fit."""
    families = {"one_a": ("multi_sine", "b"), "two_b": ("sine", "a"), "test_a": ("ramp", "b")}
    for name, (family, absent) in families.items():
        recorded_file(tmp_path / f"{name}.csv", hidden(folder), LEAK, family=family, duration=DURATION)
        table = pd.read_csv(tmp_path / f"{name}.csv", comment="#")
        table = table.drop(columns=[f"pressure_{absent} [bar]", "spool_position [%]"])
        table.rename(columns={"pressure_b [bar]": "PT2 [bar]"}).to_csv(tmp_path / f"{name}.csv", index=False)
    (tmp_path / "b.yaml").write_text("{time: time, command: command, position: position, pressure_b: PT2}")
    files = [tmp_path / f"{name}.csv" for name in families]
    options = ["--map", f"*_b.csv={tmp_path / 'b.yaml'}", "--hold-back", "test_*", "--output", tmp_path / "out"]
    answer = hydro("identify", *files, "--rig", folder / "rig.yaml", *options)
    assert answer.returncode == 0, answer.stderr
    result = json.loads((tmp_path / "out" / "identification.json").read_text(encoding="utf-8"))
    assert [Path(part["recording"]).name for part in result["held_back"]["parts"]] == ["test_a.csv"]
    assert result["held_back"]["parts"][0]["position_rms"] < 1e-3
    assert result["held_back"]["parts"][0]["pressure_b_rms"] is None
    assert {"pressure_a_bias", "pressure_b_bias"} < set(result["unknowns"])
    for path, value in truth(folder).items():
        assert_near(result["unknowns"][path], value, 3.0)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--hold-back", "*_b*"], "--hold-back: '*_b*' matches none of the recordings, such as a.csv"),
        (["--hold-back", "*.csv"], "matches every recording"),
        (["--map", "x.yaml", "--map", "y.yaml"], "several maps need patterns"),
        (["--map", "b*=x.yaml"], "'b*' matches none of the recordings"),
        (["a.csv", "a.csv"], "a.csv: is given twice"),
    ],
)
def test_patterns_that_match_nothing_are_refused(folder, options, words):
    answer = identified(folder, "nothing", folder / "a.csv", *options)[1]
    assert answer.returncode == 2
    assert_one_clear_line(answer, words)


A, B, POSITION, COMMAND = "pressure_a [bar]", "pressure_b [bar]", "position [mm]", "command [V]"
CONTRADICTIONS = {
    "chambers exchanged": lambda table: {A: table[B], B: table[A]},
    "other sign of the position": lambda table: {POSITION: -table[POSITION]},
    "reads? at most|do not fit|times": lambda table: {A: 0.1 * table[A], B: 0.1 * table[B]},
    "moves against the command": lambda table: {COMMAND: -table[COMMAND]},
    "command is at its limit": lambda table: {
        COMMAND: 10.0, "spool_position [%]": 100.0 + np.sin(np.arange(len(table)))
    },
}  # fmt: skip


@pytest.mark.parametrize("words", CONTRADICTIONS)
def test_a_recording_that_contradicts_the_rig_is_named_in_one_line(folder, tmp_path, words):
    table = pd.read_csv(folder / "a.csv", comment="#")
    table.assign(**CONTRADICTIONS[words](table)).to_csv(tmp_path / "a.csv", index=False)
    out, answer = identified(folder, "refused", tmp_path / "a.csv")
    assert answer.returncode == 2, answer.stdout
    assert_one_clear_line(answer)
    assert re.search(words, answer.stderr)
    assert not out.exists()


def test_another_machine_gets_a_page_and_no_rig(folder, found):
    """The model explains no window, and says nothing about the motion of the held-back part."""
    fit = found.fit._replace(misfit=np.full(len(found.fit.misfit), 9.0))
    held_back = [part._replace(simulated=np.zeros_like(part.simulated)) for part in found.held_back]
    with refused("does not describe this axis"):
        identify_to_folder(folder / "other", replace(found, fit=fit, held_back=held_back), False, "hydro identify")
    assert (folder / "other" / "identification.html").exists()
    assert not (folder / "other" / "rig.yaml").exists()


def test_a_load_pressure_of_unknown_gain_stands_for_two_pressures(folder, tmp_path):
    gain, offset = 1.08, 1.5  # bar
    table = pd.read_csv(folder / "a.csv", comment="#")
    table["Delta P [bar]"] = (gain * (table[A] - table[B]) + offset).round(4)
    table.drop(columns=[A, B, "spool_position [%]"]).to_csv(tmp_path / "load.csv", index=False)
    names = {"time": "time", "command": "command", "position": "position", "load_pressure": "Delta P"}
    (tmp_path / "map.yaml").write_text(yaml.safe_dump(names))
    sensors = {"pressure_a": {"low": "-100 bar", "high": "100 bar", "bias": "3 bar"}, "pressure_b": {"fitted": False}}
    sensors["differential_pressure"] = True
    rig = yaml.safe_load((folder / "rig.yaml").read_text()) | {"sensors": sensors}
    (tmp_path / "rig.yaml").write_text(yaml.safe_dump(rig))
    given = [tmp_path / "load.csv", "--map", tmp_path / "map.yaml", "--output"]
    answer = hydro("identify", "--rig", tmp_path / "rig.yaml", *given, tmp_path / "out")
    assert answer.returncode == 0, answer.stderr
    result = json.loads((tmp_path / "out" / "identification.json").read_text(encoding="utf-8"))
    assert result["describes"]
    assert result["held_back"]["together"]["pressure_a_share_of_variance"] > 0.88
    wanted = truth(folder) | {"pressure_a_gain": gain, "leakage_flow_lpm": LEAK}
    for path, value in wanted.items():
        assert_near(result["unknowns"][path], value)
    assert "differential_pressure: true" in (tmp_path / "out" / "rig.yaml").read_text(encoding="utf-8")
    wrong = hydro("identify", "--rig", folder / "rig.yaml", *given, tmp_path / "wrong")
    assert_one_clear_line(wrong, "load pressure", "differential_pressure: false")
    with refused("for recordings"):
        ServoHydraulicVectorEnv(2, task_config(None, rig=tmp_path / "rig.yaml"))
