"""The page of the leakage protocol on a made-up run whose figures are known."""

import re

import pytest
from browser import problems_everywhere
from published import assert_published_page
from small_leaks import made_up_tables

from hydro_agents.report.content import Content
from hydro_agents.report.leakage import LEAKAGE, findings_table, leak_findings
from hydro_agents.report.sections import render_page


@pytest.fixture(scope="module")
def content():
    return Content(made_up_tables(), others={"base": "plain"})


@pytest.fixture(scope="module")
def page(content):
    return render_page("Leaks", LEAKAGE, content)


def test_findings_say_how_small_how_surely_and_when_nothing_can_be_said(content):
    assert leak_findings(content)[0].text == "A leak of 0.2 l/min is found within 2 s of ordinary motion."
    head, estimator = (row[1:] for row in findings_table(content).rows)
    assert head[:3] == ("0.2", "1.0 (0.2 to 5.4)", "18")
    assert head[3] == "valve null −1 % 60 %"
    assert estimator[3:] == ("none", "valve null −1 %")


def test_without_confusions_and_silence_the_findings_say_so():
    made = made_up_tables()
    made = {**made, "detection": made["detection"][made["detection"]["condition"] == "plain"]}
    rows = findings_table(Content(made, others={"base": "plain"})).rows
    assert [row[4:] for row in rows] == [("none", "none")] * 2


def test_the_page_stands_alone_and_says_who_did_not_run(page):
    assert page.html.startswith("<!doctype html>")
    assert_published_page("leakage", page.html)
    assert not re.search(r'(src|href)="(?!#|figures/)', page.html)
    assert "reads no ADRC" in page.html
    assert page.html.count("<svg") >= 8


def test_nothing_is_cut_off_in_a_browser(browser, page, tmp_path):
    page.write(tmp_path / "leakage.html")
    assert problems_everywhere(browser, tmp_path / "leakage.html") == []
