"""Verdicts on the paper's conclusions: from made-up numbers with known answers, and as kept for the documentation."""

import pandas as pd
import pytest

from paper import verdicts
from paper.run import verdict_table
from paper.verdicts import NO, PART, YES

NONE = float("nan")
LOOP = {"peak": 1.0, "peak_hz": 1.0, "at_rest": 1.0, "largest_gain_per_m": 1.0}


def given(monkeypatch, summary, rows):
    """Let a summary of a figure be a made-up one."""
    made = pd.DataFrame(rows)
    monkeypatch.setattr(verdicts, summary, lambda *_: made)


@pytest.mark.parametrize(
    ("last_mm", "swing_mm", "with_friction", "slows", "damps"),
    [
        (80.0, 0.02, 0.001, YES, PART),  # friction hides the swing
        (80.0, 0.02, 0.1, YES, YES),
        (98.0, 0.02, 0.1, PART, YES),
        (101.0, 0.3, 0.001, NO, NO),
    ],
)
def test_a_move(monkeypatch, last_mm, swing_mm, with_friction, slows, damps):
    ends = [{"leak_lpm": 0.01, "move_mm": 100.0, "swing_mm": 0.2}, {"leak_lpm": 4.0, "move_mm": last_mm}]
    ends[1]["swing_mm"] = swing_mm
    rows = [{**row, "friction": False} for row in ends]
    rows += [{**row, "friction": True, "swing_mm": with_friction} for row in ends]
    given(monkeypatch, "displacement_summary", [{**row, "noise_mm": 0.03, "back_mm": 0, "forth_mm": 0} for row in rows])
    found = verdicts.displacement(pd.DataFrame()).verdicts
    assert [verdict.verdict for verdict in found] == [slows, damps]
    assert found[0].here.startswith("100.0 at 0.01 l/min")


@pytest.mark.parametrize(
    ("bandwidth_hz", "hump", "harder", "damped"), [(30.0, 0.1, YES, YES), (39.5, NONE, NO, YES), (40.0, 0.9, NO, NO)]
)
def test_a_closed_loop(monkeypatch, bandwidth_hz, hump, harder, damped):
    rows = [{**LOOP, "bandwidth_hz": 40.0, "hump": 0.9}, {**LOOP, "bandwidth_hz": bandwidth_hz, "hump": hump}]
    given(monkeypatch, "closed_bode_summary", rows)
    found = verdicts.closed_loop(pd.DataFrame()).verdicts
    assert [verdict.verdict for verdict in found] == [harder, damped]


def shares(*ends):
    """Shares at the lowest and at the highest difference, of one leak per law."""
    return pd.DataFrame(
        {
            "law": law,
            "leak_lpm": 4.0,
            "difference_low_bar": low,
            "difference_high_bar": low + 2.0,
            "leakage_share": part,
        }
        for law, pair in zip(("laminar", "throttle"), ends, strict=True)
        for low, part in zip((0.0, 6.0), pair, strict=True)
    )


@pytest.mark.parametrize(
    ("laminar", "throttle", "negligible", "grows"),
    [
        ((0.01, 0.06), (0.01, 0.05), YES, YES),
        ((0.01, 0.06), (0.05, 0.06), PART, YES),
        ((0.06, 0.01), (0.05, 0.06), NO, PART),
        ((0.06, 0.01), (0.06, 0.05), NO, NO),
    ],
)
def test_the_share_of_leakage(laminar, throttle, negligible, grows):
    found = verdicts.share(shares(laminar, throttle)).verdicts
    assert [verdict.verdict for verdict in found] == [negligible, grows]


def test_without_figures_there_is_no_verdict():
    assert list(verdict_table({}).columns) == ["figure", "conclusion", "verdict", "measured", "here"]
