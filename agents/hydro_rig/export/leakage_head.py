"""The leakage head for other machines: C99 from measured signals to the estimate, compared with Python.

Repair of gaps, flow balance and features are translated from the compiled functions of :mod:`hydro_agents.detection`;
the network is traced from its NumPy code. Structured Text of the same, with the alarm, spreads a window over calls.
"""

import numpy as np

from hydro_agents.controllers.base import ObservationLayout
from hydro_agents.detection import activity, alarm, balance
from hydro_agents.detection.damaged_signals import bounds_of, find_stuck, repair
from hydro_agents.detection.detector import SIGNALS, MeasuredColumns
from hydro_agents.detection.features import FEATURES, describe
from hydro_agents.detection.head import BESIDE_STUCK_SENSOR, LeakageHead
from hydro_agents.running.seeds import HEAD_VECTORS
from hydro_env import ServoHydraulicVectorEnv, __version__
from hydro_env.folders import config_folder
from hydro_env.task.sensors import CHANNEL_UNITS, SENSORS
from hydro_env.task.signals import observation_layout
from hydro_env.types import ByName, Floats
from hydro_rig.export import structured_text
from hydro_rig.export.c_files import c_code, csv_text, render, tested
from hydro_rig.export.c_to_text import TextFunctions
from hydro_rig.export.c_writer import Writer
from hydro_rig.export.contract import SENSOR_MEANINGS
from hydro_rig.export.expressions import array
from hydro_rig.export.tracing import trace
from hydro_rig.export.translator import Translator

NAME, BLOCK = "leakage_head", "LeakageHead"
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
    "outside": "the answer is not valid: 1: the window is unlike the training; 2: the axis does not move; else 0",
}
FILES = (*(f"{NAME}.{end}" for end in ("c", "h", "st", "xml")), f"test_{NAME}.c", "vectors.csv", "README.md")
LARGEST_DIFFERENCE = 2e-5  # of a value, relative to 1 + its size, due to the order of float32 sums; more is an error
VECTOR_LEAKS = (0.01, 0.5, 2.0)  # l/min at 100 bar, in the episodes of the test vectors
ESTIMATES = 4  # control periods per episode of the test vectors


def head_code(head: LeakageHead) -> dict[str, str]:
    """C and Structured Text of a head by file, for windows of its shortest length.

    Raises:
        TranslationError, TraceError: a function uses a construct without translation.
    """
    window, sheet, config = head.settings.window, head.sheet._asdict(), head.settings.task
    bounds, limit = bounds_of(config), np.ones(len(SIGNALS))
    limit[head.rows] = observation_layout(config)[3][head.columns]  # in the scales of the observation
    fitted = balance.fit_balance(np.zeros((1, len(SIGNALS), window)), head.sheet)._asdict()  # for the parts' shapes
    translator = Translator()
    parts = [(array(*np.shape(part), constant=np.ndim(part) > 0), name) for name, part in sheet.items()]
    of_sheet = translator.record("Sheet", parts)
    signals, lost = array(1, len(SIGNALS), window), array(1, len(SENSORS))
    of_fit = translator.record("BalanceFit", [(array(*np.shape(part)), name) for name, part in fitted.items()])
    translator.function(repair, [signals, of_sheet, signals, lost])
    translator.function(balance.fit, [signals, of_sheet, of_fit])
    translator.function(describe, [signals, lost, of_sheet, of_fit, array(1, len(FEATURES))])
    translator.function(find_stuck, [signals, array(*bounds.shape, constant=True), lost])

    features = np.zeros((1, len(FEATURES)), np.float32)
    graph = trace(lambda features: {"answer": head.judge(features)}, {"features": features})
    sizes = {name: np.size(part) for name, part in fitted.items()}
    known = {"signals": signals.size, "whole": signals.size, "lost": lost.size, "stuck": lost.size, "sheet": sheet}
    known |= {"features": len(FEATURES), "answer": len(FIELDS), "balance": sizes, "bounds": bounds}
    functions = TextFunctions("".join(translator.structs + translator.functions), known, BLOCK)
    functions.function("Repair", "repair(signals, sheet, whole, lost)")
    functions.function("Stuck", "find_stuck(signals, bounds, stuck)")
    functions.function("Fit", "fit(whole, sheet, balance)", split="turn")
    functions.function("Describe", "describe(whole, lost, sheet, balance, features)")
    in_c = Writer(graph, {}, taken=("features", "answer"), prefix="network_")
    in_text = structured_text.TextWriter(graph, ("features", "answer", "factors", "totals", "done", "work"), BLOCK)
    values = {
        **_texts(head),
        "sensors": len(SENSORS),
        "features": len(FEATURES),
        "translator": translator,
        "sheet": sheet,
        "limit": limit,
        "beside_stuck_sensor": BESIDE_STUCK_SENSOR,
        "bounds": bounds,
        "fitted": sizes,
        "in_c": _network(in_c),
        "writer": in_c,
        "outlier": alarm.OUTLIER,
        "activity": activity,
        "in_text": _network(in_text),
        "text_writer": in_text,
        "text": functions,
    }
    text = structured_text.plain(render(f"{NAME}.st.j2", values))
    return {**c_code(NAME, values), f"{NAME}.st": text, f"{NAME}.xml": structured_text.plcopen_xml(text, BLOCK)}


def _network(writer: Writer) -> str:
    """Statements from the features to the answer."""
    writer.inputs = {"features": "features"}
    lines = writer.statements(writer.graph.nodes())
    answer = writer.kept("answers", writer.graph.outputs["answer"], lines)
    return "\n".join([*lines, writer.stored("answer", answer, len(FIELDS))])


def _texts(head: LeakageHead) -> ByName:
    return {
        "version": __version__,
        "head": head,
        "settings": head.settings,
        "fields": FIELDS,
        "signals": [(name, *MEANINGS[name]) for name in SIGNALS],
        "alarm": alarm.AlarmSettings.load(config_folder() / "agents" / "alarm.yaml"),
        "iterations": balance.ITERATIONS,
        "st": structured_text,
    }


def exported_head(head: LeakageHead, command: str) -> tuple[dict[str, bytes], list[str]]:
    """The files of an exported leakage head by name, and the result of their check, one line.

    Raises:
        TranslationError, TraceError: the head uses a construct without translation.
        HydroError: the C code gives other values.
    """
    samples, answers = head_vectors(head)
    episodes, length, _ = samples.shape
    values = _texts(head) | {"samples": episodes * length, "allowed": LARGEST_DIFFERENCE, "command": command}
    rows = []
    for signals, answer in zip(samples, answers, strict=True):
        rows += [[k == 0, *signals[k], *answer[k]] for k in range(length)]
    files, in_c = tested(NAME, NAME, head_code(head), csv_text([*SIGNALS, *FIELDS], rows), values)
    return files, [f"leakage_head.c: {in_c}"]


def head_vectors(head: LeakageHead) -> tuple[Floats, Floats]:
    """Signals (episodes, T, 5) of axes with the :data:`VECTOR_LEAKS`, and the head's answer at each sample (…, T, 9).

    No controller is needed: the command varies randomly and smoothly around the one that holds the axis. In the last
    episode some samples are lost, and a sensor sticks near the end.
    """
    config, count = head.settings.task, len(VECTOR_LEAKS)
    layout = ObservationLayout.of(config)
    length = head.settings.window + (ESTIMATES - 1) * head.interval
    duration = max(config.episode_duration, (length + 1) * config.control_period)
    env = ServoHydraulicVectorEnv(count, config.model_copy(update={"episode_duration": duration}), info=False)
    observation, _ = env.reset(seed=list(HEAD_VECTORS.take(count)), options={"leakage_flow_lpm": list(VECTOR_LEAKS)})
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
        position = layout.si(observation, "position")
        command = 0.97 * command + 0.03 * generator.uniform(-1.0, 1.0, count)
        observation, *_ = env.step((command - 10.0 * position)[:, None].astype(np.float32))
    env.close()
    return samples, answers
