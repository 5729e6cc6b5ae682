"""The page on performance names every group, and its tables are put in place."""

import importlib.util
import re
from pathlib import Path

from benchmarks.run import GROUPS
from benchmarks.table import Row, write_markdown

ROOT = Path(__file__).parents[2]
spec = importlib.util.spec_from_file_location("put_into_docs", ROOT / "benchmarks" / "put_into_docs.py")
put_into_docs = importlib.util.module_from_spec(spec)
spec.loader.exec_module(put_into_docs)


def test_page_has_a_place_for_every_group():
    page = (ROOT / "docs" / "performance.md").read_text(encoding="utf-8")
    assert sorted(re.findall(r"<!-- benchmark: (\w+) -->", page)) == sorted([*GROUPS, "circumstances"])
    assert page.count("<!-- end -->") == len(GROUPS) + 1


def test_tables_are_put_in_place_again_and_again(tmp_path):
    results = [Row("one axis", "steps/s", group="single", values=[1.0, 2.0, 3.0])]
    source, page = tmp_path / "benchmark.md", tmp_path / "page.md"
    write_markdown(source, results, {"single": "One."}, "Some machine.")
    text = "A\n<!-- benchmark: single -->\nold\n<!-- end -->\nB\n<!-- benchmark: circumstances -->\n<!-- end -->\n"
    page.write_text(text + "<!-- benchmark: kernel -->\nkept\n<!-- end -->\n", encoding="utf-8")
    for _ in range(2):
        assert put_into_docs.main(str(source), str(page)) == 0
        filled = page.read_text(encoding="utf-8")
        assert filled.count("| one axis | steps/s | 2.00 | 1.00–3.00 | 3 |") == 1
        assert "old" not in filled
        assert "Some machine." in filled
        assert "kept" in filled


def test_a_missing_table_is_one_line(capsys, tmp_path):
    assert put_into_docs.main(str(tmp_path / "none.md")) == 2
    assert len(capsys.readouterr().err.splitlines()) == 1
