"""The folder of an exported controller: all files that a machine needs to run it, checked before they are written."""

from __future__ import annotations

import hashlib
import subprocess
import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import scipy
import yaml

from hydro_agents.controllers.base import Controller
from hydro_agents.controllers.gains_file import gain_rows
from hydro_agents.controllers.registry import CONTROLLERS
from hydro_agents.export.c_writer import C_TYPES
from hydro_agents.export.compiler import c_compiler, compile_c
from hydro_agents.export.contract import FILE, Contract, ContractSignal, StatePart
from hydro_agents.export.controller_code import ControllerCode, code_of
from hydro_agents.export.controller_graph import ControllerGraph, controller_graph
from hydro_agents.export.controller_onnx import controller_model
from hydro_agents.export.exported import MODEL_FILE, TASK_FILE, onnx_session
from hydro_agents.export.plant_code import render
from hydro_agents.export.vectors import Vectors, make_vectors
from hydro_agents.learning.validation import validation_cases, validation_errors
from hydro_env import HydroError, TaskConfig, __version__
from hydro_env.files import Group
from hydro_env.units import FULL_VOLTAGE

LARGEST_DIFFERENCE = 1e-5
"""Largest difference of the command between the exported controller and the one in Python; more is an error."""

CODE = "controller"
FILES = (
    MODEL_FILE,
    f"{CODE}.c",
    f"{CODE}.h",
    f"test_{CODE}.c",
    "vectors.csv",
    TASK_FILE,
    "README.md",
    FILE,
)
"""Names of the files of an exported controller."""


def exported_files(controller: Controller, config: TaskConfig, command: str) -> tuple[dict[str, bytes], list[str]]:
    """The files of an exported controller by name, and the results of their checks, one line each.

    Args:
        controller: the controller.
        config: the task for which it was made.
        command: the command of the export, for the contract.

    Raises:
        TraceError: the controller cannot be exported exactly.
        ConfigurationError: the package onnx or onnxruntime is not installed.
        HydroError: the ONNX model or the C code gives other voltages.
    """
    graph = controller_graph(controller, config)
    model = controller_model(graph).SerializeToString()
    vectors, code = make_vectors(graph.measured), code_of(graph, CODE)
    allowed = LARGEST_DIFFERENCE * FULL_VOLTAGE
    values = {
        "title": f"Controller of a hydraulic servo axis ({type(controller).__name__})",
        "version": __version__,
        "name": CODE,
        "type": "ControllerMemory",
        "samples": len(vectors.voltage),
        "allowed": allowed,
        "sample_time": config.control_period,
        "signals": graph.signals.signals,
        "state_size": sum(part.size for part in graph.memory),
        "gains": gain_rows(gains) if isinstance(gains := getattr(controller, "gains", None), Group) else [],
    }
    test_program = render("test_controller.c.j2", values)
    found = check_onnx(model, vectors)
    if not found["largest_difference_of_command"] <= LARGEST_DIFFERENCE:
        raise HydroError(
            f"{type(controller).__name__}: the ONNX model differs by {found['largest_difference_of_command']:.2g} of "
            "full command from the controller in Python: cannot be exported"
        )
    in_c = check_c(code, test_program, vectors)
    texts = {
        f"{CODE}.c": code.source,
        f"{CODE}.h": code.header,
        f"test_{CODE}.c": test_program,
        "vectors.csv": vectors.text(),
        TASK_FILE: yaml.safe_dump(config.model_dump(mode="json"), sort_keys=False, allow_unicode=True),
        "README.md": render("controller_readme.md.j2", values),
    }
    files = {MODEL_FILE: model, **{name: text.encode() for name, text in texts.items()}}
    contract = _contract(controller, graph, {"controller.onnx": found, "controller.c": in_c}, command, files)
    files[FILE] = contract.text().encode()
    report = [
        f"{MODEL_FILE}: {found['samples']} samples in onnxruntime, {found['another_voltage']} with another voltage, "
        f"largest difference of command {found['largest_difference_of_command']:.2g}",
        f"controller.c: {in_c['result']}",
    ]
    return files, report


def check_onnx(model: bytes, vectors: Vectors) -> dict[str, Any]:
    """Differences between the ONNX model in onnxruntime and the test vectors."""
    session = onnx_session(model)
    state = np.zeros(session.get_inputs()[1].shape)
    found = np.empty(len(vectors.voltage))
    for sample, (start, signals) in enumerate(zip(vectors.start, vectors.signals, strict=True)):
        voltage, state, _ = session.run(None, {"signals": signals, "state": state, "start": np.array([start])})
        found[sample] = voltage[0]
    difference = np.abs(found - vectors.voltage) / FULL_VOLTAGE
    return {
        "samples": len(found),
        "another_voltage": int((difference != 0.0).sum()),
        "largest_difference_of_command": float(difference.max()),
    }


def check_c(code: ControllerCode, test_program: str, vectors: Vectors) -> dict[str, Any]:
    """Result of the test program, compiled on this machine.

    Raises:
        HydroError: the code cannot be compiled, or gives other voltages.
    """
    if c_compiler() is None:
        return {"result": "not compiled: this machine has no C compiler"}
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        code.write(folder)
        (folder / f"test_{code.name}.c").write_text(test_program, encoding="utf-8")
        (folder / "vectors.csv").write_text(vectors.text(), encoding="utf-8")
        flags = ["-Wall", "-Wextra", "-Werror"]
        compile_c(folder, [*flags, "-o", "test", f"test_{code.name}.c", f"{code.name}.c"])
        result = subprocess.run([str(folder / "test")], cwd=folder, capture_output=True, text=True, check=False)
    said = " ".join((result.stdout + result.stderr).split())
    if result.returncode != 0:
        raise HydroError(f"the C code differs from the controller in Python: {said}")
    return {"result": said}


def _contract(
    controller: Controller,
    graph: ControllerGraph,
    checked: Mapping[str, Any],
    command: str,
    files: Mapping[str, bytes],
) -> Contract:
    import onnx
    import onnxruntime

    config = graph.signals.config
    mean, worst, failed = validation_errors(config, controller)
    packages = {"numpy": np, "scipy": scipy, "onnx": onnx, "onnxruntime": onnxruntime}
    return Contract(
        controller=describe(controller),
        sample_time=config.control_period,
        latency=config.command_latency,
        signals=tuple(
            ContractSignal(name=s.name, unit=s.unit, range=(s.low, s.high), limit=s.limit, meaning=s.meaning)
            for s in graph.signals.signals
        ),
        state=tuple(StatePart(name=part.name, size=part.size, type=C_TYPES[part.kind]) for part in graph.memory),
        scores={
            "episodes": f"{len(validation_cases(config))} simulated episodes of the task on validation plants: "
            "each kind of reference with a healthy seal, a small leak and the largest leak",
            "mean_error_mm": mean,
            "worst_mean_error_mm": worst,
            "failed": failed,
        },
        checked=dict(checked),
        versions={"hydro_env": __version__, **{name: module.__version__ for name, module in packages.items()}},
        command=command,
        files={name: hashlib.sha256(content).hexdigest() for name, content in files.items()},
    )


def describe(controller: Any) -> dict[str, Any]:
    """Kind, settings and training of a controller, as JSON, without the task."""
    kinds = {registered: kind for kind, (registered, _) in CONTROLLERS.items()}
    facts: dict[str, Any] = {"kind": kinds.get(type(controller), type(controller).__name__)}
    if hasattr(controller, "gains"):
        facts["settings"] = controller.gains.model_dump(mode="json")
    if hasattr(controller, "features"):
        facts["settings"] = {name: value for name, value in controller.features.describe().items() if name != "task"}
        facts["layers"] = [list(weight.shape[::-1]) for weight, _ in controller.layers]
        facts["training"] = controller.training
    return facts
