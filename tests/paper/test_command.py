"""``python -m paper``: the files, the page, wrong use."""

import re
from importlib import import_module

import pandas as pd
import pytest
from browser import problems_everywhere
from refusal import refused

from hydro_env.task.sensors import Sensors
from paper import run as command
from paper.moves import displacement_table


def test_every_figure_has_picture_and_table(folder):
    keys = sorted(path.stem for path in folder.glob("*.png"))
    assert keys == sorted(entry.key for entry in command.FIGURES)
    for key in keys:
        assert (folder / f"{key}.png").read_bytes().startswith(b"\x89PNG")
        assert "<svg" in (folder / f"{key}.svg").read_text(encoding="utf-8")
        table = pd.read_csv(folder / f"{key}.csv")
        assert len(table) > 3
        assert table.notna().any().all()


def test_the_page_shows_every_figure_and_needs_nothing_else(folder):
    page = (folder / "page.html").read_text(encoding="utf-8")
    assert page.count('role="img"') == len(list(folder.glob("*.svg")))
    assert "nan" not in re.sub(r"<[^>]*>", " ", page).split()
    assert not re.search(r"""src\s*=|@import|<script|<link""", page)


def test_nothing_is_cut_off_in_a_browser(browser, folder):
    assert problems_everywhere(browser, folder / "page.html") == []


def test_a_folder_with_results_is_kept_unless_told(folder):
    with refused("--overwrite"):
        command.reproduce_to_folder(folder, overwrite=False)


def test_recorded_displacement_has_the_noise_of_the_sensor():
    table = displacement_table()
    error = 1e-3 * (table["recorded_position_mm"] - table["true_position_mm"])
    assert error.std() == pytest.approx(Sensors().position.noise, rel=0.1)
    assert abs(error.mean()) <= Sensors().position.bias
    travel = table[table["friction"]].groupby("leak_lpm")["true_position_mm"].max()
    assert travel.is_monotonic_decreasing


def test_every_equation_has_a_function_that_exists(folder):
    table = pd.read_csv(folder / "equations.csv")
    assert list(table["equation"]) == [f"({number})" for number in range(1, 25)]
    assert list(table.columns) == ["equation", "meaning", "functions", "correction"]
    assert table.notna().all(axis=None)
    for names in table["functions"]:
        for name in names.split(", "):
            module, _, function = name.rpartition(".")
            assert callable(getattr(import_module(module), function)), name
