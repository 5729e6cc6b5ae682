"""Weights, checkpoints and logs that were damaged in many ways: one line or a working controller, never a traceback."""

import copy
import json
import os
import warnings
from pathlib import Path

import numpy as np
import pytest
from refusal import redigested, refused
from safetensors.numpy import load, save

from hydro_agents.detection.head import LeakageHead
from hydro_agents.learning.policy import PolicyController
from hydro_agents.learning.progress import STEPS, ProgressFile, read_progress
from hydro_agents.running.folders import pretrained_folder
from hydro_agents.running.weights import load_checkpoint, load_weights, require, save_checkpoint, save_weights
from hydro_env import ConfigurationError

CASES = int(os.environ.get("HYDRO_FUZZ_CASES", "60"))
LOADERS = {"policy": PolicyController.load, "leakage_head": LeakageHead.load}
ODD_VALUES = (
    *("text", "", "1", None, True, [], {}, [[]], [None], {"a": 1}),
    *(0, -1, 1.5, 10**30, -(10**30), 1e308, float("inf"), float("-inf"), float("nan")),
)
ODD_TEXTS = (
    *(b"", b"null", b"[]", b"5", b'"text"', b"{", b"\xff\xfe\x00", b"1e999", b"9" * 6000),
    *(b"[" * 100_000, b'{"a":' * 50_000, b"NaN", b'{"format": "hydro_env policy", "format_version": 1e999}'),
)
ODD_DTYPES = ("complex64", "int8", "int64", "bool", "float64", "float16", "uint64")


def refusal(function, *arguments):
    """What a function returns, and the one line by which it refused."""
    try:
        return function(*arguments), None
    except ConfigurationError as error:
        return None, str(error)


def tried(loader, path):
    """Load and use what was loaded; True if it was refused with a line for each mistake."""

    def use():
        found = loader(path)
        layout = found.features.layout if isinstance(found, PolicyController) else found.settings.layout
        found.predict(np.zeros((2, len(layout.names)), dtype=np.float32))

    _, line = refusal(use)
    if line is not None:
        heading, *mistakes = line.split("\n")
        assert not mistakes or ("mistakes" in heading and all(mistake.startswith("  ") for mistake in mistakes))
        assert all(len(text) < 1500 for text in (heading, *mistakes))
    return line is not None


def copied(name, folder):
    """Shipped weights in a folder."""
    for suffix in (".json", ".safetensors"):
        (folder / f"{name}{suffix}").write_bytes((pretrained_folder() / f"{name}{suffix}").read_bytes())
    return folder / name


def places(value, at=()):
    """The paths of all entries of a JSON."""
    entries = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    for key, inner in entries:
        yield (*at, key)
        yield from places(inner, (*at, key))


def with_change(settings, place, generator):
    changed = copy.deepcopy(settings)
    inner = changed
    for key in place[:-1]:
        inner = inner[key]
    if generator.random() < 0.3:
        del inner[place[-1]]
    else:
        inner[place[-1]] = ODD_VALUES[generator.integers(len(ODD_VALUES))]
    return changed


def changed_settings(content, generator):
    """JSON of settings with an odd value or without one."""
    settings = json.loads(content)
    everything = [place for place in places(settings) if place[0] != "training"]
    for _ in range(CASES):
        place = everything[generator.integers(len(everything))]
        yield json.dumps(with_change(settings, place, generator)).encode(), 0.6


def no_json(content, generator):
    yield from ((text, 1.0) for text in ODD_TEXTS)


def changed_tensors(content, generator):
    """Tensors of another type or shape, that are not finite, or gone."""
    tensors = load(content)
    known = sorted(name for name in tensors if not name.startswith("critic"))  # of earlier versions, not read
    for case in range(CASES):
        name = known[generator.integers(len(known))]
        array = tensors[name]
        changes = (
            lambda array=array: array.astype(ODD_DTYPES[generator.integers(len(ODD_DTYPES))]),
            lambda array=array: array.reshape(-1)[: generator.integers(0, array.size)],
            lambda array=array: np.full_like(array, [np.nan, np.inf][generator.integers(2)]),
            lambda array=array: array[None],
        )
        rest = {other: values for other, values in tensors.items() if other != name}
        yield save(rest | ({name: changes[case % 5]()} if case % 5 < 4 else {})), 1.0


def changed_bytes(content, generator):
    header = 8 + int.from_bytes(content[:8], "little")
    for case in range(CASES):
        damaged = bytearray(content)
        if case % 3 == 0:
            damaged = damaged[: generator.integers(0, len(content))]
        else:
            for _ in range(generator.integers(1, 6)):
                damaged[generator.integers(header)] = generator.integers(256)
        yield bytes(damaged), 0.0
    for kind in ("BF16", "F8_E4M3", "F8_E5M2", "F64", "I8"):
        yield content.replace(b'"F32"', f'"{kind}"'.encode()), 1.0


@pytest.mark.parametrize("name", LOADERS)
@pytest.mark.parametrize(
    ("damage", "suffix"),
    [(changed_settings, "json"), (no_json, "json"), (changed_tensors, "safetensors"), (changed_bytes, "safetensors")],
)
def test_damaged_weights_are_refused_or_work(damage, suffix, name, tmp_path):
    path = copied(name, tmp_path)
    file = path.with_name(f"{name}.{suffix}")
    refused_of = {}  # by the share that must be refused
    for content, share in damage(file.read_bytes(), np.random.default_rng(0)):
        file.write_bytes(content)
        redigested(path)
        refused_of.setdefault(share, []).append(tried(LOADERS[name], path))
        assert refused_of[share][-1] or share < 1.0, content[:80]
    assert all(np.mean(refused) >= share for share, refused in refused_of.items())
    file.unlink()
    file.mkdir()
    assert tried(LOADERS[name], path)


@pytest.mark.parametrize("name", LOADERS)
@pytest.mark.parametrize("path", [".", "..", "/", "", "a\0b", "absent", "absent/absent"])
def test_paths_that_name_no_weights(name, path, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert tried(LOADERS[name], path)
    assert tried(LOADERS[name], Path(path))
    if not path.startswith("absent"):
        with refused("must be the name of weights"):
            load_weights(path, name)


TENSORS = {"weight": np.arange(6, dtype=np.float32).reshape(2, 3), "count": np.array(3)}


def test_a_checkpoint_holds_what_was_put_in(tmp_path):
    save_checkpoint(tmp_path / "c.safetensors", "kind", TENSORS, {"epoch": 3, "list": [1, "two"]})
    tensors, described = load_checkpoint(tmp_path / "c.safetensors", "kind")
    assert (described["epoch"], described["list"]) == (3, [1, "two"])
    assert all(np.array_equal(tensors[name], array) for name, array in TENSORS.items())
    assert all((tensors[name].dtype, tensors[name].shape) == (a.dtype, a.shape) for name, a in TENSORS.items())
    with refused("holds 'hydro_env kind': must be 'hydro_env other' of format 1"):
        load_checkpoint(tmp_path / "c.safetensors", "other")


def test_a_checkpoint_with_any_byte_changed_is_refused(tmp_path):
    file = tmp_path / "c.safetensors"
    save_checkpoint(file, "kind", TENSORS, {"epoch": 3})
    content, generator = file.read_bytes(), np.random.default_rng(3)
    for case in range(2 * CASES):
        damaged = bytearray(content)
        at = int(generator.integers(len(content)))
        damaged[at] = (damaged[at] + int(generator.integers(1, 256))) % 256
        file.write_bytes(bytes(damaged) if case % 2 else content[:at])
        found, line = refusal(load_checkpoint, file, "kind")
        assert line is None or "\n" not in line
        if found is not None:  # blanks of the header may change
            tensors, described = found
            assert described["epoch"] == 3
            assert all(np.array_equal(tensors[name], array) for name, array in TENSORS.items())


@pytest.mark.parametrize(
    ("found", "message"),
    [
        ({}, "holds no tensor 'weight'"),
        ({"weight": np.zeros((3, 2), dtype=np.float32)}, r"holds float32 of shape \(3, 2\), must be"),
        ({"weight": np.zeros((2, 3))}, "holds float64 of shape"),
        ({"weight": np.full((2, 3), np.inf, dtype=np.float32)}, "not finite"),
    ],
)
def test_tensors_must_be_those_that_are_wanted(found, message):
    wanted = {"weight": TENSORS["weight"]}
    with refused(f"file: .*{message}"):
        require(found, wanted, "file")
    require({"weight": np.full((2, 3), np.inf, dtype=np.float32)}, wanted, "file", finite=False)


def test_logs_that_were_changed(tmp_path):
    file = tmp_path / "progress.csv"
    good = f"{STEPS},a,b\n" + "".join(f"{100 * n},{n}.5,\n" for n in range(1, 9))
    file.write_text(good)
    assert [row[STEPS] for row in read_progress(file)] == [100.0 * n for n in range(1, 9)]
    assert [row["a"] for row in read_progress(file, 300)] == [1.5, 2.5, 3.5]
    content, generator = good.encode(), np.random.default_rng(4)
    for _ in range(2 * CASES):
        damaged = bytearray(content)
        for _ in range(generator.integers(1, 4)):
            damaged[generator.integers(len(content))] = generator.integers(256)
        file.write_bytes(bytes(damaged))
        with warnings.catch_warnings(record=True):
            rows = read_progress(file)  # no result depends on the log: what is damaged is left out
        assert all(isinstance(value, float) for row in rows for value in row.values())
    file.write_text(good.replace("300,", "3?0,"))
    with pytest.warns(UserWarning, match=r"progress.csv: is no log of a training"):
        assert not read_progress(file, 500)
    file.write_bytes(b"\xff" * 9)
    with pytest.warns(UserWarning, match="is no log of a training"):
        assert not ProgressFile(file, 500)._rows
    assert file.read_bytes() == b""  # the resumed training begins a new log


def test_weights_of_another_format_are_refused(tmp_path):
    path = copied("policy", tmp_path)
    file = path.with_name("policy.json")
    file.write_text(json.dumps(json.loads(file.read_text()) | {"format_version": 1}))
    with refused("of format 2"):
        load_weights(path, "policy")


@pytest.mark.parametrize("suffix", ["safetensors", "json"])
def test_weights_with_a_flipped_bit_are_refused(suffix, tmp_path):
    save_weights(tmp_path / "w", "kind", TENSORS, {"gain": 0.125, "names": ["a", "b"]})
    file, generator = tmp_path / f"w.{suffix}", np.random.default_rng(5)
    content, (tensors, settings) = file.read_bytes(), load_weights(tmp_path / "w", "kind")
    assert settings["gain"] == 0.125
    assert all(np.array_equal(tensors[name], array) for name, array in TENSORS.items())
    for _ in range(200):
        damaged = bytearray(content)
        damaged[generator.integers(len(content))] ^= 1 << int(generator.integers(8))
        file.write_bytes(damaged)
        with pytest.raises(ConfigurationError):
            load_weights(tmp_path / "w", "kind")


def test_names_with_dots_are_different_weights(tmp_path):
    for rate in ("0.001", "0.002", "0.json.5"):
        written = save_weights(tmp_path / f"ppo_lr{rate}", "policy", {"rate": np.float32([len(rate)])}, {"rate": rate})
        assert written == tmp_path / f"ppo_lr{rate}.safetensors"
    for rate in ("0.001", "0.002", "0.json.5"):
        for suffix in ("", ".json", ".safetensors"):
            tensors, settings = load_weights(tmp_path / f"ppo_lr{rate}{suffix}", "policy")
            assert settings["rate"] == rate
            assert tensors["rate"] == len(rate)
