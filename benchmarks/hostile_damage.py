"""Damage to files of every kind, for ``hostile_inputs.py``: each way says whether the file is wrong beyond doubt."""

from __future__ import annotations

import importlib
import json
import random
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import yaml
from scipy.io import savemat

CASES = yaml.safe_load(Path(__file__).with_name("hostile_inputs.yaml").read_text(encoding="utf-8"))
HUGE = 10**400  # a number that no setting can have
LONG_TEXTS = ["[" * 5000, "a: " + "{b: " * 3000, "- " * 3000 + "1", "a: &x [1]\nb: [" + "*x, " * 500 + "1]"]
CELLS = CASES["cells"] | CASES["other cells"]


def damage(draw: random.Random, path: Path) -> tuple[str, bool]:
    """Damage a file in place; how, and whether what is there is wrong beyond doubt."""
    if draw.random() < 0.4:
        return _bytes(draw, path)
    return {".yaml": _settings, ".json": _settings, ".safetensors": _tensors}.get(path.suffix, _table)(draw, path)


def _bytes(draw: random.Random, path: Path) -> tuple[str, bool]:
    content, kind = path.read_bytes(), path.suffix
    coded, settings = kind in (".safetensors", ".parquet"), kind in (".yaml", ".json")
    ways: dict[str, tuple[bytes, bool]] = {
        "empty": (b"", True),
        "noise": (b"\xff" + draw.randbytes(300), True),
        "cut": (content[: draw.randrange(len(content))], coded or kind == ".json"),
        "nul": (content[:9] + b"\0" + content[9:], settings),
        "utf-16": (content.decode("latin-1").encode("utf-16"), kind != ".mat"),
        "mark": (b"\xef\xbb\xbf" + content, coded),
        "flipped": (bytes(byte ^ 1 if draw.random() < 0.01 else byte for byte in content), False),
        "magic": (b"PAR1\0\0CDF" + content[4:], coded or kind == ".mat"),
        "comma": (content.replace(b".", b","), False),
        "ragged": (content.replace(b"\n", b'\n1,2\n"\n', 9), False),
        "doubled": (re.sub(rb"(.+)\n", rb"\1,\1\n", content), False),
        "twice": (content + b"\n" + content, settings),
        "a key twice": (content.replace(b"{", b'{"zzz": 1, "zzz": 2, ', 1), False),
        "text": (draw.choice([*CASES["texts"], *LONG_TEXTS]).encode(), True),
        "missing": (b"", True),
        "folder": (b"", True),
    }
    way = draw.choice(list(ways))
    damaged, wrong = ways[way]
    path.write_bytes(damaged)
    if way in ("missing", "folder"):
        path.unlink()
    if way == "folder":
        path.mkdir()
    return way, wrong


def _settings(draw: random.Random, path: Path) -> tuple[str, bool]:
    is_yaml = path.suffix == ".yaml"
    tree = yaml.safe_load(path.read_text()) if is_yaml else json.loads(path.read_text())
    place, key = draw.choice(list(_places(tree)))
    old, way = place[key], draw.choice(["value", "value", "value", "maybe", "unknown", "gone"])
    what, wrong = draw.choice(CASES["other values"] if way == "maybe" else [*CASES["values"], HUGE]), False
    if way == "gone" and isinstance(place, dict):
        del place[key]
    elif way == "unknown" and isinstance(place, dict):
        place["zzz_unknown"], wrong = what, is_yaml
    else:
        place[key] = what
        wrong = way == "value" and is_yaml and type(old) in (int, float) and key not in CASES["may be anything"]
    path.write_text(yaml.safe_dump(tree, sort_keys=False) if is_yaml else json.dumps(tree))
    return f"{way} {key}={str(what)[:40]}", wrong


def _places(tree: Any) -> Iterator[tuple[Any, Any]]:
    """Every value in nested mappings and lists, as its container and key."""
    for key in tree if isinstance(tree, dict) else range(len(tree)):
        yield tree, key
        if isinstance(tree[key], dict | list):
            yield from _places(tree[key])


def _tensors(draw: random.Random, path: Path) -> tuple[str, bool]:
    numpy = importlib.import_module("safetensors.numpy")
    tensors = numpy.load_file(path)
    name, way = draw.choice(list(tensors)), draw.choice(["nan", "shape", "gone", "new", "type", "scalar"])
    old, odd = tensors.pop(name), np.zeros((3, 5), np.float32)
    kept = {"zzz": odd, name: old} if way == "new" else {}
    changed = {"nan": np.full_like(old, np.nan), "shape": odd, "type": old.astype(np.int64), "scalar": odd[0, 0]}
    numpy.save_file(tensors | kept | ({name: np.asarray(changed[way])} if way in changed else {}), path)
    return f"{way} {name}", True


def _table(draw: random.Random, path: Path) -> tuple[str, bool]:
    recording = path.stem == "rec"
    table = pd.read_parquet(path) if path.suffix == ".parquet" else pd.read_csv(path.with_suffix(".csv"), comment="#")
    name = draw.choice(list(table))
    word, with_unit = name.split(" ")[0], recording and " [" in name
    tables = {
        "rows": (table[:0], recording),
        "one": (table[:1], recording),
        "reversed": (table[::-1], False),
        "again": (table.loc[table.index.repeat(2)], False),
        "gone": (table.drop(columns=name), word in ("time", "command", "verdict")),
        "unit": (table.rename(columns={name: f"{word} [furlong]"}), with_unit),
    }
    way = draw.choice([*tables, *CELLS])
    if way in tables:
        table, wrong = tables[way]
    else:
        rows = draw.choice([slice(None), slice(len(table) // 3, len(table) // 2)])
        value = table[name].iloc[0] if way == "same" else CELLS[way]
        table[name] = table[name].astype(object)
        table.iloc[rows, list(table).index(name)] = value
        needed = word in ("time", "command") and rows == slice(None)
        wrong = needed and way in CASES["cells"] and (recording or way == "text")
    write_table(table, path)
    return f"{way} {name}", wrong


def write_table(table: pd.DataFrame, path: Path) -> None:
    """Write a table as a file of the kind of its name; cells of mixed types become text, or no number."""
    table, kind = table.infer_objects(), path.suffix
    if kind != ".mat":
        mixed = {name: str for name in table if table[name].dtype == object}
        write = table.to_csv if kind == ".csv" else table.astype(mixed).to_parquet
        write(path, index=False)
        return
    channels = {}  # unit and values by name
    for name in map(str, table):
        word, _, unit = name.partition(" [")
        channels[word] = unit.rstrip("]"), pd.to_numeric(table[name], errors="coerce").to_numpy(np.float64)
    savemat(path, {name: {"values": values, "unit": unit} for name, (unit, values) in channels.items()})
