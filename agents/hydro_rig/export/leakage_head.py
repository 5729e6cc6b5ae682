"""The leakage head for other machines: C99 from measured signals to the estimate, its network as ONNX, all checked.

Repair of gaps, flow balance and features are translated from the compiled functions of :mod:`hydro_agents.detection`;
the network is traced from its NumPy code.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from hydro_agents.detection.balance import fit, fit_balance
from hydro_agents.detection.damaged_signals import bounds_of, find_stuck, repair
from hydro_agents.detection.detector import MeasuredColumns
from hydro_agents.detection.features import FEATURES, SIGNALS, describe, features_of
from hydro_agents.detection.head import BESIDE_STUCK_SENSOR, LeakageEstimate, LeakageHead
from hydro_agents.running.seeds import HEAD_VECTORS
from hydro_env import HydroError, ServoHydraulicVectorEnv, __version__
from hydro_env.task.sensors import CHANNEL_UNITS, SENSORS
from hydro_env.task.signals import observation_layout
from hydro_env.types import Floats
from hydro_rig.export.c_files import FILE, CCode, c_code, compared, csv_text, sealed, with_test
from hydro_rig.export.c_writer import CWriter
from hydro_rig.export.expressions import DOUBLE, array
from hydro_rig.export.graph import Graph
from hydro_rig.export.measured import SENSOR_MEANINGS, Signal
from hydro_rig.export.onnx_writer import OnnxWriter, onnx_session
from hydro_rig.export.tracing import trace
from hydro_rig.export.translator import Translator

NAME = "leakage_head"
MEANINGS = {
    **{name: (CHANNEL_UNITS[name], SENSOR_MEANINGS[name]) for name in SENSORS},
    "previous_command": ("1", "received by the valve in the last control period, as a fraction of full voltage"),
}
FIELDS = {
    "probability": "of a leak past the piston, 0 to 1",
    "flow_lpm": "its size, l/min at 100 bar",
    "low_lpm": "90 % interval of the size",
    "high_lpm": "90 % interval of the size",
    "external_leak": "probability of a leak past the rod seal",
    "valve_fault": "probability of a fault of the valve",
    "sensor_fault": "probability of a fault of a sensor",
    "return_line": "probability of raised tank pressure",
    "outside": "1: the answer is not valid, because the window is unlike the training; else 0",
}
FORGET = 4  # multiples of window times interval after which the C code restarts its sample counter
NETWORK_FILE = "leakage_head_network.onnx"
FILES = ("leakage_head.c", "leakage_head.h", "test_leakage_head.c", "vectors.csv", NETWORK_FILE, "README.md", FILE)
LARGEST_DIFFERENCE = 2e-5
"""Largest difference of a value, relative to 1 + its size, due to the order of float32 sums. More is an error."""

LEAKS = (0.01, 0.5, 2.0)  # l/min at 100 bar, in the episodes of the test vectors
ESTIMATES = 4  # control periods per episode of the test vectors
RULES = {
    "sampling": "one call per sample_time; all signals of a call are sampled at the same instant",
    "previous_command": "of sample k is the command of sample k-1 that the valve received (1: full voltage)",
    "start": "leakage_head_start before the first sample and after every pause",
    "first_estimate": "NaN until 'window' samples are known; then a new one every 'interval' samples",
    "lost_sample": "a signal that is NaN takes its last reading; an absent sensor is always NaN",
    "outside": "1: the window is unlike the training, or a sensor is stuck; the answer is not valid",
    "flag": "a leak is flagged at a probability of 'threshold' or more: 1 % false alarms on validation plants",
}


def head_graph(head: LeakageHead) -> Graph:
    """From ``features`` to ``answer``, the fields of a :class:`~hydro_agents.detection.head.LeakageEstimate`."""
    features = np.zeros((1, len(FEATURES)), dtype=np.float32)
    return trace(lambda features: {"answer": head.judge(features)}, {"features": features})


def head_code(head: LeakageHead) -> CCode:
    """C sources of a head, for windows of its shortest length.

    Raises:
        TranslationError, TraceError: a function uses a construct without translation.
    """
    window, sheet, config = head.settings.window, head.sheet._asdict(), head.settings.task
    bounds = bounds_of(config)
    fitted = fit_balance(np.zeros((1, len(SIGNALS), window)), head.sheet)._asdict()  # for the shapes of its parts
    translator = Translator()
    kinds = [array(*np.shape(values), constant=True) if np.ndim(values) else DOUBLE for values in sheet.values()]
    of_sheet = translator.record("Sheet", list(zip(kinds, sheet, strict=True)))
    signals, lost = array(1, len(SIGNALS), window), array(1, len(SENSORS))
    of_fit = [array(*np.shape(part)) for part in fitted.values()]
    translator.function(repair, [signals, of_sheet, signals, lost])
    translator.function(fit, [signals, of_sheet, *of_fit])
    translator.function(describe, [signals, lost, of_sheet, *of_fit, array(1, len(FEATURES))])
    translator.function(find_stuck, [signals, array(*bounds.shape, constant=True), lost])

    graph = head_graph(head)
    writer = CWriter({"features": "features"}, prefix="network_")
    writer.reserve("features", "answer")
    network = writer.statements(graph.nodes())
    answer = writer.kept("answers", graph.outputs["answer"], network)
    network.append(f"    for (int i = 0; i < {len(FIELDS)}; ++i) answer[i] = {answer}[i];")
    values: dict[str, Any] = {
        **_texts(head),
        "interval": head.interval,
        "threshold": head.settings.threshold,
        "sensors": len(SENSORS),
        "meanings": [(name, FIELDS[name]) for name in LeakageEstimate._fields],
        "features": len(FEATURES),
        "structs": translator.structs,
        "functions": translator.functions,
        "sheet": {name: np.ravel(part).tolist() if np.ndim(part) else float(part) for name, part in sheet.items()},
        "scale": head.scale.tolist(),
        "limit": _limits(head).tolist(),
        "beside_stuck_sensor": BESIDE_STUCK_SENSOR,
        "bounds": bounds.ravel().tolist(),
        "fitted": [(name, np.size(part)) for name, part in fitted.items()],
        "helpers": writer.helpers,
        "tables": writer.tables,
        "network": "\n".join(network),
        "forget": FORGET,
    }
    return c_code(NAME, values)


def _texts(head: LeakageHead) -> dict[str, Any]:
    """What all templates say."""
    return {
        "version": __version__,
        "fields": list(FIELDS),
        "sample_time": head.settings.task.control_period,
        "window": head.settings.window,
        "signals": [(name, *MEANINGS[name]) for name in SIGNALS],
    }


def exported_head(head: LeakageHead, command: str) -> tuple[dict[str, bytes], list[str]]:
    """The files of an exported leakage head by name, and the results of their checks, one line each.

    Raises:
        TranslationError, TraceError: the head uses a construct without translation.
        ConfigurationError: the package onnx or onnxruntime is not installed.
        HydroError: the C code or the ONNX model gives other values.
    """
    samples, answers = head_vectors(head)
    episodes, length, _ = samples.shape
    graph = head_graph(head)
    writer = OnnxWriter({name: (node.size, node.kind) for name, node in graph.inputs.items()}, [*graph.outputs])
    outputs = {name: (writer.tensor(node), node.size, node.kind) for name, node in graph.outputs.items()}
    network = {"features": ", ".join(FEATURES), "answer": ", ".join(FIELDS)}
    title = "Network of the leakage head of a hydraulic servo axis"
    model = writer.model(outputs, title, network).SerializeToString()
    values = _texts(head) | {"samples": episodes * length, "allowed": LARGEST_DIFFERENCE}
    starts = np.tile(np.arange(length) == 0, episodes)
    rows = np.concatenate([samples, answers], axis=2).reshape(episodes * length, -1)
    texts = with_test(head_code(head), csv_text([*SIGNALS, *FIELDS], starts, rows), values)
    in_onnx, in_c = check_network(head, model, samples), compared(NAME, texts)
    facts = {**_facts(head), "checked": {NETWORK_FILE: in_onnx, "leakage_head.c": in_c}}
    largest = f"largest difference {in_onnx['largest_difference']:.2g}"
    report = [f"{NETWORK_FILE}: {in_onnx['windows']} windows in onnxruntime, {largest}", f"leakage_head.c: {in_c}"]
    return sealed("leakage head", {NETWORK_FILE: model, **texts}, facts, command), report


def head_vectors(head: LeakageHead) -> tuple[Floats, Floats]:
    """Signals (episodes, T, 5) of axes with the :data:`LEAKS`, and the head's answer at each sample (…, T, 9).

    No controller is needed: the command varies randomly and smoothly around the one that holds the axis. In the last
    episode some samples are lost, and a sensor sticks near the end.
    """
    config, count = head.settings.task, len(LEAKS)
    length = head.settings.window + (ESTIMATES - 1) * head.interval
    duration = max(config.episode_duration, (length + 1) * config.control_period)
    env = ServoHydraulicVectorEnv(count, config.model_copy(update={"episode_duration": duration}), info=False)
    observation, _ = env.reset(seed=list(HEAD_VECTORS.take(count)), options={"leakage_flow_lpm": list(LEAKS)})
    generator, state, command = np.random.default_rng(HEAD_VECTORS.first), None, np.zeros(count)
    samples, answers = np.empty((count, length, len(SIGNALS))), np.empty((count, length, len(FIELDS)))
    for k in range(length):
        observed = observation.copy()
        if k in (60, 61, 200):
            observed[-1, head.columns[:-1]] = np.nan
        if k >= length - head.interval:
            observed[-1, head.columns[1]] = samples[-1, k - 1, 1] / head.scale[1]
        samples[:, k] = MeasuredColumns.of(config).si(observed[:, head.columns, None])[:, :, 0]
        answers[:, k], state = head.predict(observed, state)
        position = head.settings.layout.si(observation, "position")
        command = 0.97 * command + 0.03 * generator.uniform(-1.0, 1.0, count)
        observation, *_ = env.step((command - 10.0 * position)[:, None].astype(np.float32))
    env.close()
    return samples, answers


def check_network(head: LeakageHead, model: bytes, samples: Floats) -> dict[str, Any]:
    """Differences between the ONNX model and the head's network on windows of the test vectors.

    Raises:
        HydroError: a difference is above :data:`LARGEST_DIFFERENCE`.
    """
    session = onnx_session(model)
    window, firsts = head.settings.window, range(0, ESTIMATES * head.interval, head.interval)
    windows = np.concatenate([samples[:, first : first + window].transpose(0, 2, 1) for first in firsts])
    features = features_of(windows, head.sheet)
    answers = np.array([session.run(None, {"features": row})[0] for row in features])
    expected = head.judge(features)
    largest = float((np.abs(answers - expected) / (1.0 + np.abs(expected))).max())
    if not largest <= LARGEST_DIFFERENCE:
        raise HydroError(f"leakage head: the ONNX model differs by {largest:.2g} from Python: cannot be exported")
    return {"windows": len(windows), "largest_difference": largest}


def _limits(head: LeakageHead) -> Floats:
    """Limits of the signals in the scales of the observation, (5,)."""
    limits = np.ones(len(SIGNALS))
    limits[head.rows] = observation_layout(head.settings.task)[3][head.columns]
    return limits


def _facts(head: LeakageHead) -> dict[str, Any]:
    """What the contract says of a head."""
    config = head.settings.task
    signals = []
    for name, limit in zip(SIGNALS, (_limits(head) * head.scale).tolist(), strict=True):
        sensor = getattr(config.sensors, name, None)
        low, high = (sensor.low, sensor.high) if sensor is not None else (-limit, limit)
        unit, meaning = MEANINGS[name]
        signals.append(Signal(name, unit, low, high, limit, meaning).facts)
    return {
        "sample_time": config.control_period,
        "window": head.settings.window,
        "interval": head.interval,
        "threshold": head.settings.threshold,
        "signals": signals,
        "outputs": FIELDS,
        "network": {
            "file": NETWORK_FILE,
            "input": list(FEATURES),
            "output": list(LeakageEstimate._fields),
            "missing": "repair of gaps, flow balance, features and the check for stuck sensors: the flow "
            "balance is an iteration whose end depends on its result; no plain operator does that, see the C code",
        },
        "rules": RULES,
        "training": head.settings.training,
    }
