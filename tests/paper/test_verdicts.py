"""Verdicts on the paper's conclusions: from made-up facts with known answers, and as kept for the documentation."""

from pathlib import Path

import pandas as pd
import pytest

from paper.verdicts import NO, PART, YES, verdict_table, verdicts_of

KEPT = Path(__file__).parents[2] / "docs" / "tables" / "verdicts.csv"


def moves(last_mm=80.0, swing=(0.2, 0.02), with_friction=0.001):
    ends = [{"move_mm": 100.0, "swing_mm": with_friction}, {"move_mm": last_mm, "swing_mm": with_friction}]
    return {"first": ends[0], "last": ends[1], "swing": list(swing), "noise": 0.03}


@pytest.mark.parametrize(
    ("facts", "slows", "damps"),
    [
        (moves(), YES, PART),  # friction hides the swing
        (moves(with_friction=0.1), YES, YES),
        (moves(last_mm=98.0, with_friction=0.1), PART, YES),
        (moves(last_mm=101.0, swing=(0.2, 0.3)), NO, NO),
    ],
)
def test_a_move(facts, slows, damps):
    found = verdicts_of("fig12_displacement", "Fig. 12: displacement", facts)
    assert [verdict.verdict for verdict in found] == [slows, damps]
    assert {verdict.figure for verdict in found} == {"Fig. 12"}
    assert "100.0 mm at 0.01 l/min" in found[0].finding


@pytest.mark.parametrize(("growing", "verdict"), [((1.5, 2.0), YES), ((0.5, 2.0), PART), ((0.5, 0.9), NO)])
def test_the_share_of_leakage(growing, verdict):
    law = {"name": "Laminar leak", "low": {"percent": "1", "bar": "0 to 2"}, "high": {"percent": "6", "bar": "6 to 8"}}
    facts = {"ratio": pd.Series(growing), "laws": [law | {"persists": False}], "lowest": 0.0}
    negligible, grows = verdicts_of("section4_share", "Section 4: share", facts)
    assert (negligible.verdict, grows.verdict) == (YES, verdict)
    facts["laws"] = [law | {"persists": True}, law | {"persists": False}]
    assert verdicts_of("section4_share", "Section 4: share", facts)[0].verdict == PART


def test_figures_without_a_conclusion_of_the_paper():
    assert verdicts_of("sensitivity", "Further: sensitivity", {}) == []
    assert list(verdict_table([]).columns) == ["figure", "conclusion", "verdict", "finding"]


def test_the_command_writes_what_the_documentation_shows(folder):
    """The figures of this test have fewer leaks than those of the documentation; the verdicts are the same."""
    written, kept = (pd.read_csv(file)[["conclusion", "verdict"]] for file in (folder / "verdicts.csv", KEPT))
    pd.testing.assert_frame_equal(written, kept)
    page = (folder / "page.html").read_text(encoding="utf-8")
    assert all(conclusion in page for conclusion in kept["conclusion"])
