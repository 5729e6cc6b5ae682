"""The documentation site: its tables equal the code and the kept results; it builds without a warning, links hold."""

import importlib.util
import inspect
import re
import subprocess
import sys
from pathlib import Path

import pandas as pd
import pytest

from hydro_env import ServoHydraulicEnv

ROOT = Path(__file__).parents[2]
DOCS = ROOT / "docs"


def script(path, monkeypatch):
    """A script of the repository as a module."""
    monkeypatch.syspath_prepend(str(path.parent))
    spec = importlib.util.spec_from_file_location(path.stem, path)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def rows_of(text):
    """Rows of tables in Markdown, without the marks of code."""
    text = re.sub(r":class:`(\w+)`|:data:`([\w.]+)`", r"\1\2", text)
    return {line.strip().replace("`", "") for line in text.splitlines() if line.strip().startswith("|")}


def test_the_tables_of_the_environment_are_those_of_its_docstring():
    page = rows_of((DOCS / "environment.md").read_text(encoding="utf-8"))
    code = rows_of(inspect.getdoc(ServoHydraulicEnv))
    assert len(code) > 35
    assert code <= page


def test_the_tables_of_fields_are_those_of_the_models(monkeypatch):
    fields = script(DOCS / "fields.py", monkeypatch)
    page = fields.PAGE.read_text(encoding="utf-8")
    assert fields.filled(page) == page, "run: python docs/fields.py"
    assert page.count("\n| `") > 120


def test_the_tables_of_results_are_those_of_the_kept_files(monkeypatch):
    results = script(ROOT / "benchmarks" / "put_into_docs.py", monkeypatch)
    pages = {name: (DOCS / name).read_text(encoding="utf-8") for name in results.PAGES}
    made = {name: results.table_of(name) for name in results.SOURCES}
    for page in pages.values():
        assert results.filled(page, made) == page, "run: python benchmarks/put_into_docs.py"
    assert all(table in "".join(pages.values()) for table in made.values())
    for name in results.SOURCES:
        assert re.match(r"hydro_env [\d.]+, (kept with )?commit \w+, \d{4}-\d\d-\d\d", results.origin_of(name))


def test_the_readme_gives_the_numbers_of_the_tables():
    readme = (ROOT / "README.md").read_text(encoding="utf-8").lower()
    errors = pd.read_csv(DOCS / "tables" / "errors.csv", skiprows=1)
    ratios = pd.read_csv(DOCS / "tables" / "study.csv", skiprows=1).set_index("controller")
    for row in errors.iloc[1:].itertuples():
        ratio = ratios.loc[row.controller]
        accuracy = f"{row.mean_error_mm:.3f} | {ratio.ratio:.3f} ({ratio.ratio_low:.3f} to {ratio.ratio_high:.3f})"
        assert f"| {row.controller.lower()} | {accuracy} | {row.mean_error_sensor_mm:.3f} |" in readme


def test_the_charts_show_the_numbers_of_their_files(monkeypatch):
    pictures = script(DOCS / "pictures.py", monkeypatch)
    for chart in pictures.CHARTS:
        text = (pictures.FOLDER / chart).read_text(encoding="utf-8")
        assert text.endswith(pictures.data_mark(chart)), "run: python docs/pictures.py"


def test_the_check_of_links_finds_faults(tmp_path, monkeypatch):
    check = script(DOCS / "check_links.py", monkeypatch)
    (tmp_path / "a.html").write_text('<p id="here"></p><a href="b.html#there">b</a><a href="#here">here</a>')
    (tmp_path / "b.html").write_text('<a href="c.html">c</a><img src="https://host/x.png" alt="x">')
    found = {line.rpartition(": ")[2] for line in check.complaints(tmp_path)}
    assert found == {"b.html#there", "c.html", "https://host/x.png"}


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    """The built site; a warning is an error."""
    pytest.importorskip("sphinx", reason="Sphinx is not installed: pip install .[docs]")
    folder = tmp_path_factory.mktemp("site")
    options = ["-q", "-W", "--keep-going", "-c", "docs", "-d", str(folder / "doctrees")]
    command = [sys.executable, "-m", "sphinx", *options, ".", str(folder / "html")]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return folder / "html"


@pytest.mark.slow
def test_the_site_builds_and_its_links_hold(site, monkeypatch):
    assert script(DOCS / "check_links.py", monkeypatch).complaints(site) == []
    model = (site / "docs" / "model.html").read_text(encoding="utf-8")
    assert model.count("<math") > 20
    assert "def pressure_rate(" in re.sub("<[^>]*>", "", model)  # the code beside its formula
