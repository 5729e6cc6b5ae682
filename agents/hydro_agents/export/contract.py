"""The contract of an exported controller: its inputs and outputs with units and timing, and its origin."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Literal

from pydantic import ConfigDict, Field

from hydro_env import ConfigurationError
from hydro_env.files import Group, read_json, validate
from hydro_env.units import FULL_VOLTAGE, Number

FILE = "contract.json"
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


class Contract(Group):
    """Content of ``contract.json``."""

    model_config = ConfigDict(allow_inf_nan=False)

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

    def text(self) -> str:
        """As JSON, with its digest."""
        return sealed(self.model_dump(mode="json"))


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


def sealed(values: Mapping[str, Any]) -> str:
    """The values of a contract as JSON, with their digest."""
    return json.dumps({**values, "digest": _digest(values)}, indent=2, ensure_ascii=False) + "\n"


def _digest(values: Mapping[str, Any]) -> str:
    content = {name: value for name, value in values.items() if name != "digest"}
    return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()
