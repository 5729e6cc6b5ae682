"""The page of the leakage protocol: what it says, what it colours, and what it leaves out."""

import re

import pandas as pd
import pytest
from browser import problems_everywhere
from made_up_run import tables
from published import assert_published_page

from hydro_agents.report.content import Content
from hydro_agents.report.leak_findings import findings_of
from hydro_agents.report.leakage import LEAKAGE, confusion_tables, right_verdicts
from hydro_agents.report.sections import render_page


@pytest.fixture(scope="module")
def content():
    return Content(tables(), others={"base": "plain"})


@pytest.fixture(scope="module")
def page(content):
    return render_page("Leaks", LEAKAGE, content).html


def plain(text):
    return text.replace("\u00a0", " ")


def test_the_findings_say_how_small_how_early_how_surely_and_when_nothing_can_be_said(content):
    small, early, sure, confused, silent = ((plain(item.lead), plain(item.text)) for item in findings_of(content))
    assert small[0] == "A leak of 0.2 l/min is found within 2 s of ordinary motion."
    assert early[0] == "A new leak of 1 l/min raises the alarm after 3 s."
    assert "0.1 l/min after 30 s, 2.0 % missed" in early[1]
    assert "2.0 per 100 h (0.2 to 7.2)" in early[1]
    assert sure[0] == "The head alone raises 18 false alarms per hour: let an alarm sum up its windows."
    assert "head 1.0 % (0.2 to 5.4), which is 18 per hour" in sure[1]
    assert "Under the worst motion or controller: head 4.0 % (1.6 to 9.8), ADRC" in sure[1]
    assert confused[0] == "Some other faults look like a worn seal."
    assert "head: valve null −1 % 60 %" in confused[1]
    assert "estimator: none" in confused[1]
    assert "estimator: valve null −1 %" in silent[1]


def test_without_confusions_and_silence_the_findings_say_so():
    made = tables()
    made = {**made, "detection": made["detection"][made["detection"]["condition"] == "plain"], "alarms": pd.DataFrame()}
    leads = [item.lead for item in findings_of(Content(made, others={"base": "plain"}))]
    assert "No other fault looks like a worn seal." in leads
    assert "No detector stays silent." in leads
    assert not any("alarm after" in lead for lead in leads)


def rows_of(table):
    """Cells by column, by the name of the row."""
    return {label: dict(zip(table.header[1:], cells, strict=True)) for label, *cells in table.rows}


def test_right_verdicts_are_blue_and_wrong_ones_orange(content):
    assert right_verdicts(content, "plain", 0.0) == ("none",)
    assert right_verdicts(content, "null", 0.0) == ("valve fault",)
    assert right_verdicts(content, "null", 0.3) == ("internal leak",)
    found = {caption.split(";")[0]: table for caption, table in confusion_tables(content).items()}
    head = rows_of(found["head: healthy seal"])["valve null −1 %"]
    leak = head["internal leak"]
    assert leak.text == "60"
    assert (leak.meaning, leak.share) == ("worse", 30)  # 60 % of half the colour
    right = rows_of(found["estimator: healthy seal"])["valve null −1 %"]["valve fault"]
    assert (right.text, right.meaning, right.share) == ("20", "better", 10)


def test_the_page_stands_alone_and_holds_scale_and_conditions(page):
    assert page.startswith("<!doctype html>")
    assert_published_page("leakage", page)
    assert not re.search(r'(src|href)="(?!#|figures/)', page)
    assert "0.06&nbsp;ml/min" in page
    assert "500 times" in page
    for text in ("Does better control hide the leak?", "valve null −1 %"):
        assert text in page
    assert "estimator did not run under ADRC: reads no ADRC." in page
    assert page.count("<svg") >= 8


def test_sections_without_figures_are_left_out():
    made = tables()
    made = {name: table for name, table in made.items() if name not in ("alarms", "masking", "reliability")}
    page = render_page("Leaks", LEAKAGE, Content(made, others={"base": "plain"})).html
    assert 'id="alarm_delay"' not in page
    assert 'id="masking"' not in page


def test_nothing_is_cut_off_in_a_browser(browser, content, tmp_path):
    render_page("Leaks", LEAKAGE, content).write(tmp_path / "leakage.html")
    assert problems_everywhere(browser, tmp_path / "leakage.html") == []
