"""An exported controller: its contract (inputs and outputs with units and timing, and its origin), and how it runs."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from functools import cached_property
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import ConfigDict, Field

from hydro_agents.controllers.base import Observation, as_batch
from hydro_env import ConfigurationError, TaskConfig
from hydro_env.files import Group, read_json, read_yaml, validate
from hydro_env.units import FULL_VOLTAGE, Number
from hydro_rig.export.measured import MeasuredSignals

FILE = "contract.json"
MODEL_FILE = "controller.onnx"
TASK_FILE = "task.yaml"
RULES = {
    "start": "start is true in the first call and after every pause, while the axis is at rest; else false",
    "sampling": "one call per sample_time; all signals of a call are sampled at the same instant",
    "delay": "the voltage of sample k acts from 'latency' after that sample until 'latency' after the next one; "
    "previous_voltage of sample k is the voltage of sample k-1 that the valve received, also if something else limited "
    "or replaced it",
    "lost_sample": "a signal that is NaN or infinite is lost: the controller continues with its last sample. "
    "lost_signals counts them; the safety of the machine decides how long it may continue. "
    "The scores are valid without lost samples",
    "first_sample": "until a sample is complete the voltage is previous_voltage; then the controller starts",
    "out_of_range": "beyond its range the controller was never tested; beyond its limit the limit replaces the value. "
    "The limit of a future reference applies to its distance from the present reference",
    "not_a_number": "if the command is not a number, the voltage is previous_voltage, and the controller starts again "
    "at the next sample",
}
"""Rules of operation as text; the same for every controller."""

_MOST_BYTES = 1_000_000


class ContractSignal(Group):
    """A signal of a contract."""

    name: str
    unit: str
    range: tuple[Number, Number] = Field(description="of the sensor, or of the stroke")
    limit: Number = Field(description="values beyond ± this limit are clipped")
    meaning: str


class StatePart(Group):
    """A part of the state: ``size`` numbers, one part after the other."""

    name: str
    size: int = Field(ge=1, le=1_000_000)
    type: str = Field(description="in C")


class Sealed(Group):
    """A contract of any kind of folder, with the digests of its files."""

    model_config = ConfigDict(allow_inf_nan=False)

    def text(self) -> str:
        """As JSON, with its digest."""
        values = self.model_dump(mode="json")
        return json.dumps({**values, "digest": _digest(values)}, indent=2, ensure_ascii=False) + "\n"


class Contract(Sealed):
    """Content of ``contract.json``."""

    format: Literal["hydro_env exported controller"] = "hydro_env exported controller"
    format_version: Literal[1] = 1
    controller: dict[str, Any] = Field(description="kind, settings, training")
    sample_time: float = Field(gt=0.0, le=1.0, description="s")
    latency: float = Field(ge=0.0, le=1.0, description="s, from the sample to the new voltage")
    signals: tuple[ContractSignal, ...] = Field(min_length=1)
    output: ContractSignal = ContractSignal(
        name="voltage",
        unit="V",
        range=(-FULL_VOLTAGE, FULL_VOLTAGE),
        limit=FULL_VOLTAGE,
        meaning="to the drive of the valve; positive: extends",
    )
    state: tuple[StatePart, ...] = Field(description="of the ONNX model, as double; zero before the first call")
    rules: dict[str, str] = RULES
    scores: dict[str, Any]
    checked: dict[str, Any]
    versions: dict[str, str]
    command: str
    files: dict[str, str] = Field(description="SHA-256 of each file")
    digest: str = Field("", description="SHA-256 of all of the above as JSON with sorted keys")

    @property
    def state_size(self) -> int:
        """Numbers in the state of the ONNX model."""
        return sum(part.size for part in self.state)


def read_contract(folder: Path) -> Contract:
    """The contract of a folder, checked against its files.

    Raises:
        ConfigurationError: the folder has no contract, or the contract or a file was changed.
    """
    path = folder / FILE
    if not path.is_file():
        raise ConfigurationError(f"{folder}: holds no {FILE}: is not an exported controller")
    values = read_json(path, _MOST_BYTES)
    if values.get("format") != "hydro_env exported controller" or values.get("format_version") != 1:
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


def digests(files: Mapping[str, bytes]) -> dict[str, str]:
    """SHA-256 of each file, by name."""
    return {name: hashlib.sha256(content).hexdigest() for name, content in files.items()}


def _digest(values: Mapping[str, Any]) -> str:
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
        observation: Observation,
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
