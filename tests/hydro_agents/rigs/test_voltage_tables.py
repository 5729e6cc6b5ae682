"""Tables of numbers: what is understood, and what is refused rather than misread."""

import numpy as np
import pytest

from hydro_agents.rigs.simulation import read_table
from hydro_env import ConfigurationError


def table(tmp_path, text):
    (tmp_path / "a.csv").write_text(text, encoding="utf-8")
    return read_table(tmp_path / "a.csv")


@pytest.mark.parametrize(
    ("text", "names", "values"),
    [
        ("1\n2.5\n-3e-1\n", (), [[1], [2.5], [-0.3]]),
        ("time,voltage\n0,0\n1,5\n", ("time", "voltage"), [[0, 0], [1, 5]]),
        ("0.1,5\n0.2,6\n", (), [[0.1, 5], [0.2, 6]]),
        ("0,001;1,5\n0,002;-2\n", (), [[0.001, 1.5], [0.002, -2]]),
        ("t [s];v [V]\n0.001;1.5\n", ("t [s]", "v [V]"), [[0.001, 1.5]]),
        ("t\tv\n1,5\t2\n", ("t", "v"), [[1.5, 2]]),
        ("# rig 3\n\nv\n1\n\n2\n", ("v",), [[1], [2]]),
        ("\ufeffv\r\n1\r\n", ("v",), [[1]]),
        ('v\n"0,5"\n', ("v",), [[0.5]]),
    ],
)
def test_tables_are_understood(tmp_path, text, names, values):
    found = table(tmp_path, text)
    assert found.names == names
    assert np.array_equal(found.values, values)


def test_lines_are_those_of_the_file(tmp_path):
    assert table(tmp_path, "# made by hand\nv\n\n1\n2\n").lines.tolist() == [4, 5]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("0,5\n1,000\n", r"line 1: '0,5' may be 2 columns or decimals with a comma"),
        ("v\n0,5\n", r"line 2 has 2 columns, line 1 has 1; if commas separate columns, decimals need a point"),
        ("0,001,1,5\n", r"line 1: '0,001,1,5' may be 4 columns"),
        ("0.5,1\n0.5\n", r"line 2 has 1 columns, line 1 has 2"),
        ("a;b\n1.5;2\n1,5;2\n", r"line 2: '1.5' has a decimal point, other lines have commas"),
        ("1.000,5;1\n", r"line 1: '1.000,5' is not a number"),
        ("v\n1\nabc\n", r"line 3: 'abc' is not a number"),
        ("v\n1\n\n1_000\n", r"line 4: '1_000' is not a number"),
        ("v\nnan\n", r"line 2: 'nan' is not a number"),
        ("v\n1e999\n", r"line 2: '1e999' is not a number"),
        ("v\n٣\n", r"is not a number"),
        ("v\n1,\n", r"line 2 has 2 columns"),
        ("", "holds no numbers"),
        ("# nothing\n", "holds no numbers"),
        ("voltage\n", "holds no numbers"),
        ("v\n\x001\n", "is not a"),
        ("v\n" + "9" * 200_000, "is not a"),
        ('v\n"1\n2a', "is not a"),
    ],
)
def test_tables_are_refused_rather_than_misread(tmp_path, text, message):
    with pytest.raises(ConfigurationError, match=message) as caught:
        table(tmp_path, text)
    assert "\n" not in str(caught.value)
    assert str(caught.value).startswith(f"{tmp_path / 'a.csv'}: ")
    assert len(str(caught.value)) < len(str(tmp_path)) + 200
