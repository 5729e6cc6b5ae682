"""``python -m hydro_env``: an axis as text."""

import re

from hydro_env.__main__ import WIDTH, show_axis


def test_an_axis_is_drawn_as_text_where_it_is(capsys):
    show_axis()
    lines = [line for line in capsys.readouterr().out.splitlines() if "|" in line]
    assert len(lines) == 25
    for line in lines:
        cells, error = re.fullmatch(r"\d\.\d\d s \|([.#+]+)\| error +(-?\d+\.\d\d) mm", line).groups()
        assert len(cells) == WIDTH
        apart = cells.index("+") - cells.index("#") if "+" in cells else 0
        assert abs(apart * 400.0 / (WIDTH - 1) - float(error)) < 400.0 / (WIDTH - 1)
