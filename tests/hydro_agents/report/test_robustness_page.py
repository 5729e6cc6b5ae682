"""The page of the robustness protocol: what it says, what it colours, and what it leaves out."""

import re

import pytest
from browser import problems_everywhere
from contrast import contrast, mixed
from made_up_tables import experiment_tables, protocol_tables
from published import assert_published_page

from hydro_agents.report.content import Content
from hydro_agents.report.palette import MEANINGS, NEUTRALS
from hydro_agents.report.robustness import (
    ROBUSTNESS,
    cycles_by_condition,
    heat_map,
    ranking_table,
    standstill,
    stiffness_table,
)
from hydro_agents.report.sections import render_page


@pytest.fixture(scope="module")
def content():
    return Content({**protocol_tables(), **experiment_tables()})


@pytest.fixture(scope="module")
def page(content):
    return render_page("Robustness", ROBUSTNESS, content).html


def test_the_ranking_holds_ratios_and_counts(content):
    (table,) = ranking_table(content)
    rows = {row[0]: dict(zip(table.header, row, strict=True)) for row in table.rows}
    columns = ("equal weights", "best in", "failed")
    assert [rows["Good"][name] for name in columns] == ["0.70 (0.60 to 0.80)", "3", "0"]
    assert [rows["Fair"][name] for name in columns] == ["0.95 (0.85 to 1.05)", "1", "2"]
    assert [rows["PID"][name] for name in columns] == ["1.00", "1", "0"]


def test_a_cell_has_a_colour_only_where_the_whole_interval_is_on_one_side_of_1(content):
    rows = {label: cells for table in heat_map(content, "", "equal_weight") for label, *cells in table.rows}
    _, good, fair = rows["8 l/min"]
    assert good.meaning == "better"
    assert good.strong
    assert (fair.meaning, fair.share) == ("", 0)
    assert rows["period 10 ms"][1].text == "–"
    assert rows["latency 5 ms"][1].meaning == "worse"
    assert (rows["0.01 l/min"][1].meaning, rows["0.01 l/min"][1].share) == ("better", 50)  # half the error
    assert rows["0.01 l/min"][0] == "0.200"


def test_text_is_readable_on_every_colour_in_both_themes(content):
    cells = [
        cell
        for table in heat_map(content, "", "equal_weight")
        for row in table.rows
        for cell in row[2:]
        if cell.meaning
    ]
    assert len({cell.share for cell in cells}) > 2
    for cell in cells:
        for theme in ("light", "dark"):
            paper, ink = (getattr(NEUTRALS[name], theme) for name in ("paper", "ink"))
            assert contrast(mixed(getattr(MEANINGS[cell.meaning], theme), paper, cell.share), ink) >= 4.5


def test_groups_are_in_order_and_the_many_parameters_are_folded(content):
    table, folded = heat_map(content, "", "equal_weight")
    assert [title.split()[0] for title in table.breaks.values()] == ["Leak", "Timing"]
    assert (folded.caption, folded.folded) == ("Assumed parameters, one at a time", True)


def test_every_section_and_number_stands_on_the_page(content, page):
    assert_published_page("robustness", page)
    assert render_page("Robustness", ROBUSTNESS, content).html == page  # the same every time
    assert "41b35ac0" in page
    assert "hydro evaluate &lt;x&gt;" in page
    assert "nan" not in re.sub(r"<svg.*?</svg>", "", page, flags=re.S).lower().replace("finance", "")
    assert len(page) < 3_000_000
    assert not re.search(r'(src|href)="http', page)


def test_missing_tables_leave_their_sections_out():
    tables = {name: table for name, table in protocol_tables().items() if name in ("summary", "protocol")}
    page = render_page("Robustness", ROBUSTNESS, Content(tables)).html
    assert re.findall("<h2>(.*?)</h2>", page) == ["Errors and costs", "How it was measured", "This run"]


def test_tables_of_the_experiments(content):
    row = stiffness_table(content).rows[0]
    assert row[1].startswith("≥")  # the deviation is too small
    assert (row[0], row[2], row[3]) == ("PID", "4360", "100 (1 of 2)")  # 872 N over 0.2 mm
    _, rest, _ = standstill(content)
    assert rest.rows[0] == ("PID", "20.0", "1.0", "1.50")
    (table,) = cycles_by_condition(content)
    assert table.caption.endswith("none under the others")
    assert table.rows == [("0.01 l/min", "1 of 2", "0 of 1", "–")]


def test_nothing_is_cut_off_in_a_browser(browser, content, tmp_path):
    render_page("Robustness", ROBUSTNESS, content).write(tmp_path / "robustness.html")
    assert problems_everywhere(browser, tmp_path / "robustness.html") == []
