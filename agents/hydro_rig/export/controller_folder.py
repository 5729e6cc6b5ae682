"""The folder of an exported controller: all files that a machine needs to run it, checked before they are written."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import yaml
from numpy.typing import NDArray

from hydro_agents.controllers.base import Controller
from hydro_agents.controllers.own_loop import LOST_TIME, OUT_OF_RANGE, STOPPING_TIME, OwnLoop
from hydro_agents.controllers.registry import gain_rows
from hydro_agents.running.seeds import CONTROLLER_VECTORS
from hydro_env import HydroError, ServoHydraulicVectorEnv, TaskConfig, __version__
from hydro_env.files import Group
from hydro_env.task.sensors import CHANNELS
from hydro_env.types import Floats
from hydro_env.units import FULL_VOLTAGE
from hydro_rig.export.c_files import csv_text, tested
from hydro_rig.export.controller import controller_code, controller_graph, variable_gains
from hydro_rig.export.measured import LOST_RULE, MeasuredController
from hydro_rig.export.onnx_writer import controller_model, onnx_session
from hydro_rig.export.structured_text import structured_text

LARGEST_DIFFERENCE = 1e-5
"""Largest difference of the command between the exported controller and the one in Python; more is an error."""

CODE = "controller"
MODEL_FILE, ST_FILE, TASK_FILE = "controller.onnx", "controller.st", "task.yaml"
FILES = (MODEL_FILE, f"{CODE}.c", f"{CODE}.h", ST_FILE, f"test_{CODE}.c", "vectors.csv", TASK_FILE, "README.md")
FAMILIES = ("step", "multi_sine", "start_stop")  # references of the closed-loop episodes, if the task has them
LONGEST = 250  # control periods per episode of the vectors
DAMAGED = np.array([70, 90, 110, 130])  # first samples of the vectors that are out of range


class Vectors(NamedTuple):
    """Consecutive samples; a 1 in ``start`` begins an episode."""

    start: NDArray[np.bool_]  # (samples,)
    signals: Floats  # (samples, signals), SI
    voltage: Floats  # (samples,), V


def make_vectors(measured: MeasuredController) -> Vectors:
    """Closed-loop episodes under the controller, and one with lost samples, values out of range, and stops.

    The voltages of the closed-loop episodes come from :class:`~hydro_agents.controllers.own_loop.OwnLoop`, with the
    observations of the environment: they also check that the signals in SI units give the same observations.
    """
    signals = measured.signals
    weights = signals.config.references.weights
    families: list[str | None] = [name for name in FAMILIES if weights.get(name, 0.0) > 0.0] or [None]
    seeds = CONTROLLER_VECTORS.take(len(families))
    episodes = [_closed_loop(measured, seed, family) for seed, family in zip(seeds, families, strict=True)]
    missing = math.ceil(LOST_TIME / signals.config.control_period) + 10
    disturbed = _disturbed(np.resize(episodes[0][0], (150 + missing, len(signals.signals))))
    begins = np.isin(np.arange(len(disturbed)), (0, 66, *DAMAGED + 5))
    answers, memory = [], None
    for row, begin in zip(disturbed, begins, strict=True):
        answer, memory = measured(row, memory, bool(begin), np.isfinite(row))
        answers.append(answer)
    episodes.append((disturbed, np.array(answers)))
    voltage = np.concatenate([voltages for _, voltages in episodes])
    if not np.isfinite(voltage).all():
        raise HydroError(f"{type(measured.controller).__name__}: its voltage is not finite: cannot be exported")
    starts = np.concatenate([*(np.arange(len(voltages)) == 0 for _, voltages in episodes[:-1]), begins])
    rows = np.concatenate([samples for samples, _ in episodes])
    return Vectors(starts, rows, voltage)


def _closed_loop(measured: MeasuredController, seed: int, family: str | None) -> tuple[Floats, Floats]:
    """Signals (samples, signals) and voltages (samples,) of an episode."""
    config = measured.signals.config
    env = ServoHydraulicVectorEnv(1, config, info=False)
    env.reset(seed=[seed], options={"reference": [family]} if family is not None else None)
    loop = OwnLoop(measured.controller, config, si=True)
    loop.reset(FULL_VOLTAGE * env.axes.column("command")[0])
    places = np.array([0, *config.preview_samples])
    samples, voltages = [], []
    for step in range(min(LONGEST, config.steps)):
        samples.append(measured.signals.of_axes(env.axes)[0])
        sensed = dict(zip(CHANNELS, env.axes.column("measured")[0], strict=True))
        voltages.append(loop.step(env.axes.reference[0, step + places], **sensed))
        _, _, terminated, truncated, _ = env.step(np.array([[voltages[-1] / FULL_VOLTAGE]]))
        if terminated[0] or truncated[0]:
            break
    env.close()
    return np.array(samples), np.array(voltages)


def _disturbed(samples: Floats) -> Floats:
    """Samples with lost ones at the start, of each signal in turn and of all at once, values out of range, and a stop.

    In the end the position stays away until the controller holds the axis.
    """
    rows, count = samples.copy(), samples.shape[1]
    rows[:2, -2] = np.nan  # the controller waits
    for signal in range(count):
        rows[10 + 4 * signal, signal] = np.nan
    rows[60:63] = np.nan
    for place, factor in zip(DAMAGED, (1e3, -1e3, 1e6, -1e6), strict=True):
        rows[place : place + 3] *= factor
    rows[150:, 0] = np.nan
    return rows


def exported_files(
    controller: Controller, config: TaskConfig, command: str, origin: str = ""
) -> tuple[dict[str, bytes], list[str]]:
    """The files of an exported controller by name, and the results of their checks, one line each.

    Their page names the ``command`` that exports it, and the ``origin`` of its gains.

    Raises:
        TraceError: the controller cannot be exported exactly.
        ConfigurationError: the package onnx or onnxruntime is not installed.
        HydroError: the ONNX model or the C code gives other voltages.
    """
    graph = controller_graph(controller, config)
    model = controller_model(graph).SerializeToString()
    varied = controller_graph(controller, config, variable_gains(controller))
    vectors, gains = make_vectors(graph.measured), getattr(controller, "gains", None)
    values = {
        "title": graph.title,
        "version": __version__,
        "command": command,
        "origin": origin,
        "name": CODE,
        "type": "ControllerMemory",
        "samples": len(vectors.voltage),
        "allowed": LARGEST_DIFFERENCE * FULL_VOLTAGE,
        "sample_time": config.control_period,
        "latency": config.command_latency,
        "signals": graph.signals.signals,
        "lost_rule": LOST_RULE,
        "stopping_time": STOPPING_TIME,
        "outside": OUT_OF_RANGE,
        "state_size": sum(part.size for part in graph.memory),
        "variable": [gain.name for gain in varied.gains],
        "gains": gain_rows(gains) if isinstance(gains, Group) else [],
    }
    in_onnx = check_onnx(model, vectors, type(controller).__name__)
    rows = np.column_stack([vectors.signals, vectors.voltage])
    csv = csv_text([*graph.signals.places, "voltage"], vectors.start, rows)
    files, in_c = tested(controller_code(varied, CODE), csv, values)
    task = yaml.safe_dump(config.model_dump(mode="json"), sort_keys=False, allow_unicode=True)
    files |= {MODEL_FILE: model, ST_FILE: structured_text(varied).encode(), TASK_FILE: task.encode()}
    return files, [f"{MODEL_FILE}: {in_onnx}", f"{CODE}.c: {in_c}"]


def check_onnx(model: bytes, vectors: Vectors, who: str) -> str:
    """Differences between the ONNX model in onnxruntime and the test vectors, in words.

    Raises:
        HydroError: a difference is above :data:`LARGEST_DIFFERENCE`.
    """
    session = onnx_session(model)
    state = np.zeros(session.get_inputs()[1].shape)
    voltages = np.empty(len(vectors.voltage))
    for sample, (start, signals) in enumerate(zip(*vectors[:2], strict=True)):
        given = {"signals": signals, "valid": np.isfinite(signals), "start": np.array([start])}
        voltage, state, *_ = session.run(None, {**given, "lost_limit": np.array([0]), "state": state})
        voltages[sample] = voltage[0]
    difference = np.abs(voltages - vectors.voltage) / FULL_VOLTAGE
    largest = float(difference.max())
    if not largest <= LARGEST_DIFFERENCE:
        raise HydroError(
            f"{who}: the ONNX model differs by {largest:.2g} of full command from the controller in Python: "
            "cannot be exported"
        )
    another = int((difference != 0.0).sum())
    return (
        f"{len(voltages)} samples in onnxruntime, {another} with another voltage, "
        f"largest difference of command {largest:.2g}"
    )
