"""The leaderboard: every entry has the score that it claims, and the page shows the files."""

import hashlib

import pandas as pd
import pytest

from benchmarks.leaderboard import FOLDER, PAGE, TRACKS, entries, figures_of, labels, page

pytest.importorskip("pyarrow")


@pytest.mark.parametrize("name", entries())
def test_an_entry_has_the_score_that_it_claims(name):
    entry, file = entries()[name], FOLDER / f"{name}.parquet"
    assert entry["track"] in TRACKS
    assert hashlib.sha256(file.read_bytes()).hexdigest() == entry["predictions_sha256"]
    assert figures_of(name, pd.read_parquet(file), labels()) == pytest.approx(entry["figures"], abs=1e-4)


def test_the_page_shows_the_entries():
    assert PAGE.read_text(encoding="utf-8") == page()
