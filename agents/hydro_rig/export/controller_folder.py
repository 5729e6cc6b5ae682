"""The folder of an exported controller: all files that a machine needs to run it, checked before they are written."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import scipy
import yaml
from numpy.typing import NDArray

from hydro_agents.controllers.base import Controller
from hydro_agents.controllers.registry import CONTROLLERS, GainRow, gain_rows
from hydro_agents.running.cases import validation_cases, validation_errors
from hydro_agents.running.seeds import CONTROLLER_VECTORS
from hydro_env import HydroError, ServoHydraulicVectorEnv, TaskConfig, __version__
from hydro_env.files import Group
from hydro_env.units import FULL_VOLTAGE
from hydro_rig.export.c_files import compared, csv_text, render
from hydro_rig.export.c_writer import C_TYPES
from hydro_rig.export.controller import (
    GAINS,
    ControllerGraph,
    controller_code,
    controller_graph,
    controller_model,
)
from hydro_rig.export.exported import (
    FILE,
    MODEL_FILE,
    TASK_FILE,
    Contract,
    ContractSignal,
    StatePart,
    digests,
    onnx_session,
)
from hydro_rig.export.measured import MeasuredController, MeasuredMemory
from hydro_rig.export.structured_text import structured_text
from hydro_rig.export.tracing import TraceError

LARGEST_DIFFERENCE = 1e-5
"""Largest difference of the command between the exported controller and the one in Python; more is an error."""

CODE = "controller"
ST_FILE = "controller.st"
FILES = (MODEL_FILE, f"{CODE}.c", f"{CODE}.h", f"test_{CODE}.c", "vectors.csv", TASK_FILE, "README.md", FILE)
FAMILIES = ("step", "multi_sine", "start_stop")  # references of the closed-loop episodes, if the task has them
LONGEST = 250  # control periods per episode of the vectors


@dataclass(frozen=True)
class Vectors:
    """Consecutive samples; a 1 in ``start`` begins an episode."""

    names: tuple[str, ...]
    start: NDArray[np.bool_]  # (samples,)
    signals: NDArray[np.float64]  # (samples, signals), SI
    voltage: NDArray[np.float64]  # (samples,), V

    def text(self) -> str:
        """As CSV; every number reads back exactly."""
        rows = ((*signals, voltage) for signals, voltage in zip(self.signals, self.voltage, strict=True))
        return csv_text([*self.names, "voltage"], zip(self.start, rows, strict=True))


def make_vectors(measured: MeasuredController) -> Vectors:
    """Closed-loop episodes under the controller, and one with lost samples and values out of range.

    The voltages of the closed-loop episodes come from ``predict`` with the observations of the environment: they also
    check that the signals in SI units give the same observations.
    """
    config, signals = measured.signals.config, measured.signals
    families: list[str | None] = [name for name in FAMILIES if config.references.weights.get(name, 0.0) > 0.0]
    length = min(LONGEST, config.steps)
    env = ServoHydraulicVectorEnv(1, config, info=False)
    episodes: list[tuple[NDArray[np.float64], list[float]]] = []
    families = families or [None]
    for seed, family in zip(CONTROLLER_VECTORS.take(len(families)), families, strict=True):
        options = {"reference": [family]} if family is not None else None
        observation, _ = env.reset(seed=[seed], options=options)
        samples, voltages, memory = [], [], None
        for _ in range(length):
            samples.append(signals.of_axes(env.axes)[0])
            action, memory = measured.controller.predict(observation, memory)
            voltages.append(FULL_VOLTAGE * float(np.clip(np.float64(action[0, 0]), -1.0, 1.0)))
            observation, _, terminated, truncated, _ = env.step(action)
            if terminated[0] or truncated[0]:
                break
        episodes.append((np.array(samples), voltages))
    env.close()
    disturbed = _disturbed(np.resize(episodes[0][0], (120, len(signals.signals))))
    state: MeasuredMemory | None = None
    voltages = []
    for row in disturbed:
        voltage, state = measured(row, state)
        voltages.append(voltage)
    episodes.append((disturbed, voltages))
    if not all(np.isfinite(voltages).all() for _, voltages in episodes):
        raise HydroError(f"{type(measured.controller).__name__}: its voltage is not finite: cannot be exported")
    starts = [np.arange(len(voltages)) == 0 for _, voltages in episodes]
    return Vectors(
        tuple(signal.name for signal in signals.signals),
        np.concatenate(starts),
        np.concatenate([rows for rows, _ in episodes]),
        np.concatenate([np.array(voltages) for _, voltages in episodes]),
    )


def _disturbed(samples: NDArray[np.float64]) -> NDArray[np.float64]:
    """Samples with lost ones at the start, of each signal in turn and of all at once, and values out of range."""
    rows, count = samples.copy(), samples.shape[1]
    rows[:2, -2] = np.nan  # the controller waits
    for signal in range(count):
        rows[10 + 4 * signal : 12 + 4 * signal, signal] = (np.nan, np.inf)
    rows[60:63] = np.nan
    for place, factor in enumerate((1e3, -1e3, 1e6, -1e6)):
        rows[70 + 10 * place : 73 + 10 * place] *= factor
    return rows


def exported_files(
    controller: Controller, config: TaskConfig, command: str, language: str = "c"
) -> tuple[dict[str, bytes], list[str]]:
    """The files of a controller for a task by name, and results of their checks; the contract names the command.

    The language ``st`` adds Structured Text to C and ONNX.

    Raises:
        TraceError: the controller cannot be exported exactly.
        ConfigurationError: the package onnx or onnxruntime is not installed.
        HydroError: the ONNX model or the C code gives other voltages.
    """
    graph = controller_graph(controller, config)
    model = controller_model(graph).SerializeToString()
    varied = controller_graph(controller, config, variable_gains(controller, config))
    vectors, code = make_vectors(graph.measured), controller_code(varied, CODE)
    allowed = LARGEST_DIFFERENCE * FULL_VOLTAGE
    values = {
        "title": graph.title,
        "version": __version__,
        "name": CODE,
        "type": "ControllerMemory",
        "samples": len(vectors.voltage),
        "allowed": allowed,
        "sample_time": config.control_period,
        "signals": graph.signals.signals,
        "state_size": sum(part.size for part in graph.memory),
        "variable": [gain.name for gain in varied.gains],
        "structured_text": language == "st",
        "gains": gain_rows(gains) if isinstance(gains := getattr(controller, "gains", None), Group) else [],
    }
    found = check_onnx(model, vectors)
    if not found["largest_difference_of_command"] <= LARGEST_DIFFERENCE:
        raise HydroError(
            f"{type(controller).__name__}: the ONNX model differs by {found['largest_difference_of_command']:.2g} of "
            "full command from the controller in Python: cannot be exported"
        )
    texts = {
        **code.files,
        f"test_{CODE}.c": render("test_controller.c.j2", values),
        "vectors.csv": vectors.text(),
        TASK_FILE: yaml.safe_dump(config.model_dump(mode="json"), sort_keys=False, allow_unicode=True),
        "README.md": render("controller_readme.md.j2", values),
    }
    in_c = compared(CODE, texts)
    if language == "st":
        texts[ST_FILE] = structured_text(varied)
    files = {MODEL_FILE: model, **{name: text.encode() for name, text in texts.items()}}
    checked = {"controller.onnx": found, "controller.c": {"result": in_c}}
    files[FILE] = _contract(controller, graph, checked, command, files).text().encode()
    report = [
        f"{MODEL_FILE}: {found['samples']} samples in onnxruntime, {found['another_voltage']} with another voltage, "
        f"largest difference of command {found['largest_difference_of_command']:.2g}",
        f"controller.c: {in_c}",
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


def _contract(
    controller: Controller, graph: ControllerGraph, checked: Mapping[str, Any], command: str, files: Mapping[str, bytes]
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
        files=digests(files),
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


_CLASSICAL = tuple(kind for kind, _ in CONTROLLERS.values())


def variable_gains(controller: Controller, config: TaskConfig) -> list[GainRow]:
    """The gains that can be changed while the exported code runs.

    A change must have the effect of a new controller with this gain: a gain from which the controller computes other
    numbers when it is made, or on which it decides, stays a constant.
    """
    if not isinstance(own := getattr(controller, "gains", None), Group) or type(controller) not in _CLASSICAL:
        return []
    rows = [row for row in gain_rows(own) if isinstance(row.value, float)]
    if _used(controller, config, rows) is None:
        rows = [row for row in rows if _used(controller, config, [row])]
    rows = [row for row in rows if row.name in (_used(controller, config, rows) or ())]
    text, make = _text_without(controller, config, rows), type(controller)
    free = []
    for row in rows:
        near = own.model_copy(update={row.name: 0.999 * row.value if row.value else 1e-3})
        if _text_without(make(near, config), config, rows) == text:  # type: ignore[call-arg]
            free.append(row)
    return free


def _used(controller: Controller, config: TaskConfig, rows: Sequence[GainRow]) -> set[str] | None:
    """Names of the gains on which the voltage depends, now or later; ``None`` if the controller decides on one."""
    try:
        graph = controller_graph(controller, config, rows).graph
    except (TraceError, TypeError):
        return None
    used = graph.used([*graph.outputs.values()])
    return {row.name for row in rows if used[GAINS + row.name].any()}


def _text_without(controller: Controller, config: TaskConfig, rows: Sequence[GainRow]) -> str:
    """The code without the values of these gains."""
    graph = controller_graph(controller, config, rows)
    return controller_code(replace(graph, gains=tuple(row._replace(value=0.0, in_practice="") for row in rows))).source
