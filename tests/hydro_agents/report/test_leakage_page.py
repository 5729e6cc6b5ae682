"""The page of the leakage protocol, on a made-up run whose figures are known."""

from parsed_page import Parsed
from small_leaks import made_up_tables

from hydro_agents.report.leakage_page import findings, leakage_page


def test_it_says_how_small_how_surely_and_when_nothing_can_be_said():
    tables = made_up_tables()
    head, estimator = (row.to_list() for _, row in findings(tables, ["head", "estimator"], "plain").iterrows())
    assert head == ["0.2", "1.0 (0.2 to 5.4)", "18", "valve null −1 % 60 %", "none"]
    assert estimator[3:] == ["none", "valve null −1 %"]
    text = Parsed(leakage_page("Leaks", tables, "plain").html()).text
    assert "A leak of 0.2 l/min is found within 2 s of ordinary motion." in text
    assert "reads no switch" in text
    plain = tables["detection"][tables["detection"]["condition"] == "plain"]
    for row in findings({**tables, "detection": plain}, ["head", "estimator"], "plain").to_numpy():
        assert row[3:].tolist() == ["none", "none"]
