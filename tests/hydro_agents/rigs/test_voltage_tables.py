"""Tables of voltages: what is understood, and what is refused rather than misread."""

import pytest

from hydro_agents.rigs.simulation import read_voltage
from hydro_env import ConfigurationError


def voltages(tmp_path, text):
    (tmp_path / "a.csv").write_text(text, encoding="utf-8")
    return read_voltage(tmp_path / "a.csv").tolist()


@pytest.mark.parametrize(
    ("text", "values"),
    [
        ("1\n2.5\n-3e-1\n", [1, 2.5, -0.3]),
        ("voltage [V],time\n0,0\n1,5\n", [0, 1]),
        ("0.1,5\n0.2,6\n", [5, 6]),
        ("0,001;1,5\n0,002;-2\n", [1.5, -2]),
        ("t [s];v [V]\n0.001;1.5\n", [1.5]),
        ("v\tt\n1,5\t2\n", [2]),
        ("# rig 3\n\nv\n1\n\n2\n", [1, 2]),
        ("\ufeffv\r\n1\r\n", [1]),
        ('v\n"0,5"\n', [0.5]),
    ],
)
def test_tables_are_understood(tmp_path, text, values):
    assert voltages(tmp_path, text) == values


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("0,5\n1,000\n", r"row 1: '0,5' may be 2 columns or decimals with a comma"),
        ("v\n0,5\n", r"is not a table of numbers: .*Expected 1 fields"),
        ("0,001,1,5\n", r"row 1: '0,001,1,5' may be 4 columns"),
        ("0.5,1\n0.5\n", r"row 2: .* is not a number"),
        ("a;b\n1;1.5\n1;1,5\n", r"commas in some rows and points in others"),
        ("1;1.000,5\n", r"commas in some rows|not a number"),
        ("v\n1\nabc\n", r"row 3: 'abc' is not a number"),
        ("v\n1_000\n", r"'1_000' is not a number"),
        ("v\nnan\n", r"'nan' is not a number"),
        ("v\n1e999\n", r"'1e999' is not a number"),
        ("v\n٣\n", r"is not a number"),
        ("", "is not a table"),
        ("# nothing\n", "is not a table"),
        ("voltage\n", "holds no numbers"),
        ("v\n\x001\n", "is not a"),
        ("v\n1\n11\n", "row 3: 11 V: must be within -10 to 10 V"),
        ('v\n"1\n2a', "is not a"),
    ],
)
def test_tables_are_refused_rather_than_misread(tmp_path, text, message):
    with pytest.raises(ConfigurationError, match=message) as caught:
        voltages(tmp_path, text)
    assert "\n" not in str(caught.value)
    assert str(caught.value).startswith(f"{tmp_path / 'a.csv'}: ")
