"""A headless Chromium for tests of pages, driven by Playwright; the tests skip where no browser is installed.

from browser import SIZES, SCHEMES, open_page, problems_of

def test_my_page(browser, tmp_path):  # the fixture ``browser`` stands in tests/conftest.py
    with open_page(browser, path, width=400, scheme="dark") as page:  # a page of Playwright
        assert problems_of(page) == []
"""

import os
import shutil
from contextlib import contextmanager

import pytest

SIZES = (390, 1200)
"""Widths in pixels: a telephone, a screen."""

SCHEMES = ("light", "dark")

PROGRAMS = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable", "chrome")


@contextmanager
def start_browser():
    """A browser of Playwright; skips the test, with the reason, without one."""
    playwright = pytest.importorskip("playwright.sync_api", reason="Playwright is not installed: pip install .[dev]")
    program = next(filter(None, map(shutil.which, PROGRAMS)), None)
    with playwright.sync_playwright() as driver:
        program = program or driver.chromium.executable_path
        if not os.path.exists(program):
            pytest.skip("no Chromium: install the package chromium, or run 'playwright install chromium'")
        browser = driver.chromium.launch(executable_path=program, args=["--no-sandbox", "--disable-gpu"])
        yield browser
        browser.close()


@contextmanager
def open_page(browser, path, width=1000, height=900, scheme="light", **options):
    """A page from disk, without network. Its list ``problems`` collects what the console and failed requests say."""
    context = browser.new_context(
        viewport={"width": width, "height": height}, color_scheme=scheme, offline=True, **options
    )
    page = context.new_page()
    page.set_default_timeout(180_000)  # ms; a busy machine draws slowly
    page.problems = []
    page.on("pageerror", lambda error: page.problems.append(f"error: {error}"))
    page.on("requestfailed", lambda request: page.problems.append(f"request: {request.url}"))
    page.on(
        "console", lambda message: page.problems.append(message.text) if message.type in ("error", "warning") else None
    )
    page.goto(path.resolve().as_uri())
    yield page
    context.close()


CUT_OFF = """() => {
  const found = [], root = document.documentElement;
  if (root.scrollWidth > window.innerWidth) found.push(`the page is ${root.scrollWidth} px wide`);
  const scrolls = box => ['auto', 'scroll'].includes(getComputedStyle(box).overflowX);
  for (const box of document.body.querySelectorAll('*')) {
    if (!box.checkVisibility() || box.closest('svg') && box.tagName !== 'svg') continue;
    const style = getComputedStyle(box), name = `${box.tagName}.${box.getAttribute('class') || ''}#${box.id}`;
    if (style.overflowX === 'hidden' || style.overflowX === 'clip') {
      if (box.scrollWidth > box.clientWidth + 1 && style.position !== 'absolute')
        found.push(`${name} cuts its content off`);
    }
    if (scrolls(box) && box.scrollWidth > box.clientWidth + 1 && style.backgroundImage === 'none')
      found.push(`${name} scrolls sideways without a hint`);
    let inside = false;
    for (let up = box; up; up = up.parentElement) inside ||= scrolls(up);
    const place = box.getBoundingClientRect();
    if (!inside && place.width > 1 && (place.right > window.innerWidth + 1 || place.left < -1))
      found.push(`${name} ends at ${Math.round(place.right)} px`);
  }
  for (const text of document.querySelectorAll('svg text, svg g[id*="text_"]')) {
    if (!text.checkVisibility()) continue;
    const place = text.getBoundingClientRect(), whole = text.ownerSVGElement.getBoundingClientRect();
    if (place.left < whole.left - 1 || place.right > whole.right + 1
        || place.top < whole.top - 1 || place.bottom > whole.bottom + 1)
      found.push(`text of a figure beyond its edge: ${text.textContent.trim() || text.id}`);
  }
  return found;
}"""


def problems_of(page):
    """What the console said, and what is cut off: the page wider than the window, boxes and texts beyond an edge."""
    return [*page.problems, *page.evaluate(CUT_OFF)]


def problems_everywhere(browser, path):
    """Problems of a page from disk at every size and in both schemes, with all its parts unfolded."""
    found = []
    with open_page(browser, path) as page:
        page.evaluate("document.querySelectorAll('details').forEach(part => { part.open = true; })")
        for scheme in SCHEMES:
            page.emulate_media(color_scheme=scheme)
            for width in SIZES:
                page.set_viewport_size({"width": width, "height": 900})
                found += [f"{width} px, {scheme}: {problem}" for problem in problems_of(page)]
    return found
