"""New results are kept with their origin, and the pages show them."""

import pandas as pd

from benchmarks import put_into_docs as documents


def test_a_new_result_is_kept_and_shown(tmp_path, monkeypatch):
    kept = pd.read_csv(documents.TABLES / "study.csv", skiprows=1).assign(ratio=0.5)
    monkeypatch.setattr(documents, "TABLES", tmp_path / "tables")
    monkeypatch.setattr(documents, "SOURCES", {"study": documents.SOURCES["study"]})
    monkeypatch.setattr(documents, "PAGES", ("page.md",))
    monkeypatch.setattr(documents, "DOCS", tmp_path)
    folder = tmp_path / "results" / "study"
    for made in (tmp_path / "tables", folder / "tables"):
        made.mkdir(parents=True)
    kept.to_csv(folder / "tables" / "comparison.csv", index=False)
    origin = '{"version": "9.9.0", "date": "2030-01-01", "command": "hydro study"}'
    (folder / documents.ORIGIN).write_text(origin, encoding="utf-8")
    (tmp_path / "page.md").write_text("A\n<!-- table: study -->\nold\n<!-- end -->\nB\n", encoding="utf-8")
    for _ in range(2):
        documents.main(str(tmp_path / "results"))
        page = (tmp_path / "page.md").read_text(encoding="utf-8")
        assert page.count("| 0.500 (") == len(kept)
        assert "old" not in page
    assert documents.origin_of("study") == "hydro_env 9.9.0, 2030-01-01: `hydro study`"
