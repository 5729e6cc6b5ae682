"""Sections: which names a list may hold, what a page leaves out, and where figures of its blocks stand."""

import pandas as pd
import pytest

from hydro_agents.report.canvas import curve_plot, make_plot
from hydro_agents.report.content import Content
from hydro_agents.report.leakage import LEAKAGE
from hydro_agents.report.palette import Look
from hydro_agents.report.robustness import ROBUSTNESS
from hydro_agents.report.sections import (
    Fold,
    Text,
    plots_of,
    render_page,
    section,
    sections_named,
)
from hydro_agents.running.text import Cell, Table, frame_markdown, markdown
from hydro_env import ConfigurationError


def plot(key):
    return make_plot(key, key, "", key, lambda figure: figure.subplots().plot([0.0, 1.0], [0.0, 1.0]))


@pytest.mark.parametrize("drawn", ["points", "rows"])
def test_points_without_intervals_stand_at_their_values(drawn):
    seen = []
    looks = {"PID": Look("#123456", "o", "-")}
    curve_plot("x", "X", "", {"PID": pd.Series([3.0, 7.0], ["a", "b"])}, looks, "", seen.append, drawn=drawn)
    (line,) = seen[0].lines
    shown = line.get_xdata() if drawn == "rows" else line.get_ydata()
    assert list(shown) == [3.0, 7.0]


def test_every_page_names_registered_sections_and_two_pages_share_some():
    lists = [ROBUSTNESS, LEAKAGE]
    assert [[part.name for part in sections_named(names)] for names in lists] == [list(names) for names in lists]


def test_a_wrong_name_is_refused_in_one_line():
    for name, words in (
        ("standstil", "unknown section 'standstil'; did you mean standstill?"),
        ("costs", "section 'costs' occurs 2 times"),
    ):
        with pytest.raises(ConfigurationError) as refused:
            sections_named(["costs", name], "my.yaml: sections")
        assert str(refused.value).startswith(f"my.yaml: sections: {words}")


def test_a_section_without_its_table_or_without_blocks_is_left_out(monkeypatch):
    monkeypatch.setattr("hydro_agents.report.sections.SECTIONS", {})

    @section("Shown", needs=("numbers",))
    def shown(content):
        return [Text("here", "soft")]

    @section("Empty")
    def empty(content):
        return []

    def page(numbers):
        return render_page("Mine", ["shown", "empty"], Content({"numbers": pd.DataFrame(numbers)})).html

    assert '<section id="shown">\n<h2>Shown</h2>\n<p class="soft">here</p>' in page({"a": [1]})
    assert "<section" not in page({"a": []})


def test_figures_in_folded_parts_become_files_too():
    one, two, three = (plot(key) for key in ("one", "two", "three"))
    assert plots_of([one, two, Text("between"), Fold("more", [three])]) == [one, two, three]


def test_a_table_shows_colours_groups_and_reasons():
    rows = [("first", Cell("0.5", "better", 40, "0.4 to 0.6", strong=True)), ("second", "–")]
    table = Table("Ratios", ("Condition", "PPO"), rows, breaks={0: "Leak"}, style="heat")

    @section("Table")
    def table_alone(content):
        return [table]

    page = render_page("Mine", ["table_alone"], Content({})).html
    assert '<td title="0.4 to 0.6" class="better" style="--share:40%"><b>0.5</b></td>' in page
    assert '<th scope="rowgroup" colspan="2" class="group">Leak</th>' in page
    assert "<td>–</td>" in page


def test_markdown_aligns_numbers_and_keeps_bars():
    assert markdown(["a|b", "mm"], [["x", "1"]]) == "| a\\|b | mm |\n|---|---:|\n| x | 1 |"
    frame = pd.DataFrame({"mm": [0.5]}, index=pd.Index(["PID"], name="controller"))
    assert frame_markdown(frame, 2) == "| controller | mm |\n|---|---:|\n| PID | 0.50 |"
