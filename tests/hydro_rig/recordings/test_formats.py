"""MAT files with stamps of each channel, and damaged files."""

import numpy as np
import pytest
import scipy.io
from optional_libraries import library
from refusal import refused

from hydro_env import ConfigurationError
from hydro_rig.recordings.columns import read_map
from hydro_rig.recordings.recording import read_recording

TIME = np.arange(200) * 0.005
POSITION, COMMAND = 40.0 * np.sin(3.0 * TIME), np.cos(5.0 * TIME)  # mm, V


def write_structs(path, position, command):
    """A MAT file with a struct per channel, (unit, stamps, values), as different programs write them."""
    (unit, time, values), (volts, stamps, commands) = position, command
    structs = {
        "position": {"Unit": unit, "Time": time, "Data": values},
        "command": {"unit": volts, "time": stamps, "signals": {"values": commands, "dimensions": 1.0}},
        "note": "text",
        "other": np.arange(7.0),
    }
    scipy.io.savemat(path, structs)


def test_channels_as_fast_as_the_command_are_interpolated_and_told(tmp_path):
    own = np.arange(0.0025, 0.9, 0.005)  # it begins later, ends earlier, and has a gap
    own = own[(own < 0.4) | (own > 0.5)]
    values = 100.0 * own  # mm; a line, which linear interpolation meets exactly
    write_structs(tmp_path / "a.mat", position=("mm", own, values), command=("V", TIME, COMMAND))
    found = read_recording(tmp_path / "a.mat")
    np.testing.assert_allclose(found.time, TIME)
    np.testing.assert_allclose(found.signals[4], 0.1 * COMMAND, rtol=1e-6)
    position = found.signals[0]
    known = np.isfinite(position)
    np.testing.assert_allclose(position[known], 0.1 * TIME[known], rtol=1e-9)
    assert not known[own[0] > TIME].any()
    assert not known[own[-1] < TIME].any()
    assert not known[(TIME > 0.401) & (TIME < 0.499)].any()
    assert known[(TIME > 0.01) & (TIME < 0.39)].all()
    assert [f.signal for f in found.findings if "its own time stamps, one every 5 ms" in f.line()] == ["position"]


def test_readings_of_a_slower_channel_stand_where_their_stamps_are(tmp_path):
    slow = ("mm", TIME[2::4] + 1e-4, POSITION[2::4])
    write_structs(tmp_path / "a.mat", position=slow, command=("V", TIME, COMMAND))
    found = read_recording(tmp_path / "a.mat")
    np.testing.assert_allclose(found.signals[0, 2::4], 1e-3 * POSITION[2::4], rtol=1e-6)
    assert np.isfinite(found.signals[0]).sum() == len(TIME[2::4])
    assert [f.signal for f in found.findings if "one every 20 ms; its readings stand" in f.line()] == ["position"]


MAP = "time: {column: t, unit: s}\nposition: {column: x, unit: mm}\ncommand: {column: u, unit: V}\n"


def test_vectors_of_unequal_length_are_told(tmp_path):
    scipy.io.savemat(tmp_path / "a.mat", {"t": TIME, "u": COMMAND, "x": np.arange(5.0)})
    (tmp_path / "map.yaml").write_text(MAP, encoding="utf-8")
    with refused("'x' has 5 values, that of the command has 200"):
        read_recording(tmp_path / "a.mat", read_map(tmp_path / "map.yaml"))


def test_a_damaged_file_is_told_in_one_line(tmp_path):
    library("pyarrow")
    path = tmp_path / "a.parquet"
    path.write_bytes(b"no such format" * 20)
    with pytest.raises(ConfigurationError) as error:
        read_recording(path)
    assert str(error.value).startswith(f"{path}: ")
    assert "\n" not in str(error.value)
    with refused("cannot be read"):
        read_recording(tmp_path / "none.parquet")
