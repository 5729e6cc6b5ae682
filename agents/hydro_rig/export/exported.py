"""An exported controller: its contract (inputs and outputs with units and timing, and its origin), and how it runs."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping, Sequence
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydantic import ConfigDict, Field

from hydro_agents.controllers.base import Observation, as_batch
from hydro_env import ConfigurationError, TaskConfig, __version__
from hydro_env.files import Group, read_json, read_yaml, validate
from hydro_env.types import Floats
from hydro_env.units import FULL_VOLTAGE
from hydro_rig.export.measured import MeasuredSignals

FILE = "contract.json"
MODEL_FILE = "controller.onnx"
TASK_FILE = "task.yaml"
_FORMAT = "hydro_env exported"
_MOST_BYTES = 1_000_000


class _Signal(Group):
    """A signal of a contract, by which the task's signals are found."""

    model_config = ConfigDict(extra="ignore")
    name: str


class _StatePart(Group):
    """A part of the state: ``size`` numbers, one part after the other."""

    model_config = ConfigDict(extra="ignore")
    size: int = Field(ge=1, le=1_000_000)


class Contract(Group):
    """What runs a folder needs of its ``contract.json``."""

    model_config = ConfigDict(extra="ignore")
    signals: tuple[_Signal, ...] = Field(min_length=1)
    state: tuple[_StatePart, ...]
    files: dict[str, str] = Field(description="SHA-256 of each file")


def sealed(
    what: str,
    contents: Mapping[str, str | bytes],
    facts: Mapping[str, Any],
    command: str,
    packages: Sequence[Any] = (np,),
) -> dict[str, bytes]:
    """The files of a folder with its ``contract.json``.

    Args:
        what: was exported.
        contents: of all other files, by name.
        facts: entries of the contract; versions, command and the SHA-256 of each file follow them.
        command: that wrote the folder.
        packages: whose versions matter.
    """
    files = {name: content.encode() if isinstance(content, str) else content for name, content in contents.items()}
    values = {
        "format": f"{_FORMAT} {what}",
        "format_version": 1,
        **facts,
        "versions": {"hydro_env": __version__} | {package.__name__: package.__version__ for package in packages},
        "command": command,
        "files": {name: hashlib.sha256(content).hexdigest() for name, content in files.items()},
    }
    values["digest"] = _digest(values)
    return {**files, FILE: (json.dumps(values, indent=2, ensure_ascii=False) + "\n").encode()}


def signal_facts(name: str, unit: str, low: float, high: float, limit: float, meaning: str) -> dict[str, Any]:
    """A signal in a contract: range of the sensor or of the stroke; values beyond ± the limit are clipped."""
    return {"name": name, "unit": unit, "range": [low, high], "limit": limit, "meaning": meaning}


def read_contract(folder: Path) -> Contract:
    """The contract of a folder, checked against its files.

    Raises:
        ConfigurationError: the folder has no contract, or the contract or a file was changed.
    """
    path = folder / FILE
    if not path.is_file():
        raise ConfigurationError(f"{folder}: holds no {FILE}: is not an exported controller")
    values = read_json(path, _MOST_BYTES)
    if values.get("format") != f"{_FORMAT} controller" or values.get("format_version") != 1:
        raise ConfigurationError(f"{path}: is not a contract of an exported controller of format 1")
    if values.get("digest") != _digest(values):
        raise ConfigurationError(f"{path}: was changed after the export: export the controller again")
    contract = validate(Contract, values, str(path))
    for name, digest in contract.files.items():
        file = folder / name
        if Path(name).name != name or not file.is_file():
            raise ConfigurationError(f"{folder}: holds no '{name}', which its contract names")
        if hashlib.sha256(file.read_bytes()).hexdigest() != digest:
            raise ConfigurationError(f"{file}: was changed after the export: export the controller again")
    return contract


def _digest(values: Mapping[str, Any]) -> str:
    """SHA-256 of everything else as JSON with sorted keys."""
    content = {name: value for name, value in values.items() if name != "digest"}
    return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()


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
        for wanted in contract.signals:
            if wanted.name not in signals.places:
                raise ConfigurationError(f"{folder}: needs the signal '{wanted.name}', which its task does not have")
        columns = [signals.places[wanted.name] for wanted in contract.signals]
        size = sum(part.size for part in contract.state)
        return cls((folder / MODEL_FILE).read_bytes(), signals, columns, size)

    @cached_property
    def session(self) -> Any:
        """The model in onnxruntime."""
        return onnx_session(self._model)

    def __getstate__(self) -> dict[str, Any]:
        return {name: value for name, value in self.__dict__.items() if name != "session"}  # it cannot be pickled

    def predict(
        self,
        observation: Observation,
        state: Floats | None = None,
        episode_start: NDArray[np.bool_] | None = None,
        deterministic: bool = True,
    ) -> tuple[NDArray[np.float32], Floats]:
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
