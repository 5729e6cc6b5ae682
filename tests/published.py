"""Columns of the published tables, and contents of the pages, from the YAML files beside this one."""

import re
from html import unescape
from pathlib import Path

import pandas as pd
import yaml

TABLES = yaml.safe_load(Path(__file__).with_name("published_tables.yaml").read_text(encoding="utf-8"))


def assert_published(command, found, absent=()):
    """Check names and columns of the tables that a command wrote into a folder (or made: tables by name)."""
    if isinstance(found, Path):
        found = {file.stem: pd.read_csv(file, nrows=0) for file in found.glob("*.csv")}
    named = [name for part in command.split("+") for name in TABLES[part] if name not in absent]
    assert set(found) == set(named)
    columns = {name: text for part in command.split("+") for name, text in TABLES[part].items()}
    for name, table in found.items():
        assert list(table) == columns[name].split(), f"{name}: enter the change in published_tables.yaml"


PAGES = yaml.safe_load(Path(__file__).with_name("published_pages.yaml").read_text(encoding="utf-8"))


def contents_of(html):
    """Figures, tables and folded parts of a page but those of its cards, by the name of its section, in order."""
    found = {}
    for name, body in re.findall(r'<section id="(\w+)"[^>]*>(.*?)</section>', html, flags=re.DOTALL):
        titles = re.findall(
            r"<figcaption><strong>(.*?)</strong>|<caption><span>(.*?)</span>|<summary>(?!Details<)(.*?)</summary>", body
        )
        kinds = ("figure", "table", "folded")
        found[name] = [
            f"{kind}: {unescape(title)}" for row in titles for kind, title in zip(kinds, row, strict=True) if title
        ]
    return found


def assert_published_page(name, html):
    """Check the sections of a page, and their figures and tables, against ``published_pages.yaml``."""
    assert contents_of(html) == PAGES[name], "enter the change in published_pages.yaml"
