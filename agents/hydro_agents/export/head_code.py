"""C99 code of the leakage head: it reads measured signals sample by sample and returns the estimate.

Repair of gaps, flow balance and features are translated from the compiled functions of :mod:`hydro_agents.detection`;
the network is traced from its NumPy code.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from hydro_agents.detection.balance import fit, fit_balance
from hydro_agents.detection.features import FEATURES, SIGNALS, describe, repair
from hydro_agents.detection.head import BESIDE_STUCK_SENSOR, LeakageEstimate, LeakageHead
from hydro_agents.detection.stuck import bounds_of, find_stuck
from hydro_agents.export.c_types import DOUBLE, array
from hydro_agents.export.c_writer import CWriter
from hydro_agents.export.graph import Graph
from hydro_agents.export.plant_code import render
from hydro_agents.export.tracing import trace
from hydro_agents.export.translator import Translator
from hydro_env import __version__
from hydro_env.task.sensors import SENSORS
from hydro_env.task.signals import observation_layout

MEANINGS = {
    "position": ("m", "measured, from the middle of the stroke; positive: extended"),
    "pressure_a": ("Pa", "gauge pressure of the chamber on the bore side"),
    "pressure_b": ("Pa", "gauge pressure of the chamber on the rod side"),
    "spool_position": ("1", "of full stroke; positive: extends"),
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
FORGET = 4
"""Multiples of window times interval after which the C code restarts its sample counter."""


@dataclass(frozen=True)
class HeadCode:
    """C sources of a leakage head, as text."""

    header: str
    source: str

    def write(self, folder: Path) -> None:
        """Write ``leakage_head.h`` and ``leakage_head.c``."""
        (folder / "leakage_head.h").write_text(self.header, encoding="utf-8")
        (folder / "leakage_head.c").write_text(self.source, encoding="utf-8")


def head_graph(head: LeakageHead) -> Graph:
    """From ``features`` to ``answer``, the fields of a :class:`~hydro_agents.detection.head.LeakageEstimate`."""
    features = np.zeros((1, len(FEATURES)), dtype=np.float32)
    return trace(lambda features: {"answer": head.judge(features)}, {"features": features})


def head_code(head: LeakageHead) -> HeadCode:
    """C sources of a head, for windows of its shortest length.

    Raises:
        TranslationError, TraceError: a function uses a construct without translation.
    """
    window, sheet = head.settings.window, head.sheet._asdict()
    translator = Translator()
    kinds = [
        (array(*np.shape(values), element="const double") if np.ndim(values) else DOUBLE, name)
        for name, values in sheet.items()
    ]
    of_sheet = translator.record("Sheet", kinds)
    signals, lost = array(1, len(SIGNALS), window), array(1, len(SENSORS))
    shapes = {name: np.shape(part) for name, part in _fitted(head)._asdict().items()}
    fitted = [array(*shape) for shape in shapes.values()]
    translator.function(repair, [signals, of_sheet, signals, lost])
    translator.function(fit, [signals, of_sheet, *fitted])
    translator.function(describe, [signals, lost, of_sheet, *fitted, array(1, len(FEATURES))])

    bounds = bounds_of(head.settings.task)
    translator.function(find_stuck, [signals, array(*bounds.shape, element="const double"), lost])

    graph = head_graph(head)
    writer = CWriter({"features": "features"}, prefix="network_")
    writer.reserve("features", "answer")
    network = writer.statements(graph.nodes())
    answer, copied = writer.kept("answers", graph.outputs["answer"])
    network += [f"    {line}" for line in copied]
    network.append(f"    for (int i = 0; i < {len(FIELDS)}; ++i) answer[i] = {answer}[i];")
    config = head.settings.task
    names, _, scales, limits = observation_layout(config)
    values: dict[str, Any] = {
        "version": __version__,
        "period": config.control_period,
        "window": window,
        "interval": head.interval,
        "threshold": head.settings.threshold,
        "signals": [(name, *MEANINGS[name]) for name in SIGNALS],
        "sensors": len(SENSORS),
        "fields": [(name, FIELDS[name]) for name in LeakageEstimate._fields],
        "features": len(FEATURES),
        "structs": translator.structs,
        "functions": translator.functions,
        "sheet": {name: np.ravel(part).tolist() if np.ndim(part) else float(part) for name, part in sheet.items()},
        "scale": [float(scales[names.index(name)]) for name in SIGNALS],
        "limit": [float(limits[names.index(name)]) for name in SIGNALS],
        "beside_stuck_sensor": BESIDE_STUCK_SENSOR,
        "bounds": bounds.ravel().tolist(),
        "fitted": [(name, int(np.prod(shape))) for name, shape in shapes.items()],
        "helpers": writer.helpers,
        "tables": writer.tables,
        "network": "\n".join(network),
        "forget": FORGET,
    }
    return HeadCode(*(render(f"leakage_head.{kind}.j2", values) for kind in ("h", "c")))


def _fitted(head: LeakageHead) -> Any:
    """A fit of one window, for the shapes of its parts."""
    return fit_balance(np.zeros((1, len(SIGNALS), head.settings.window)), head.sheet)
