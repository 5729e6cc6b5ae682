"""The folder of an exported controller: all files that a machine needs to run it, checked before they are written."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import scipy
import yaml
from numpy.typing import NDArray

from hydro_agents.controllers.base import Controller
from hydro_agents.controllers.registry import CONTROLLERS, gain_rows
from hydro_agents.running.cases import validation_cases, validation_errors
from hydro_agents.running.seeds import CONTROLLER_VECTORS
from hydro_env import HydroError, ServoHydraulicVectorEnv, TaskConfig, __version__
from hydro_env.files import Group
from hydro_env.types import Floats
from hydro_env.units import FULL_VOLTAGE
from hydro_rig.export.c_files import FILE, compared, csv_text, sealed, with_test
from hydro_rig.export.c_writer import C_TYPES
from hydro_rig.export.controller import (
    ControllerGraph,
    controller_code,
    controller_graph,
    controller_model,
    variable_gains,
)
from hydro_rig.export.measured import MeasuredController, Signal
from hydro_rig.export.onnx_writer import onnx_session
from hydro_rig.export.structured_text import structured_text

LARGEST_DIFFERENCE = 1e-5
"""Largest difference of the command between the exported controller and the one in Python; more is an error."""

CODE = "controller"
MODEL_FILE, TASK_FILE = "controller.onnx", "task.yaml"
ST_FILE = "controller.st"
FILES = (MODEL_FILE, f"{CODE}.c", f"{CODE}.h", f"test_{CODE}.c", "vectors.csv", TASK_FILE, "README.md", FILE)
FAMILIES = ("step", "multi_sine", "start_stop")  # references of the closed-loop episodes, if the task has them
LONGEST = 250  # control periods per episode of the vectors
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


class Vectors(NamedTuple):
    """Consecutive samples; a 1 in ``start`` begins an episode."""

    start: NDArray[np.bool_]  # (samples,)
    signals: Floats  # (samples, signals), SI
    voltage: Floats  # (samples,), V


def make_vectors(measured: MeasuredController) -> Vectors:
    """Closed-loop episodes under the controller, and one with lost samples and values out of range.

    The voltages of the closed-loop episodes come from ``predict`` with the observations of the environment: they also
    check that the signals in SI units give the same observations.
    """
    signals = measured.signals
    weights = signals.config.references.weights
    families: list[str | None] = [name for name in FAMILIES if weights.get(name, 0.0) > 0.0] or [None]
    seeds = CONTROLLER_VECTORS.take(len(families))
    episodes = [_closed_loop(measured, seed, family) for seed, family in zip(seeds, families, strict=True)]
    disturbed = _disturbed(np.resize(episodes[0][0], (120, len(signals.signals))))
    answers, memory = [], None
    for row in disturbed:
        answer, memory = measured(row, memory)
        answers.append(answer)
    episodes.append((disturbed, np.array(answers)))
    voltage = np.concatenate([voltages for _, voltages in episodes])
    if not np.isfinite(voltage).all():
        raise HydroError(f"{type(measured.controller).__name__}: its voltage is not finite: cannot be exported")
    starts = np.concatenate([np.arange(len(voltages)) == 0 for _, voltages in episodes])
    rows = np.concatenate([samples for samples, _ in episodes])
    return Vectors(starts, rows, voltage)


def _closed_loop(measured: MeasuredController, seed: int, family: str | None) -> tuple[Floats, Floats]:
    """Signals (samples, signals) and voltages (samples,) of an episode."""
    config = measured.signals.config
    env = ServoHydraulicVectorEnv(1, config, info=False)
    observation, _ = env.reset(seed=[seed], options={"reference": [family]} if family is not None else None)
    samples, voltages, memory = [], [], None
    for _ in range(min(LONGEST, config.steps)):
        samples.append(measured.signals.of_axes(env.axes)[0])
        action, memory = measured.controller.predict(observation, memory)
        voltages.append(FULL_VOLTAGE * float(np.clip(np.float64(action[0, 0]), -1.0, 1.0)))
        observation, _, terminated, truncated, _ = env.step(action)
        if terminated[0] or truncated[0]:
            break
    env.close()
    return np.array(samples), np.array(voltages)


def _disturbed(samples: Floats) -> Floats:
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
    """The files of an exported controller by name, and the results of their checks, one line each.

    Args:
        controller: the controller.
        config: its task.
        command: for the contract.
        language: ``"st"`` adds Structured Text.

    Raises:
        TraceError: the controller cannot be exported exactly.
        ConfigurationError: the package onnx or onnxruntime is not installed.
        HydroError: the ONNX model or the C code gives other voltages.
    """
    graph = controller_graph(controller, config)
    model = controller_model(graph).SerializeToString()
    varied = controller_graph(controller, config, variable_gains(controller, config))
    vectors, gains = make_vectors(graph.measured), getattr(controller, "gains", None)
    values = {
        "title": graph.title,
        "version": __version__,
        "name": CODE,
        "type": "ControllerMemory",
        "samples": len(vectors.voltage),
        "allowed": LARGEST_DIFFERENCE * FULL_VOLTAGE,
        "sample_time": config.control_period,
        "signals": graph.signals.signals,
        "state_size": sum(part.size for part in graph.memory),
        "variable": [gain.name for gain in varied.gains],
        "structured_text": language == "st",
        "gains": gain_rows(gains) if isinstance(gains, Group) else [],
    }
    in_onnx = check_onnx(model, vectors, type(controller).__name__)
    task = yaml.safe_dump(config.model_dump(mode="json"), sort_keys=False, allow_unicode=True)
    rows = np.column_stack([vectors.signals, vectors.voltage])
    csv = csv_text([*graph.signals.places, "voltage"], vectors.start, rows)
    texts = with_test(controller_code(varied, CODE), csv, values, **{TASK_FILE: task})
    in_c = compared(CODE, texts)
    if language == "st":
        texts[ST_FILE] = structured_text(varied)
    facts = {**_facts(controller, graph), "checked": {MODEL_FILE: in_onnx, "controller.c": {"result": in_c}}}
    report = [
        f"{MODEL_FILE}: {in_onnx['samples']} samples in onnxruntime, {in_onnx['another_voltage']} with another "
        f"voltage, largest difference of command {in_onnx['largest_difference_of_command']:.2g}",
        f"controller.c: {in_c}",
    ]
    import onnx
    import onnxruntime

    files = {MODEL_FILE: model, **texts}
    return sealed("controller", files, facts, command, (np, scipy, onnx, onnxruntime)), report


def check_onnx(model: bytes, vectors: Vectors, who: str) -> dict[str, Any]:
    """Differences between the ONNX model in onnxruntime and the test vectors.

    Raises:
        HydroError: a difference is above :data:`LARGEST_DIFFERENCE`.
    """
    session = onnx_session(model)
    state = np.zeros(session.get_inputs()[1].shape)
    voltages = np.empty(len(vectors.voltage))
    for sample, (start, signals) in enumerate(zip(*vectors[:2], strict=True)):
        voltage, state, _ = session.run(None, {"signals": signals, "state": state, "start": np.array([start])})
        voltages[sample] = voltage[0]
    difference = np.abs(voltages - vectors.voltage) / FULL_VOLTAGE
    largest = float(difference.max())
    if not largest <= LARGEST_DIFFERENCE:
        raise HydroError(
            f"{who}: the ONNX model differs by {largest:.2g} of full command from the controller in Python: "
            "cannot be exported"
        )
    return {
        "samples": len(voltages),
        "another_voltage": int((difference != 0.0).sum()),
        "largest_difference_of_command": largest,
    }


def _facts(controller: Controller, graph: ControllerGraph) -> dict[str, Any]:
    """What the contract says of a controller."""
    config = graph.signals.config
    mean, worst, failed = validation_errors(config, controller)
    return {
        "controller": describe(controller),
        "sample_time": config.control_period,
        "latency": config.command_latency,
        "signals": [signal.facts for signal in graph.signals.signals],
        "output": Signal(
            "voltage", "V", -FULL_VOLTAGE, FULL_VOLTAGE, FULL_VOLTAGE, "to the drive of the valve; positive: extends"
        ).facts,
        "state": [{"name": part.name, "size": part.size, "type": C_TYPES[part.kind]} for part in graph.memory],
        "rules": RULES,
        "scores": {
            "episodes": f"{len(validation_cases(config))} simulated episodes of the task on validation plants: "
            "each kind of reference with a healthy seal, a small leak and the largest leak",
            "mean_error_mm": mean,
            "worst_mean_error_mm": worst,
            "failed": failed,
        },
    }


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
