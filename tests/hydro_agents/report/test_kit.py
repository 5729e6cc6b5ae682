"""The kit of all pages: cells are the frame's, texts are escaped, figures show the tables, one file for both themes."""

import re

import numpy as np
import pandas as pd
import pytest
from parsed_page import ODD_NAME, Parsed

from hydro_agents.report.kit import BLUE, GREEN, Page, draw, drawn, leak_axis, panel, panels, signal, with_interval
from hydro_agents.running.machine import Origin

TABLE = pd.DataFrame(
    {
        "controller": ["PID", "PID", ODD_NAME, ODD_NAME],
        "leak": [0.0, 4.0, 0.0, 4.0],
        "error": [0.5, 1.0, 0.25, 0.75],
        "error_low": [0.4, 0.9, 0.2, 0.5],
        "error_high": [0.6, 1.1, 0.3, np.nan],
    }
)


@drawn
def made():
    page = Page("Trial <one>")
    page.verdict(f"{ODD_NAME} is best", "good")
    page.heading("Errors")
    frame = TABLE.assign(text=with_interval(TABLE, "error")).set_index("controller")
    page.table(frame[["text", "leak", "error"]], "Errors <mm>", {"error": 1})
    with page.fold("More"):
        page.points(["a < b"])
        page.code("task: # <&>")
    for title in ("Error & leak", "The same"):
        axes = panel(ylabel="error, mm")
        draw(axes, TABLE, "leak", "error", ["PID", ODD_NAME])
        leak_axis(axes, TABLE["leak"])
        page.figure(axes, title)
    rows = panels(2)
    signal(rows[0], np.arange(9.0), np.arange(9.0), label="position")
    page.figure(rows, "Position over time, of a wide figure")
    return page


@pytest.fixture(scope="module")
def html():
    return made().html(Origin("hydro study <x>", "today", "0.2"))


def test_cells_are_those_of_the_frame_and_texts_are_escaped(html):
    found = Parsed(html)
    assert [row[1:] for row in found.rows] == [
        ["text", "leak", "error"],
        ["0.500 (0.400 to 0.600)", "0", "0.5"],
        ["1.00 (0.900 to 1.10)", "4.00", "1.0"],
        ["0.250 (0.200 to 0.300)", "0", "0.2"],
        ["0.750 (0.500 to –)", "4.00", "0.8"],
    ]
    assert found.rows[3][0] == ODD_NAME
    assert "<b>" not in html
    for text in ("Trial <one>", f"{ODD_NAME} is best", "Errors <mm>", "a < b", "# <&>", "hydro study <x>"):
        assert text in found.text


def test_the_page_stands_alone_and_its_figures_follow_the_theme(html):
    found = Parsed(html)
    for tag, attributes in found.attributes:
        assert tag not in ("link", "img", "iframe", "object", "base", "form", "script")
        assert not attributes.keys() & {"src", "srcset", "action", "onload"}
        for name in ("href", "xlink:href"):
            assert attributes.get(name, "#").startswith("#")
    assert "@import" not in html
    assert set(re.findall(r"https?://[^\"' ]*", html)) <= {"http://www.w3.org/2000/svg", "http://www.w3.org/1999/xlink"}
    ids = [attributes["id"] for _, attributes in found.attributes if "id" in attributes]
    assert len(ids) == len(set(ids))
    assert set(re.findall(r'(?:href="#|url\(#)([^")]+)', html)) <= set(ids)
    figures = re.findall(r'<svg[^>]*role="img" aria-label="([^"]*)".*?</svg>', html, flags=re.DOTALL)
    assert figures == ["Error &amp; leak", "The same", "Position over time, of a wide figure"]
    assert not re.search(r"#[0-9a-f]{6}\b", "".join(re.findall(r"<svg.*?</svg>", html, flags=re.DOTALL)))


@drawn
def test_a_figure_shows_the_table_and_a_participant_keeps_its_colour():
    axes = panel()
    draw(axes, TABLE[TABLE["controller"] == "PID"], "leak", "error", ["none", "other", "PID"], factor=10.0)
    (container,) = [each for each in axes.containers if not each.get_label().startswith("_")]
    line, _, (bars,) = container.lines
    np.testing.assert_array_equal(line.get_xydata(), [[0.0, 5.0], [4.0, 10.0]])
    np.testing.assert_allclose([part[:, 1] for part in bars.get_segments()], [[4.0, 6.0], [9.0, 11.0]])
    assert line.get_color() == GREEN
    rows = panel()
    draw(rows, TABLE.assign(leak=["b", "a", "b", "a"]), "leak", "error", ["PID", ODD_NAME])
    assert [text.get_text() for text in rows.get_yticklabels()] == ["b", "a"]
    np.testing.assert_array_equal(rows.containers[0].lines[0].get_xydata(), [[0.5, 0.0], [1.0, 1.0]])
    assert rows.containers[0].lines[0].get_color() == BLUE
