"""Weights, checkpoints and logs that were damaged: one line or a working controller, never a traceback."""

import json
import os
import warnings

import numpy as np
import pytest
from refusal import redigested, refused
from safetensors.numpy import load, save

from hydro_agents.detection.head import LeakageHead
from hydro_agents.learning.policy import PolicyController
from hydro_agents.learning.progress import STEPS, ProgressFile, read_progress
from hydro_agents.running.folders import pretrained_folder
from hydro_agents.running.weights import load_checkpoint, load_weights, save_checkpoint, save_weights
from hydro_env import ConfigurationError

CASES = int(os.environ.get("HYDRO_FUZZ_CASES", "20"))
LOADERS = {"policy": PolicyController.load, "leakage_head": LeakageHead.load}
ODD_VALUES = ("text", None, True, [], {}, [None], 0, -1, 1.5, 10**30, 1e308, float("inf"), float("nan"))
ODD_TEXTS = (b"", b"null", b"[]", b"{", b"\xff\xfe\x00", b"1e999", b"9" * 6000, b"[" * 100_000, b'{"a":' * 50_000)
TENSORS = {"weight": np.arange(6, dtype=np.float32).reshape(2, 3), "count": np.array(3)}


def tried(loader, path):
    """Load and use what was loaded; True if it was refused with a line for each mistake."""
    try:
        found = loader(path)
        layout = found.features.layout if isinstance(found, PolicyController) else found.settings.layout
        found.predict(np.zeros((2, len(layout.names)), dtype=np.float32))
    except ConfigurationError as error:
        heading, *mistakes = str(error).split("\n")
        assert not mistakes or "mistakes" in heading
        assert all(len(text) < 1500 for text in (heading, *mistakes))
        return True
    return False


def copied(name, folder):
    """Shipped weights in a folder."""
    for suffix in (".json", ".safetensors"):
        (folder / f"{name}{suffix}").write_bytes((pretrained_folder() / f"{name}{suffix}").read_bytes())
    return folder / name


def changed_settings(content, generator):
    """JSON of settings in which a value at any depth is odd or gone."""
    for _ in range(CASES):
        settings = json.loads(content)
        settings.pop("training", None)
        place = settings
        while True:
            keys = list(place) if isinstance(place, dict) else list(range(len(place)))
            key = keys[generator.integers(len(keys))]
            if not (isinstance(place[key], dict | list) and place[key] and generator.random() < 0.9):
                break
            place = place[key]
        if generator.random() < 0.3:
            del place[key]
        else:
            place[key] = ODD_VALUES[generator.integers(len(ODD_VALUES))]
        yield json.dumps(settings).encode()


def changed_tensors(content, generator):
    """Tensors of another type or shape, that are not finite, or gone."""
    tensors = load(content)
    known = sorted(name for name in tensors if not name.startswith("critic"))  # of earlier versions, not read
    for case in range(CASES):
        name = known[generator.integers(len(known))]
        array = tensors[name]
        damaged = {
            0: array.astype(("complex64", "int8", "float64", "float16")[generator.integers(4)]),
            1: array.reshape(-1)[: generator.integers(0, array.size)],
            2: np.full_like(array, [np.nan, np.inf][generator.integers(2)]),
            3: array[None],
        }
        rest = {other: values for other, values in tensors.items() if other != name}
        if case % 5 in damaged:
            rest[name] = damaged[case % 5]
        yield save(rest)


def changed_bytes(content, generator):
    """Bytes that are cut, or wrong within the header."""
    header = 8 + int.from_bytes(content[:8], "little")
    for case in range(CASES):
        damaged = bytearray(content)
        for _ in range(generator.integers(1, 6)):
            damaged[generator.integers(header)] = generator.integers(256)
        yield bytes(damaged) if case % 3 else content[: generator.integers(0, len(content))]


@pytest.mark.parametrize("name", LOADERS)
@pytest.mark.parametrize(
    ("damage", "suffix", "share"),
    [
        (changed_settings, "json", 0.5),
        (lambda content, generator: ODD_TEXTS, "json", 1.0),
        (changed_tensors, "safetensors", 0.5),
        (changed_bytes, "safetensors", 0.0),
    ],
)
def test_damaged_weights_are_refused_or_work(damage, suffix, share, name, tmp_path):
    path = copied(name, tmp_path)
    file = path.with_name(f"{name}.{suffix}")
    refusals = []
    for content in damage(file.read_bytes(), np.random.default_rng(0)):
        file.write_bytes(content)
        redigested(path)
        refusals.append(tried(LOADERS[name], path))
    assert np.mean(refusals) >= share
    file.unlink()
    assert tried(LOADERS[name], path)


@pytest.mark.parametrize("path", [".", "..", "/", "", "a\0b", "absent/absent"])
def test_paths_that_name_no_weights(path, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert all(tried(loader, path) for loader in LOADERS.values())


def test_a_checkpoint_holds_what_was_put_in_and_is_refused_with_any_byte_changed(tmp_path):
    file = tmp_path / "c.safetensors"
    save_checkpoint(file, "kind", TENSORS, {"epoch": 3, "list": [1, "two"]})
    tensors, described = load_checkpoint(file, "kind")
    assert (described["epoch"], described["list"]) == (3, [1, "two"])
    for name, array in TENSORS.items():
        np.testing.assert_array_equal(tensors[name], array)
        assert (tensors[name].dtype, tensors[name].shape) == (array.dtype, array.shape)
    with refused("hydro_env other"):
        load_checkpoint(file, "other")
    content, generator = file.read_bytes(), np.random.default_rng(3)
    for case in range(2 * CASES):
        damaged = bytearray(content)
        at = int(generator.integers(len(content)))
        damaged[at] ^= int(generator.integers(1, 256))
        file.write_bytes(bytes(damaged) if case % 2 else content[:at])
        try:
            tensors, described = load_checkpoint(file, "kind")
        except ConfigurationError:
            continue
        assert described["epoch"] == 3  # blanks of the header may change
        assert all(np.array_equal(tensors[name], array) for name, array in TENSORS.items())


def test_logs_that_were_changed(tmp_path):
    file = tmp_path / "progress.csv"
    good = f"{STEPS},a,b\n" + "".join(f"{100 * n},{n}.5,\n" for n in range(1, 9))
    file.write_text(good)
    assert [row["a"] for row in read_progress(file, 300)] == [1.5, 2.5, 3.5]
    content, generator = good.encode(), np.random.default_rng(4)
    for _ in range(CASES):
        damaged = bytearray(content)
        damaged[generator.integers(len(content))] = generator.integers(256)
        file.write_bytes(bytes(damaged))
        with warnings.catch_warnings(record=True):
            rows = read_progress(file)  # no result depends on the log: what is damaged is left out
        assert all(isinstance(value, float) for row in rows for value in row.values())
    file.write_bytes(b"\xff" * 9)
    with pytest.warns(UserWarning, match="is no log of a training"):
        assert not ProgressFile(file, 500)._rows
    assert file.read_bytes() == b""  # the resumed training begins a new log


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
