"""The recurrent layer of a policy, in NumPy: a long short-term memory (Hochreiter & Schmidhuber, 1997)."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from hydro_agents.running.weights import Tensors, require

Floats = NDArray[np.float32]


class LSTM(NamedTuple):
    """One layer with H cells; its gates are input, forget, cell and output, as in torch."""

    inputs: Floats  # (4 H, inputs)
    recurrent: Floats  # (4 H, H)
    bias: Floats  # (4 H,)

    @property
    def cells(self) -> int:
        """Number of cells H."""
        return int(self.recurrent.shape[1])

    def __call__(
        self, values: Floats, memory: Floats | None, episode_start: NDArray[np.bool_] | None
    ) -> tuple[Floats, Floats]:
        """Output (N, H) for inputs (N, inputs), and the next memory (N, 2 H): output and cells.

        The memory is zero at the start of an episode.
        """
        if memory is None:
            memory = np.zeros((len(values), 2 * self.cells), dtype=np.float32)
        elif episode_start is not None and np.any(episode_start):
            memory = np.where(np.asarray(episode_start)[:, None], np.float32(0.0), memory)
        output, cells = memory[:, : self.cells], memory[:, self.cells :]
        gates = values @ self.inputs.T + output @ self.recurrent.T + self.bias
        shares = [gates[:, place * self.cells : (place + 1) * self.cells] for place in range(4)]
        entry, kept, new, shown = (np.tanh(x) if place == 2 else _sigmoid(x) for place, x in enumerate(shares))
        cells = kept * cells + entry * new
        output = shown * np.tanh(cells)
        return output, np.concatenate([output, cells], axis=1)

    @classmethod
    def from_torch(cls, layer: Any) -> LSTM:
        """The weights of a ``torch.nn.LSTM`` with one layer."""
        names = ("weight_ih_l0", "weight_hh_l0", "bias_ih_l0", "bias_hh_l0")
        inputs, recurrent, *biases = (getattr(layer, name).detach().cpu().numpy().copy() for name in names)
        return cls(inputs, recurrent, biases[0] + biases[1])

    def tensors(self) -> dict[str, NDArray[Any]]:
        """The weights by name, for a file."""
        return {f"lstm.{name}": value for name, value in self._asdict().items()}

    @classmethod
    def stored(cls, tensors: Tensors, cells: int, inputs: int, path: Any) -> LSTM:
        """The weights of a file.

        Raises:
            ConfigurationError: they are missing or have other shapes.
        """
        shapes = ((4 * cells, inputs), (4 * cells, cells), (4 * cells,))
        empty = cls(*(np.empty(shape, dtype=np.float32) for shape in shapes))
        require(tensors, empty.tensors(), path)
        return cls(*(tensors[name] for name in empty.tensors()))


def _sigmoid(x: Floats) -> Floats:
    value: Floats = np.float32(0.5) + np.float32(0.5) * np.tanh(np.float32(0.5) * x)
    return value
