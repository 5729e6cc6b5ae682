"""Tables and page of the leakage protocol on a made-up run whose figures are known."""

import re

import numpy as np
import pandas as pd
import pytest
from browser import problems_everywhere
from published import assert_published_page
from small_leaks import made_up_run, made_up_tables

from hydro_agents.detection.detector import VERDICTS
from hydro_agents.report.content import Content
from hydro_agents.report.leakage import LEAKAGE, confusion_tables, findings_table, leak_findings, right_verdicts
from hydro_agents.report.sections import render_page


@pytest.fixture(scope="module")
def made():
    return made_up_tables()


@pytest.fixture(scope="module")
def content(made):
    return Content(made, others={"base": "plain"})


@pytest.fixture(scope="module")
def page(content):
    return render_page("Leaks", LEAKAGE, content).html


def test_findings_say_how_small_how_surely_and_when_nothing_can_be_said(content):
    assert leak_findings(content)[0].sentences == ["A leak of 0.2 l/min is found within 2 s of ordinary motion."]
    head, estimator = (row[1:] for row in findings_table(content).rows)
    assert head[:3] == ("0.2", "1.0 (0.2 to 5.4)", "18")
    assert head[3].startswith("4.0 (1.6 to 9.8), ADRC")
    assert head[4] == "valve null −1 % 60 %"
    assert estimator[4:] == ("none", "valve null −1 %")


def test_without_confusions_and_silence_the_findings_say_so():
    made = made_up_tables()
    made = {**made, "detection": made["detection"][made["detection"]["condition"] == "plain"]}
    rows = findings_table(Content(made, others={"base": "plain"})).rows
    assert [row[4:] for row in rows] == [("–", "none", "none")] * 2


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
    made = made_up_tables()
    made = {name: table for name, table in made.items() if name not in ("masking", "reliability")}
    page = render_page("Leaks", LEAKAGE, Content(made, others={"base": "plain"})).html
    assert 'id="masking"' not in page


def test_nothing_is_cut_off_in_a_browser(browser, content, tmp_path):
    render_page("Leaks", LEAKAGE, content).write(tmp_path / "leakage.html")
    assert problems_everywhere(browser, tmp_path / "leakage.html") == []


def row(table, **wanted):
    for name, value in wanted.items():
        table = table[table[name] == value]
    assert len(table) == 1
    return table.iloc[0]


def test_detection_per_window_and_per_hour(made):
    healthy = row(made["detection"], detector="head", condition="plain", level=0.0)
    assert healthy["flagged"] == 0.01
    assert healthy["per_hour"] == pytest.approx(0.01 * 1800)  # windows of 2 s, one after the other
    assert healthy["flagged_low"] < 0.01 < healthy["flagged_high"]
    assert row(made["detection"], detector="estimator", condition="null", level=0.0)["cannot_tell"] == 0.8


def test_verdicts_are_shares_of_all_windows(made):
    found = row(made["verdicts"], detector="estimator", condition="null", level=0.0)
    assert found["valve fault"] == 0.2
    assert found["cannot tell"] == 0.8
    np.testing.assert_allclose(made["verdicts"][list(VERDICTS)].sum(axis=1), 1.0)


def test_sizes_over_windows_in_which_the_detector_tells(made):
    plain = row(made["sizes"], detector="head", condition="plain", level=0.3)
    assert plain["rms_log10"] == pytest.approx(np.log10(1.1))
    assert plain["coverage"] == 1.0  # 10 % beside the truth, intervals of 20 %
    assert plain["bound_lpm"] == pytest.approx(0.02)  # the median
    assert plain["ratio_to_bound"] == pytest.approx(np.log10(1.1) / (0.02 / 0.3 / np.log(10.0)))
    beside = row(made["sizes"], detector="head", condition="null", level=0.3)
    assert beside["coverage"] == 0.0
    assert beside["unnoticed_minimum"] == 1.0  # twice the truth, 16 standard deviations away
    silent = row(made["sizes"], detector="estimator", condition="null", level=0.3)
    assert silent["told"] == 0
    assert np.isnan(silent["rms_log10"])


def test_the_calibration_error_is_the_distance_of_probability_and_frequency(made):
    mine = made["reliability"][made["reliability"]["detector"] == "head"].sort_values("probability")
    assert mine["probability"].tolist() == pytest.approx([0.2, 0.8])
    assert mine["frequency"].tolist() == [0.0, 1.0]
    assert mine["error"].iloc[0] == pytest.approx(0.2)


def test_masking_sets_detection_beside_the_position_error(made):
    mine = made["masking"][(made["masking"]["detector"] == "head") & (made["masking"]["level"] == 0.1)].set_index(
        "acting"
    )
    assert mine.loc["ADRC", "error_mm"] < mine.loc["PID", "error_mm"]
    assert mine["at_1_percent"].to_dict() == {"PID": 0.7, "ADRC": 0.5}


def test_every_table_is_written(made, tmp_path):
    made_up_run().write(tmp_path)
    assert {file.stem for file in tmp_path.glob("*.csv")} == set(made)
    pd.testing.assert_frame_equal(pd.read_csv(tmp_path / "masking.csv"), made["masking"].reset_index(drop=True))
