"""Stores the looks at simulated axes in files, part by part: a long calibration survives Ctrl-C and continues."""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from hydro_agents.controllers.base import Controller
from hydro_agents.detection.alarm_simulation import Onset, Operation, simulate
from hydro_agents.detection.detector import Detector
from hydro_agents.detection.looks import Looks, joined
from hydro_agents.running.weights import load_checkpoint, require, save_checkpoint
from hydro_env import ConfigurationError, TaskConfig

KIND = "looks at simulated axes, 2"
PATTERN = "looks_*.safetensors"


@dataclass(frozen=True)
class Bench:
    """Settings that all looks of a calibration share."""

    config: TaskConfig
    controllers: Mapping[str, Controller]  # in turn, one for each part
    detector: Detector
    detector_name: str
    folder: Path  # for the files
    together: int = 128  # largest number of axes of a part; Ctrl-C loses the unfinished part

    def looks(
        self,
        name: str,
        operation: Operation,
        onsets: tuple[Onset, ...] = (),
        progress: Callable[[str, int, int], None] | None = None,
    ) -> list[Looks]:
        """Looks up to the onset, and after each onset; see :func:`~hydro_agents.detection.alarm_simulation.simulate`.

        Parts that are already in the folder are read, not simulated.

        Raises:
            ConfigurationError: a file is damaged or belongs to another task, detector or operation.
        """
        parts = []
        fair = math.ceil(operation.axes / len(self.controllers))
        size = self.together if operation.axes > self.together else fair  # each controller gets a part
        for number, first in enumerate(range(0, operation.axes, size)):
            if progress is not None:
                progress(name, first, operation.axes)
            count = min(size, operation.axes - first)
            part = replace(operation, first_seed=operation.first_seed + first, axes=count)
            parts.append(self._part(f"looks_{name}_{number:04d}", number, part, onsets))
        if progress is not None:
            progress(name, operation.axes, operation.axes)
        return [joined(column) for column in zip(*parts, strict=True)]

    def _part(self, name: str, number: int, operation: Operation, onsets: tuple[Onset, ...]) -> list[Looks]:
        path = self.folder / f"{name}.safetensors"
        controller = list(self.controllers)[number % len(self.controllers)]
        made_of = {
            "controller": controller,
            "detector": self.detector_name,
            "work": json.loads(json.dumps([asdict(operation), *(asdict(onset) for onset in onsets)])),
            "task": hashlib.sha256(self.config.model_dump_json().encode()).hexdigest(),
        }
        if path.exists():
            return _read(path, made_of, operation, 1 + len(onsets))
        found = simulate(self.config, self.controllers[controller], self.detector, operation, onsets)
        tensors = {
            f"{index}.{key}": values for index, each in enumerate(found) for key, values in each._asdict().items()
        }
        save_checkpoint(path, KIND, tensors, made_of)
        return found


def _read(path: Path, made_of: Mapping[str, Any], operation: Operation, count: int) -> list[Looks]:
    tensors, stored = load_checkpoint(path, KIND)
    for key, value in made_of.items():
        if stored.get(key) != value:
            raise ConfigurationError(f"{path}: was made with another {key}; --overwrite begins anew")
    found = []
    for index in range(count):
        time = tensors.get(f"{index}.time", np.zeros(0))
        shape = (operation.axes, len(time))
        kinds: dict[str, Any] = {"cause": np.int8, "activity": np.int8}
        wanted = {name: np.empty(shape, kinds.get(name, np.float64)) for name in Looks._fields} | {"time": time}
        require(tensors, {f"{index}.{name}": like for name, like in wanted.items()}, path, finite=False)
        found.append(Looks(**{name: tensors[f"{index}.{name}"] for name in Looks._fields}))
    return found
