"""The state of a torch optimiser as named arrays, for checkpoints."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from hydro_agents.running.weights import Tensors, require
from hydro_env import ConfigurationError

PREFIX = "optimiser."


def optimiser_tensors(optimiser: Any) -> dict[str, NDArray[Any]]:
    """The state of a torch optimiser as arrays, ``optimiser.<parameter>.<name>``; none before its first step."""
    return {
        f"{PREFIX}{index}.{name}": np.array(value.detach().cpu().numpy())
        for index, entry in optimiser.state_dict()["state"].items()
        for name, value in entry.items()
    }


def restore_optimiser(optimiser: Any, tensors: Tensors, where: str) -> None:
    """Restore the arrays of :func:`optimiser_tensors` into an Adam optimiser of the same parameters.

    Raises:
        ConfigurationError: the arrays do not belong to such an optimiser; ``where`` names the file.
    """
    import torch

    stored = {name: array for name, array in tensors.items() if name.startswith(PREFIX)}
    state: dict[int, dict[str, Any]] = {}
    wanted: dict[str, NDArray[Any]] = {}
    if stored:
        parameters = [parameter for group in optimiser.param_groups for parameter in group["params"]]
        for index, parameter in enumerate(parameters):
            if parameter.requires_grad:
                like = parameter.detach().cpu().numpy()
                entry = {"step": np.zeros((), dtype=np.float32), "exp_avg": like, "exp_avg_sq": like}
                wanted |= {f"{PREFIX}{index}.{name}": array for name, array in entry.items()}
                state[index] = {}
        require(stored, wanted, where)
        unknown = next((name for name in stored if name not in wanted), None)
        if unknown is not None:
            raise ConfigurationError(f"{where}: tensor '{unknown}' does not belong to this optimiser")
    for name in wanted:
        _, index_text, key = name.split(".")
        state[int(index_text)][key] = torch.from_numpy(np.array(stored[name]))
    optimiser.load_state_dict({"state": state, "param_groups": optimiser.state_dict()["param_groups"]})
