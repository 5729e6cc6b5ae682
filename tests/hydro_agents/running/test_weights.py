"""Weights, checkpoints and logs that were damaged: one line or a working controller, never a traceback."""

import numpy as np
import pytest
from refusal import refused

from hydro_agents.detection.head import LeakageHead
from hydro_agents.learning.policy import PolicyController
from hydro_agents.running.weights import load_checkpoint, save_checkpoint
from hydro_env import ConfigurationError

CASES = 20
LOADERS = {"policy": PolicyController.load, "leakage_head": LeakageHead.load}
TENSORS = {"weight": np.arange(6, dtype=np.float32).reshape(2, 3), "count": np.array(3)}


@pytest.mark.parametrize("path", [".", "..", "/", "", "a\0b", "absent/absent"])
def test_paths_that_name_no_weights(path, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for load in LOADERS.values():
        with refused("."):
            load(path)


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
