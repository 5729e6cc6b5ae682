"""Builds ``docs/playground.html``: three axes with the shipped controllers, in C, in one file without network.

    python docs/playground/build_page.py   # `make docs` runs it; it needs pip install 'hydro_env[playground]'

Sensors, noise and the transducers' lag are translated from the functions that the environment compiles, with the same
counter-based random numbers: an axis of the page measures what an axis of the environment measures.
"""

from __future__ import annotations

import base64
import gzip
import json
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from hydro_agents.controllers.base import search_space
from hydro_agents.detection.head import LeakageEstimate, LeakageHead
from hydro_agents.learning.loading import shipped
from hydro_agents.running.folders import pretrained_folder
from hydro_env import TaskConfig, __version__
from hydro_env.plant.analysis import speed_limits
from hydro_env.plant.equations import Derived
from hydro_env.plant.parameters import PARAMETER_PATHS, to_vector
from hydro_env.plant.states import State
from hydro_env.rendering import OIL
from hydro_env.task.random_numbers import between, noise_pair
from hydro_env.task.sensors import SENSORS
from hydro_env.task.settings import settings_of
from hydro_env.task.signals import FIRST_BIAS, lagged, sensor_reading
from hydro_env.units import FULL_VOLTAGE, LEAKAGE_TEST_PRESSURE, LITRE_PER_MINUTE
from hydro_rig.export.c_files import WARNINGS, compiled, render
from hydro_rig.export.contract import MeasuredSignal
from hydro_rig.export.controller import controller_code, controller_graph, variable_gains
from hydro_rig.export.expressions import DOUBLE, INT, UINT64
from hydro_rig.export.leakage_head import head_code
from hydro_rig.export.plant import plant_code
from hydro_rig.export.structured_text import st_name
from hydro_rig.export.translator import Translator

TEMPLATES = Path(__file__).parent
PAGE = TEMPLATES.with_suffix(".html")
AXES = 3

VIEW = (
    *State._fields,
    *Derived._fields,
    "command",
    *(f"measured_{name}" for name in SENSORS),
    "position_bias",
    *LeakageEstimate._fields,
)
"""Values of an axis that the page reads after each control period."""

_SENSOR = ("noise", "low", "high", "resolution")
CENTRE = 0.02  # m; about the middle of the range that the supply can hold against the spring
SEED = 20151
LEAK_COLOURS = ("#14213d", "#47207a", "#8a2387", "#bf2f5f", "#d1493a", "#de6a10")
"""From the smallest leak to the largest one, as ``style.css`` names them."""

COMPILER = [sys.executable, "-m", "ziglang", "cc", "-target", "wasm32-wasi", "-mexec-model=reactor"]


RIG_SLIDERS: tuple[dict[str, Any], ...] = tuple(
    {"name": name, "unit": unit, "low": low, "high": high, "scale": scale, "digits": 0, "parameter": parameter}
    for name, unit, low, high, scale, parameter in (
        ("Supply pressure", "bar", 60, 100, 1e5, "supply.pressure"),
        ("Moved mass", "kg", 20, 120, 1, "load.mass"),
        ("Force on the load, against extension", "N", -2000, 2000, 1, "load.external_force"),
    )
)
CHOICES = {"pid": "PID", "flow_linearising": "Flow linearisation", "ppo": "PPO on flow linearisation"}
"""Names of the controllers by kind, as ``hydro evaluate --agent`` names it."""

GAINS = {
    "proportional": ("Proportional gain", "1/m"),
    "integral": ("Integral gain", "1/(m s)"),
    "derivative": ("Derivative gain", "s/m"),
    "feedforward_extending": ("Feed-forward extending", "s/m"),
    "feedforward_retracting": ("Feed-forward retracting", "s/m"),
    "position_gain": ("Position gain, per pace of the loop", ""),
    "force_rate": ("Accelerating force fed forward", ""),
    "friction": ("Friction fed forward, share of data sheet", ""),
}
"""Label and unit of the slider of each gain that has one."""


@dataclass(frozen=True)
class Written:
    """A controller in C."""

    kind: str
    code: dict[str, str]
    signals: list[MeasuredSignal]  # that it reads
    gains: dict[str, float]  # those that a slider changes: tuned values
    sliders: list[dict[str, Any]]


def written(kind: str, config: TaskConfig) -> Written:
    """The C of a controller, with its gains in a structure.

    Raises:
        TraceError: the controller cannot be exported exactly.
    """
    controller: Any = shipped(kind, config)
    rows = {row.name: row for row in variable_gains(controller) if row.name in GAINS}
    space = search_space(type(controller.gains), config.plant) if rows else {}
    sliders: list[dict[str, Any]] = []
    for name, (label, unit) in GAINS.items():
        if name not in rows:
            continue
        value, (low, high, logarithmic) = float(rows[name].value), space[name]
        limits = {"low": value / 10.0, "high": value * 10.0} if logarithmic else {"low": low, "high": high}
        slider = {"name": label, "unit": unit, **limits, "value": value, "gain": f"{kind}.{name}"}
        sliders.append({**slider, "controller": kind, "logarithmic": logarithmic})
    graph = controller_graph(controller, config)
    gains = {name: float(row.value) for name, row in rows.items()}
    return Written(kind, controller_code(graph, type_name(kind)), [*graph.signals.signals], gains, sliders)


def type_name(kind: str) -> str:
    """Name of the C structure of a controller; its functions begin with ``kind``."""
    return st_name(kind)


def axis_sources(config: TaskConfig, controllers: Sequence[Written], head: LeakageHead) -> dict[str, str]:
    """C sources of the playground's axes, by file name.

    Raises:
        TranslationError: a function uses a construct without translation.
    """
    plant = plant_code(config.plant)
    translator = Translator()
    sensor = translator.record("Sensor", [(DOUBLE, name) for name in _SENSOR])
    transducer = translator.record("Transducer", [(DOUBLE, "pressure_lag"), (DOUBLE, "pressure_decay")])
    translator.function(between, [UINT64, INT, DOUBLE, DOUBLE])
    translator.function(noise_pair, [UINT64, INT, INT])
    translator.function(sensor_reading, [DOUBLE, DOUBLE, DOUBLE, sensor])
    translator.function(lagged, [DOUBLE, DOUBLE, DOUBLE, transducer])
    numbers = settings_of(config)[0]
    gains = [(one.kind, name, value) for one in controllers for name, value in one.gains.items()]
    sensors = {name: getattr(config.sensors, name) for name in SENSORS}
    values = {
        "version": __version__,
        "axes": AXES,
        "structs": translator.structs,
        "functions": translator.functions,
        "channels": [(name, [getattr(one, field) for field in _SENSOR]) for name, one in sensors.items()],
        "biases": [one.bias for one in sensors.values()],
        "first_bias": FIRST_BIAS,
        "transducer": [float(numbers["pressure_lag"]), float(numbers["pressure_decay"])],
        "previews": config.references.preview_times,
        "full_voltage": FULL_VOLTAGE,
        "latency": config.command_latency,
        "period": config.control_period,
        "stagger": head.interval // AXES,
        "controllers": [
            {
                "kind": one.kind,
                "type": type_name(one.kind),
                "signals": [(each.name, _signal(each.name, config), each.sensor) for each in one.signals],
            }
            for one in controllers
        ],
        "gains": gains,
        "places": {f"{kind}.{name}": place for place, (kind, name, _) in enumerate(gains)},
    }
    sources = {**plant, "axis.c": render("axis.c.j2", values, TEMPLATES), **head_code(head)}
    for one in controllers:
        sources |= one.code
    return sources


def _signal(name: str, config: TaskConfig) -> str:
    """C text of a signal."""
    if name in SENSORS:
        return f"view->measured[{SENSORS.index(name)}]"
    ahead = [f"reference_in_{1e3 * time:g}ms".replace(".", "_") for time in config.references.preview_times]
    return f"reference[{['reference', *ahead].index(name)}]"


def playground_page() -> str:
    """The page: the rig of the default task, with the shipped controllers and leakage head.

    Raises:
        HydroError: the compiler failed, or is not installed.
    """
    head = LeakageHead.load(pretrained_folder() / "leakage_head")
    config = head.settings.task
    own = dict(zip(PARAMETER_PATHS, to_vector(config.plant).tolist(), strict=True))
    controllers = [written(kind, config) for kind in CHOICES]
    turned = ("leakage.internal_resistance", *(slider["parameter"] for slider in RIG_SLIDERS))
    window = head.settings.window * config.control_period  # s
    facts = {
        "parameters": PARAMETER_PATHS,
        "own": {name: own[name] for name in turned},
        "view": VIEW,
        "previewTimes": config.references.preview_times,
        "period": config.control_period,
        "stroke": config.plant.cylinder.stroke,
        "largestSpeed": min(speed_limits(config.plant)),
        "centre": CENTRE,
        "seed": SEED,
        "testPressure": LEAKAGE_TEST_PRESSURE,
        "litrePerMinute": LITRE_PER_MINUTE,
        "rigSliders": [{**slider, "value": own[slider["parameter"]] / slider["scale"]} for slider in RIG_SLIDERS],
        "leakColours": [list(bytes.fromhex(colour[1:])) for colour in LEAK_COLOURS],
        "oil": OIL,
        "axes": [{"name": name, "controller": n} for n, name in enumerate(("PID", "Flow linearisation", "Mine"))],
        "controllers": [{"kind": kind, "name": name} for kind, name in CHOICES.items()],
        "gains": [f"{one.kind}.{name}" for one in controllers for name in one.gains],
        "gainSliders": [slider for one in controllers for slider in one.sliders],
        "threshold": head.settings.threshold,
        "window": window,
    }
    module = compiled(axis_sources(config, controllers, head), ["-s", *WARNINGS], COMPILER)
    values: dict[str, Any] = {
        **{file.stem: file.read_text(encoding="utf-8") for file in TEMPLATES.glob("*.js")},
        "style": (TEMPLATES / "style.css").read_text(encoding="utf-8"),
        "facts": json.dumps(facts, ensure_ascii=False, separators=(",", ":"), default=float),
        "wasm": base64.b64encode(gzip.compress(module, 9, mtime=0)).decode(),
        "window": f"{window:g}",
        "version": __version__,
    }
    return render("playground.html.j2", values, TEMPLATES)


if __name__ == "__main__":
    PAGE.write_text(playground_page(), encoding="utf-8")
