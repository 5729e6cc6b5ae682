"""Finds broken links in a built site, images without a text, and anything that a page would load from a network.

Run: python docs/check_links.py build/site
"""

from __future__ import annotations

import sys
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote, urlsplit

LOADED = {"img": "src", "script": "src", "iframe": "src", "source": "src", "video": "src", "link": "href"}
IDLE_LINKS = {"index", "search", "next", "prev", "canonical"}
"""Kinds of <link> that load nothing."""


class _Page(HTMLParser):
    """The names, links and loaded files of a page."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.names: set[str] = set()
        self.links: list[str] = []
        self.loads: list[str] = []
        self.silent_images: list[str] = []
        self.feed(text)

    def handle_starttag(self, tag: str, attributes: list[tuple[str, str | None]]) -> None:
        values = {name: value or "" for name, value in attributes}
        self.names |= {values[name] for name in ("id", "name") if name in values}
        if tag == "a" and "href" in values:
            self.links.append(values["href"])
        if tag in LOADED and LOADED[tag] in values and values.get("rel") not in IDLE_LINKS:
            self.loads.append(values[LOADED[tag]])
        if tag == "img" and not values.get("alt", "").strip():
            self.silent_images.append(values.get("src", ""))


def complaints(folder: Path) -> list[str]:
    """One line per fault of the site."""
    pages = {path.resolve(): _Page(path.read_text(encoding="utf-8")) for path in folder.rglob("*.html")}
    faults = [] if pages else [f"{folder}: holds no pages"]
    for path, page in pages.items():
        here = path.relative_to(folder.resolve())
        faults += [f"{here}: image without alternative text: {source}" for source in page.silent_images]
        for address in page.loads + page.links:
            parts = urlsplit(address)
            if parts.scheme or parts.netloc:
                if address in page.loads and parts.scheme != "data":
                    faults.append(f"{here}: loads from a network: {address}")
                continue
            target = (path.parent / unquote(parts.path)).resolve() if parts.path else path
            if not target.is_file():
                faults.append(f"{here}: leads nowhere: {address}")
            elif parts.fragment and target in pages and unquote(parts.fragment) not in pages[target].names:
                faults.append(f"{here}: no such place: {address}")
    return sorted(set(faults))


def main(folder: str) -> int:
    """Print the faults; 1 if there are any."""
    found = complaints(Path(folder))
    print("\n".join(found) or f"{folder}: all links lead somewhere, and nothing is loaded from a network")
    return 1 if found else 0


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))
