"""Columns of the published tables, from the YAML file beside this one."""

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
