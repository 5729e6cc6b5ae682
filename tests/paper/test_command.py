"""``python -m paper``, run once with fewer leaks where they cost seconds: files, page, trends, verdicts, wrong use."""

import re
from functools import partial
from importlib import import_module
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from browser import problems_everywhere

from paper import run as command
from paper.rig import LAWS
from paper.settling import settling_table

KEPT = Path(__file__).parents[2] / "docs" / "tables" / "verdicts.csv"
QUICK = {"fig13_settling_time": partial(settling_table, leaks=(0.01, 1.0, 4.0))}


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    path = tmp_path_factory.mktemp("reproduce") / "new"
    quick = {key: entry._replace(compute=QUICK.get(key, entry.compute)) for key, entry in command.FIGURES.items()}
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(command, "FIGURES", quick)
        command.reproduce_to_folder(path, overwrite=False)
    return path


def test_every_figure_has_picture_and_table(folder):
    keys = sorted(path.stem for path in folder.glob("*.png"))
    assert keys == sorted(command.FIGURES)
    for key in keys:
        assert (folder / f"{key}.png").read_bytes().startswith(b"\x89PNG")
        table = pd.read_csv(folder / f"{key}.csv")
        assert len(table) > 3
        assert table.notna().any().all()


def test_the_page_shows_every_figure_and_needs_nothing_else(folder):
    page = (folder / "page.html").read_text(encoding="utf-8")
    assert page.count('role="img"') == len(list(folder.glob("*.png")))
    assert "nan" not in re.sub(r"<[^>]*>", " ", page).split()
    assert not re.search(r"""src\s*=|@import|<script|<link""", page)


def test_nothing_is_cut_off_in_a_browser(browser, folder):
    assert problems_everywhere(browser, folder / "page.html") == []


def test_every_equation_has_a_function_that_exists(folder):
    table = pd.read_csv(folder / "equations.csv")
    assert list(table["equation"]) == [f"({number})" for number in range(1, 25)]
    assert list(table.columns) == ["equation", "meaning", "functions", "correction"]
    assert table.notna().all(axis=None)
    for names in table["functions"]:
        for name in names.split(", "):
            module, _, function = name.rpartition(".")
            assert callable(getattr(import_module(module), function)), name


@pytest.fixture(scope="module")
def table(folder):
    return pd.read_csv(folder / "fig13_settling_time.csv", keep_default_na=False, na_values=[""])


def picked(table, law, friction="none", underlap=False):
    return table[
        (table["law"] == law) & (table["friction"] == friction) & (table["valve_null_leakage"] == underlap)
    ].sort_values("leak_lpm")


@pytest.mark.parametrize("underlap", [False, True])
@pytest.mark.parametrize("law", list(LAWS))
def test_settling_time_falls_with_the_leak(table, law, underlap):
    part = picked(table, law, underlap=underlap)
    assert len(part) == 3
    assert np.all(np.diff(part["clean_s"]) < 0.0)
    assert part["clean_s"].iloc[0] > 5.0 * part["clean_s"].iloc[-1]


def test_linear_theory_holds_for_the_laminar_law_without_friction(table):
    part = picked(table, "laminar")
    assert part["theory_s"].to_numpy() == pytest.approx(part["clean_s"].to_numpy(), rel=0.03)
    assert table[table["friction"] != "none"]["theory_s"].isna().all()


def test_friction_hides_the_trend(table):
    part = picked(table, "laminar", friction="stribeck", underlap=True)
    assert part["clean_s"].iloc[0] < 1.5 * part["clean_s"].iloc[-1]


def test_the_command_writes_what_the_documentation_shows(folder):
    """The figures of this test have fewer leaks than those of the documentation; the verdicts are the same."""
    written, kept = (
        pd.read_csv(file, comment="#")[["conclusion", "verdict"]] for file in (folder / "verdicts.csv", KEPT)
    )
    pd.testing.assert_frame_equal(written, kept)
    page = (folder / "page.html").read_text(encoding="utf-8")
    assert all(conclusion in page for conclusion in kept["conclusion"])
