"""Weights keep the name that they are given, and damaged ones are refused with one line."""

import numpy as np
import pytest

from hydro_agents.running.weights import load_weights, save_weights
from hydro_env import ConfigurationError

TENSORS = {"a": np.arange(6, dtype=np.float32).reshape(2, 3)}


def test_names_with_dots_are_different_weights(tmp_path):
    for rate in ("0.001", "0.002", "0.json.5"):
        written = save_weights(tmp_path / f"ppo_lr{rate}", "policy", {"rate": np.float32([len(rate)])}, {"rate": rate})
        assert written == tmp_path / f"ppo_lr{rate}.safetensors"
    for rate in ("0.001", "0.002", "0.json.5"):
        for suffix in ("", ".json", ".safetensors"):
            tensors, settings = load_weights(tmp_path / f"ppo_lr{rate}{suffix}", "policy")
            assert settings["rate"] == rate
            assert tensors["rate"] == len(rate)


@pytest.mark.parametrize("path", [".", "..", "/", "", "a\0b"])
def test_a_path_without_a_name_is_refused(path):
    with pytest.raises(ConfigurationError, match="must be the name of weights"):
        load_weights(path, "policy")
