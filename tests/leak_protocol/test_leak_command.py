"""``hydro evaluate --protocol`` with a leakage protocol: tables, page, resumption, and one line for what is wrong."""

import pandas as pd
import pytest
import yaml
from command_line import assert_one_clear_line, hydro

OWN = {
    "kind": "leakage",
    "levels": [0, 1.0],
    "detectors": {"head": {"kind": "head", "windows": 6, "validation_windows": 20, "batch": 20}},
    "base": "plain",
    "conditions": {
        "plain": {"group": "levels", "label": "ordinary motion", "levels": [0, 1.0, -1]},
        "short": {"group": "motion", "label": "0.2 s", "duration": 0.2},
        "null": {"group": "fault", "label": "valve null", "faults": {"valve_null_shift": 0.01}},
    },
}


@pytest.fixture
def place(tmp_path, monkeypatch):
    (tmp_path / "own.yaml").write_text(yaml.safe_dump(OWN, sort_keys=False))
    monkeypatch.chdir(tmp_path)
    return tmp_path


def evaluate(*arguments):
    return hydro("evaluate", "--protocol", "own.yaml", "-j", "1", *arguments)


def test_tables_page_and_the_shares_found_on_the_console(place):
    answer = evaluate()
    assert answer.returncode == 0, answer.stderr
    folder = place / "results" / "own"
    windows = pd.read_csv(folder / "tables" / "windows.csv")
    assert len(windows) == 6 * (3 + 2)
    status = pd.read_csv(folder / "tables" / "status.csv").set_index("condition")["status"]
    assert status["short"] == "not applicable"
    facts = pd.read_csv(folder / "tables" / "protocol.csv").set_index("key")["value"]
    assert facts["file_sha256"] in answer.stdout
    assert facts["sha256"] in (folder / "leakage.html").read_text(encoding="utf-8")
    table = pd.read_csv(folder / "tables" / "detection.csv")
    shares = table[(table["condition"] == "plain") & (table["level"] >= 0.0)].sort_values("level")["flagged"]
    printed = next(line.split() for line in answer.stdout.splitlines() if line.split()[:1] == ["head"])
    assert [float(share) for share in printed[1:]] == pytest.approx(100.0 * shares, abs=0.05)
    assert evaluate().returncode == 2  # the folder holds results
    again = evaluate("--resume")
    assert again.returncode == 0, again.stderr
    pd.testing.assert_frame_equal(pd.read_csv(folder / "tables" / "windows.csv"), windows, check_exact=True)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("--agent", "x=pid"), "--agent: a protocol takes it from its file"),
        (("--plants", "5"), "--plants: a protocol takes it from its file"),
        (("--head", "absent"), "absent"),
    ],
)
def test_what_cannot_be_is_told_in_one_line(place, arguments, message):
    answer = evaluate(*arguments)
    assert_one_clear_line(answer, message)
    assert not (place / "results").exists()
