"""Damage to files of every kind, for ``hostile_inputs.py``: each way says whether the file is wrong beyond doubt."""

from __future__ import annotations

import importlib
import json
import random
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import yaml

HUGE = 10**400
VALUES = ["text", float("nan"), float("inf"), -float("inf"), {}, {"a": 1}, [], "", 1e300, -1e300, HUGE, "1e5x"]
MAYBE = [0, -1, None, True, 1e-300, 1e6, "1e3", "1:30", [1], 2**63]
TEXTS = [
    *("[" * 5000, "a: " + "{b: " * 3000, "- " * 3000 + "1", "&a [*a]", "a: &a {b: *a}", "text", "3", "null", "[1, 2]"),
    *("!!python/object/apply:os.system [id]", "a: 1\n---\nb: 2", "\t", "? [a]\n: 1", "{", ": : :", "%YAML 9.9\n---\n"),
    *(
        "2026-01-01",
        "<<: 3",
        "a: &x [1]\n" + "b: [" + "*x, " * 500 + "1]",
        "# nothing",
        "\x00",
        "{a: 1}}",
        "~: ~",
        "é: é",
    ),
    "a: &a [x, x]\nb: &b [*a, *a]\nc: &c [*b, *b]\nd: &d [*c, *c]\ne: [*d, *d]",
]
UNITS = {"position": "mm", "pressure_a": "bar", "pressure_b": "bar", "spool_position": "%", "command": "V"}
NUMBERS = ("[", "size", "low", "high", "moving", "temperature", "bytes", "time", "until", "score", "probability")


def damage(draw: random.Random, path: Path) -> tuple[str, bool]:
    """Damage a file in place; how, and whether what is there is wrong beyond doubt."""
    kind = path.suffix.lstrip(".")
    if draw.random() < 0.3 or kind == "py":
        return _bytes(draw, path)
    if kind in ("yaml", "json"):
        return _settings(draw, path)
    return _tensors(draw, path) if kind == "safetensors" else _table(draw, path)


def _bytes(draw: random.Random, path: Path) -> tuple[str, bool]:
    content = path.read_bytes()
    ways: dict[str, tuple[bytes, bool]] = {
        "empty": (b"", path.suffix != ".py" and path.stem != "task"),  # a task may leave all at its defaults
        "noise": (b"\xff" + draw.randbytes(300), path.suffix != ".py"),
        "cut": (content[: draw.randrange(len(content))], path.suffix in (".json", ".safetensors", ".parquet")),
        "nul": (content[:9] + b"\0" + content[9:], path.suffix in (".yaml", ".json")),
        "utf-16": (content.decode("latin-1").encode("utf-16"), path.suffix not in (".py", ".mat", ".tdms", ".mf4")),
        "mark": (b"\xef\xbb\xbf" + content, path.suffix in (".safetensors", ".parquet")),
        "flipped": (bytes(byte ^ 1 if draw.random() < 0.01 else byte for byte in content), False),
        "magic": (b"PAR1\0\0CDF" + content[4:], path.suffix in (".parquet", ".safetensors", ".mf4", ".tdms", ".mat")),
    }
    way = draw.choice([*ways, "missing", "folder"])
    path.unlink()
    if way == "folder":
        path.mkdir()
    elif way != "missing":
        path.write_bytes(ways[way][0])
    return way, way not in ways or ways[way][1]


def _settings(draw: random.Random, path: Path) -> tuple[str, bool]:
    text, is_json = path.read_text(), path.suffix == ".json"
    write = json.dumps if is_json else lambda tree: yaml.safe_dump(tree, sort_keys=False)
    tree = json.loads(text) if is_json else yaml.safe_load(text)
    places = list(_places(tree))
    place, key = draw.choice(places)
    old, way = place[key], draw.choice(["value", "value", "value", "maybe", "unknown", "twice", "text", "gone"])
    wrong = way not in ("maybe", "gone")
    if way == "text":
        chosen = draw.choice(TEXTS)
        path.write_text(chosen)
        return f"text {chosen[:40]!r}", path.stem != "task" or chosen != "# nothing"
    if way == "twice":
        first = next(iter(tree))
        path.write_text(f'{{"{first}": 3, {text.lstrip()[1:]}' if is_json else f"{text}\n{first}: 3\n")
        return f"twice {first}", not is_json
    if way == "unknown":
        maps = [tree, *(place[key] for place, key in places if isinstance(place[key], dict))]
        draw.choice(maps)["zzz_unknown"] = draw.choice([1, "text", None, {}])
        wrong = not is_json
    elif way == "gone" and isinstance(place, dict):
        del place[key]
    else:
        place[key] = draw.choice(MAYBE if way == "maybe" else VALUES)
        wrong = wrong and key not in ("internal_resistance", "wall_bulk_modulus")  # may be without end
        wrong = wrong and isinstance(old, int | float) and not isinstance(old, bool) and not is_json
    path.write_text(write(tree))
    return f"{way} {key}={str(place[key] if way != 'gone' and way != 'unknown' else '')[:40]}", wrong


def _places(tree: Any) -> Iterator[tuple[Any, Any]]:
    """Every value in nested mappings and lists, as its container and key."""
    for key in tree if isinstance(tree, dict) else range(len(tree)):
        yield tree, key
        if isinstance(tree[key], dict | list):
            yield from _places(tree[key])


def _tensors(draw: random.Random, path: Path) -> tuple[str, bool]:
    from safetensors.numpy import load_file, save_file

    tensors = load_file(path)
    name, way = draw.choice(list(tensors)), draw.choice(["nan", "shape", "gone", "new", "type", "scalar"])
    changed = {
        "nan": np.full_like(tensors[name], np.nan),
        "shape": np.zeros((3, 5), np.float32),
        "type": tensors[name].astype(np.int64),
        "scalar": np.zeros((), np.float32),
    }
    if way == "gone":
        del tensors[name]
    else:
        tensors["zzz" if way == "new" else name] = changed.get(way, np.zeros(2, np.float32))
    save_file(tensors, path)
    return f"{way} {name}", True


def _table(draw: random.Random, path: Path) -> tuple[str, bool]:
    recording = path.stem == "rec"
    table = pd.read_parquet(path) if path.suffix == ".parquet" else pd.read_csv(path.with_suffix(".csv"), comment="#")
    name = draw.choice(list(table))
    ways = ["rows", "one", "text", "nan", "same", "large", "whole", "reversed", "again", "gone", "unit", "bool", "inf"]
    way, wrong = draw.choice([*ways, "list", "date", "comma", "ragged", "doubled", "bare"]), False
    number = any(word in name for word in NUMBERS) or "recording" in name
    if way in ("rows", "one"):
        table, wrong = table[: int(way == "one")], recording
    elif way in ("reversed", "again"):
        table = table[::-1] if way == "reversed" else table.loc[table.index.repeat(2)]
    elif way == "gone":
        table, wrong = table.drop(columns=name), name.split(" ")[0] in ("time", "command", "score", "verdict")
    elif way in ("unit", "bare"):
        other = name.split(" ")[0] + " [furlong]" * (way == "unit")
        table, wrong = (
            table.rename(columns={name: other}),
            recording and " [" in name and (way == "unit" or "time" not in name),
        )
    else:
        fill = {
            "text": "text",
            "nan": np.nan,
            "same": table[name].iloc[0],
            "large": 1e308,
            "whole": 10**18,
            "inf": np.inf,
        }
        fill |= {"bool": True, "date": "2026-13-45T99:00:00", "list": "[1, 2]"}
        if way in fill:
            rows = draw.choice([slice(None), slice(len(table) // 3, len(table) // 2)])
            table[name] = table[name].astype(object)
            table.iloc[rows, list(table).index(name)] = fill[way]
            whole = rows == slice(None) and ("time" in name or "command" in name or "score" in name)
            wrong = number and whole and way in ("text", "nan", "list", "large", "inf") and (recording or way == "text")
    wrong &= path.suffix != ".mf4" or "time" not in name or way not in ("gone", "unit")  # its channels have stamps
    _write(table, path)
    if path.suffix == ".csv" and way in ("comma", "ragged", "doubled"):
        lines = path.read_text().split("\n")
        changed = {"comma": [line.replace(".", ",") for line in lines], "ragged": [*lines[:9], "1,2", '"', *lines[9:]]}
        path.write_text("\n".join(changed.get(way, [f"{line},{line}" for line in lines])))
    return f"{way} {name}", wrong


def _write(table: pd.DataFrame, path: Path) -> None:
    """Write a table as a file of the kind of its name; cells of mixed types become text."""
    kind = path.suffix
    if kind == ".csv":
        table.to_csv(path, index=False)
        return
    table = table.infer_objects()
    table = table.assign(**{k: v.astype(str) for k, v in table.items() if kind == ".parquet" and v.dtype == object})
    parts = {str(name).split(" ")[0]: (str(name).partition("[")[2][:-1], table[name]) for name in table}
    numbers = {k: (unit, pd.to_numeric(v, errors="coerce").to_numpy(np.float64)) for k, (unit, v) in parts.items()}
    if kind == ".parquet":
        table.to_parquet(path, index=False)
    elif kind == ".mat":
        scipy_io = importlib.import_module("scipy.io")

        scipy_io.savemat(path, {k: {"values": v, "unit": unit} for k, (unit, v) in numbers.items()})
    elif kind == ".tdms":
        nptdms = importlib.import_module("nptdms")

        with nptdms.TdmsWriter(path) as file:
            file.write_segment([nptdms.ChannelObject("g", k, v, {"unit_string": u}) for k, (u, v) in numbers.items()])
    else:
        asammdf = importlib.import_module("asammdf")

        time = numbers.pop("time", ("", np.arange(len(table)) * 0.005))[1]
        with asammdf.MDF() as mdf:
            for k, (unit, v) in numbers.items():
                mdf.append([asammdf.Signal(v, time, name=k, unit=unit)])
            mdf.save(path, overwrite=True)


def prepare_tables(base: Path) -> None:
    """Recordings of all kinds, a map, predictions and a program."""
    for kind in ("parquet", "mat", "tdms", "mf4"):
        _write(pd.read_csv(base / "rec.csv", comment="#"), base / f"rec.{kind}")
    mapping: dict[str, dict[str, Any]] = {"time": {"column": "time [s]", "unit": "s"}}
    mapping |= {name: {"column": f"{name} [{unit}]", "unit": unit, "gain": 1.0} for name, unit in UNITS.items()}
    (base / "map.yaml").write_text(yaml.safe_dump(mapping, sort_keys=False))
    labels = pd.read_parquet(base / "axes/hidden/test_labels")
    rows = pd.DataFrame({"recording": np.repeat(labels["recording"].to_numpy(), 5)})
    rows["time"] = np.tile(10.0 * np.arange(1, 6), len(labels))
    rows = rows.assign(score=0.5, alarm=False, probability=0.5, cause="none", size=0.1, low=0.0, high=0.2)
    rows.to_parquet(base / "predictions.parquet", index=False)
    (base / "code").mkdir()
    (base / "code/detect.py").write_text(
        "import sys\nfor line in sys.stdin:\n    if not line.strip(): print('{}', flush=True)\n"
    )
