"""The documentation site: its tables and charts show the kept results; it builds without a warning, links hold."""

import importlib.util
import re
import subprocess
import sys
from pathlib import Path

import pandas as pd
import pytest
from browser import open_page, problems_everywhere, problems_of

import hydro_env

ROOT = Path(__file__).parents[2]
DOCS = ROOT / "docs"


def script(path, monkeypatch):
    """A script of the repository as a module."""
    monkeypatch.syspath_prepend(str(path.parent))
    spec = importlib.util.spec_from_file_location(path.stem, path)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_the_tables_of_the_pages_are_those_of_the_results(monkeypatch):
    results = script(ROOT / "benchmarks" / "put_into_docs.py", monkeypatch)
    shown = ""
    for name in results.PAGES:
        page = (DOCS / name).read_text(encoding="utf-8")
        assert results.filled(page, results.tables()) == page, "run: python benchmarks/put_into_docs.py"
        shown += page
    for name, table in results.tables().items():
        assert table in shown, name
        assert table.count("\n") > 2


def test_every_kept_table_is_of_this_version_and_says_where_it_comes_from(monkeypatch):
    results = script(ROOT / "benchmarks" / "put_into_docs.py", monkeypatch)
    minor = hydro_env.__version__.rpartition(".")[0]
    for name in results.SOURCES:
        assert re.match(rf"hydro_env {minor}\.\d+, (kept with )?commit \w+, \d{{4}}-\d\d-\d\d", results.origin_of(name))


def test_the_readme_gives_the_numbers_of_the_tables():
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    score = pd.read_csv(DOCS / "tables" / "score.csv", skiprows=1)
    for row in score.iloc[1:].itertuples():
        assert f"{row.mean_error_sensor_mm:.3f} | {row.mean_error_mm:.3f}" in readme


def test_the_charts_show_the_numbers_of_their_files(monkeypatch):
    pictures = script(DOCS / "pictures.py", monkeypatch)
    for chart in pictures.CHARTS:
        text = (pictures.FOLDER / chart).read_text(encoding="utf-8")
        assert text.endswith(pictures.data_mark(chart)), "run: python docs/pictures.py"


def test_the_check_of_links_finds_faults(tmp_path, monkeypatch):
    check = script(DOCS / "check_links.py", monkeypatch)
    assert check.complaints(tmp_path) == [f"{tmp_path}: holds no pages"]
    (tmp_path / "a.html").write_text('<p id="here"></p><a href="b.html#there">b</a><a href="#here">here</a>')
    (tmp_path / "b.html").write_text(
        '<a href="c.html">c</a><a href="a.html#gone">a</a><img src="https://host/x.png" alt=""><a href="https://x.y">x</a>'
    )
    assert [line.split(": ", 1)[1] for line in check.complaints(tmp_path)] == [
        "no such place: b.html#there",
        "image without alternative text: https://host/x.png",
        "leads nowhere: c.html",
        "loads from a network: https://host/x.png",
        "no such place: a.html#gone",
    ]


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
    check = script(DOCS / "check_links.py", monkeypatch)
    assert check.complaints(site) == []
    environment = (site / "docs" / "environment.html").read_text(encoding="utf-8")
    headings = ("Action Space", "Observation Space", "Rewards", "Starting State", "Episode End", "Arguments", "Version")
    places = [environment.index(f"<h2>{heading}") for heading in headings]
    assert places == sorted(places)
    model = (site / "docs" / "model.html").read_text(encoding="utf-8")
    assert model.count("<math") > 30
    assert "def pressure_rate(" in re.sub("<[^>]*>", "", model)  # the code beside its formula


@pytest.mark.slow
def test_nothing_is_cut_off(site, browser):
    sources = [
        site / "source" / "hydro_env" / "env.py.html",
        site / "source" / "agents" / "hydro_agents" / "index.html",
    ]
    drawers = ".sidebar-drawer, .toc-drawer"
    found = {
        path.relative_to(site).as_posix(): problems_everywhere(browser, path, drawers)
        for path in [*site.glob("*.html"), *site.glob("docs/**/*.html"), *sources]
        if path != site / "index.html"  # leads to the front page at once
    }
    assert len(found) > 35
    assert {name: problems for name, problems in found.items() if problems} == {}


@pytest.mark.slow
def test_the_front_page_holds_the_playground(site, browser):
    with open_page(browser, site / "index.html") as page:
        page.wait_for_url("**/docs/index.html")
        page.locator("iframe.playground").scroll_into_view_if_needed()
        inside = page.frame_locator("iframe.playground")
        inside.locator(".figures dd").first.wait_for()
        inside.locator("#leak").fill("0.602")
        assert inside.locator("#leak-value").text_content().startswith("4")
        assert page.problems == []


@pytest.mark.slow
def test_the_search_shows_excerpts_from_disk(site, browser):
    with open_page(browser, site / "search.html", query="q=viscosity") as page:
        page.locator("#search-results p.context").first.wait_for()
        assert all("viscosity" in text.lower() for text in page.locator("#search-results p.context").all_inner_texts())
        assert page.problems == []


def test_texts_for_the_search_keep_sections_and_nothing_else(monkeypatch):
    search = script(DOCS / "_extensions" / "search_from_disk.py", monkeypatch)
    page = """<nav>menu</nav><article role="main" id="x"><section id="a"><h1>Leaks<a class="headerlink" href="#a">#</a>
        </h1><p>1 &lt; <b>2</b></p><script>var leak;</script></section></article><footer>end</footer>"""
    assert search.text_of(page) == '<section id="a"> Leaks 1 &lt; 2 </section>'


def test_the_playground_and_the_page_about_it_are_two_pages():
    generated = {page.stem for page in DOCS.glob("*.html")}
    assert "playground" in generated
    assert not generated & {page.stem for page in DOCS.glob("*.md")}


@pytest.mark.parametrize("name", sorted(path.name for path in (DOCS / "images").glob("*.svg")))
def test_no_word_of_a_picture_is_cut_off(browser, name, tmp_path):
    page = tmp_path / "page.html"
    drawing = (DOCS / "images" / name).read_text(encoding="utf-8")
    page.write_text(f'<meta charset="utf-8"><body>{drawing[drawing.index("<svg") :]}', encoding="utf-8")
    with open_page(browser, page, width=1600) as opened:
        assert opened.locator("svg text, svg g[id*='text_']").count() > 3
        assert problems_of(opened) == []
