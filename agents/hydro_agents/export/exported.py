"""An exported controller with the interface of a controller: ``controller.onnx`` runs in onnxruntime."""

from __future__ import annotations

from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hydro_agents.controllers.base import Floats, as_batch
from hydro_agents.export.contract import read_contract
from hydro_agents.export.measured_signals import MeasuredSignals
from hydro_env import ConfigurationError, TaskConfig
from hydro_env.files import read_yaml, validate
from hydro_env.units import FULL_VOLTAGE

MODEL_FILE = "controller.onnx"
TASK_FILE = "task.yaml"
_MOST_BYTES = 1_000_000


def onnx_session(model: bytes) -> Any:
    """A session of onnxruntime on one thread.

    Raises:
        ConfigurationError: onnxruntime is not installed, or rejects the model.
    """
    try:
        import onnxruntime
    except ImportError:
        text = "an exported controller needs the package onnxruntime: pip install 'hydro_env[export]'"
        raise ConfigurationError(text) from None
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = options.inter_op_num_threads = 1
    options.log_severity_level = 4
    try:
        return onnxruntime.InferenceSession(model, options, providers=["CPUExecutionProvider"])
    except Exception as error:  # onnxruntime has no common class of errors
        raise ConfigurationError(f"onnxruntime rejects the model: {' '.join(str(error).split())[:300]}") from error


class ExportedController:
    """A folder of ``hydro export`` with the interface of every controller.

    It turns observations back into measured signals and runs the ONNX model axis by axis. Its state is an array
    (N, numbers).
    """

    def __init__(self, model: bytes, signals: MeasuredSignals, columns: list[int], state_size: int) -> None:
        self._model, self._signals, self._columns, self._state_size = model, signals, columns, state_size
        self.layout = signals.layout
        self.made_for = signals.config
        _ = self.session

    @classmethod
    def load(cls, folder: str | Path) -> ExportedController:
        """Read a folder that ``hydro export`` wrote.

        Raises:
            ConfigurationError: the folder is of another kind, a file was changed, or onnxruntime is not installed.
        """
        folder = Path(folder)
        contract = read_contract(folder)
        for name in (MODEL_FILE, TASK_FILE):
            if name not in contract.files:
                raise ConfigurationError(f"{folder}: its contract names no {name}")
        config = validate(TaskConfig, read_yaml(folder / TASK_FILE), str(folder / TASK_FILE))
        signals = MeasuredSignals(config)
        known = [signal.name for signal in signals.signals]
        for wanted in contract.signals:
            if wanted.name not in known:
                raise ConfigurationError(f"{folder}: needs the signal '{wanted.name}', which its task does not have")
        columns = [known.index(wanted.name) for wanted in contract.signals]
        return cls((folder / MODEL_FILE).read_bytes(), signals, columns, contract.state_size)

    @cached_property
    def session(self) -> Any:
        """The model in onnxruntime."""
        return onnx_session(self._model)

    def __getstate__(self) -> dict[str, Any]:
        return {name: value for name, value in self.__dict__.items() if name != "session"}  # it cannot be pickled

    def predict(
        self,
        observation: Floats,
        state: NDArray[np.float64] | None = None,
        episode_start: NDArray[np.bool_] | None = None,
        deterministic: bool = True,
    ) -> tuple[NDArray[np.float32], NDArray[np.float64]]:
        """Commands for the observations; see :class:`~hydro_agents.controllers.base.Controller`."""
        del deterministic
        batch, single = as_batch(observation)
        count = len(batch)
        signals = self._signals.of_observation(batch)[:, self._columns]
        started = np.zeros(count, np.bool_) if episode_start is None else np.asarray(episode_start, dtype=np.bool_)
        if state is None:
            state, started = np.zeros((count, self._state_size)), np.ones(count, np.bool_)
        new, voltage = np.empty_like(state), np.empty((count, 1))
        for axis in range(count):
            inputs = {"signals": signals[axis], "state": state[axis], "start": started[axis : axis + 1]}
            voltage[axis], new[axis] = self.session.run(["voltage", "next_state"], inputs)
        command = (voltage / FULL_VOLTAGE).astype(np.float32)
        return (command[0] if single else command), new
