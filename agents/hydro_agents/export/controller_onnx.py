"""ONNX model of a controller: measured signals and state in, voltage and next state out."""

from __future__ import annotations

from typing import Any

import numpy as np

from hydro_agents.export.controller_graph import ControllerGraph
from hydro_agents.export.onnx_writer import OnnxWriter

OUTPUTS = ("voltage", "next_state", "lost_signals")
DOUBLE = np.dtype(np.float64)


def controller_model(controller: ControllerGraph) -> Any:
    """The model; inputs ``signals``, ``state``, ``start``, outputs ``voltage``, ``next_state``, ``lost_signals``.

    The state is one vector: the parts of the memory, one after the other, as ``double``, which represents every
    ``float`` and truth value exactly.

    Raises:
        ConfigurationError: the package onnx is not installed.
        HydroError: the model is wrong.
    """
    parts = controller.memory
    signals, size = len(controller.signals.signals), sum(part.size for part in parts)
    inputs = {"signals": (signals, DOUBLE), "state": (size, DOUBLE), "start": (1, np.dtype(np.bool_))}
    writer = OnnxWriter(inputs, OUTPUTS)
    first = 0
    for part in parts:
        tensor = writer.slice_of("state", first, part.size, f"state.{part.name}")
        writer.given[part.name] = (
            tensor if part.kind == DOUBLE else writer.cast(tensor, part.kind, f"state.{part.name}")
        )
        first += part.size
    chosen = controller.chosen()
    pieces = []
    for part in parts:
        tensor = writer.tensor(chosen[part.name])
        pieces.append(tensor if part.kind == DOUBLE else writer.cast(tensor, DOUBLE, f"next.{part.name}"))
    joined = writer.add("Concat", pieces, "next_memory", axis=0)
    outputs = {
        name: (tensor, length, DOUBLE)
        for name, tensor, length in zip(
            OUTPUTS,
            (writer.tensor(chosen["voltage"]), joined, writer.tensor(chosen["lost"])),
            (1, size, 1),
            strict=True,
        )
    }
    title = f"Controller of a hydraulic servo axis ({type(controller.measured.controller).__name__})"
    names = ", ".join(f"{signal.name} ({signal.unit})" for signal in controller.signals.signals)
    return writer.model(
        outputs, title, {"signals": names, "sample_time": repr(controller.signals.config.control_period)}
    )
