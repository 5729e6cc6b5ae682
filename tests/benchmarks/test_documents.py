"""The page on performance names every group, and its tables are put in place."""

import re
from pathlib import Path

from benchmarks import put_into_docs
from benchmarks.run import GROUPS
from benchmarks.table import Row, write_markdown

DOCS = Path(__file__).parents[2] / "docs"


def test_page_has_a_place_for_every_group():
    page = (DOCS / "performance.md").read_text(encoding="utf-8")
    assert sorted(re.findall(r"<!-- benchmark: (\w+) -->", page)) == sorted([*GROUPS, "circumstances"])
    assert page.count("<!-- end -->") == len(GROUPS) + 1


def test_tables_are_put_in_place_again_and_again(tmp_path, monkeypatch):
    monkeypatch.setattr(put_into_docs, "DOCS", tmp_path)
    monkeypatch.setattr(put_into_docs, "PAGES", ())
    results = [Row("one axis", "steps/s", group="single", values=[1.0, 2.0, 3.0])]
    page = tmp_path / "performance.md"
    (tmp_path / "benchmark").mkdir()
    write_markdown(tmp_path / "benchmark" / "benchmark.md", results, {"single": "One."}, "Some machine.")
    text = "A\n<!-- benchmark: single -->\nold\n<!-- end -->\nB\n<!-- benchmark: circumstances -->\n<!-- end -->\n"
    page.write_text(text + "<!-- benchmark: kernel -->\nkept\n<!-- end -->\n", encoding="utf-8")
    for _ in range(2):
        put_into_docs.main(str(tmp_path))
        filled = page.read_text(encoding="utf-8")
        assert filled.count("| one axis | steps/s | 2.00 | 1.00–3.00 | 3 |") == 1
        assert "old" not in filled
        assert "Some machine." in filled
        assert "kept" in filled
