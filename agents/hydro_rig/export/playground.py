"""The playground: three axes with the shipped controllers, in C, in one HTML file without server and network.

Sensors, noise and the transducers' lag are translated from the functions that the environment compiles, with the same
counter-based random numbers: an axis of the page measures what an axis of the environment measures.
"""

from __future__ import annotations

import base64
import gzip
import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple, cast

import numpy as np
from matplotlib.colors import to_rgb
from numpy.typing import NDArray

from hydro_agents.controllers.base import ClassicalController, Observation, search_space
from hydro_agents.detection.head import LeakageEstimate, LeakageHead
from hydro_agents.learning.opponents import shipped
from hydro_agents.report.palette import LEAK_LOOKS, css_rules
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
from hydro_rig.export.c_files import WARNINGS, CCode, compiled, cross_compiler, render
from hydro_rig.export.controller import controller_code, controller_graph, memory_type
from hydro_rig.export.expressions import DOUBLE, INT, UINT64
from hydro_rig.export.leakage_head import head_code
from hydro_rig.export.plant import plant_code
from hydro_rig.export.translator import Translator

TEMPLATES = Path(__file__).parent / "playground"

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

_RIG_SLIDERS = (
    ("Supply pressure", "bar", 60, 100, 1e5, "supply.pressure"),
    ("Moved mass", "kg", 20, 120, 1, "load.mass"),
    ("Force on the load, against extension", "N", -2000, 2000, 1, "load.external_force"),
)
_FIELDS = ("name", "unit", "low", "high", "scale", "parameter")
RIG_SLIDERS: tuple[dict[str, Any], ...] = tuple(
    {**dict(zip(_FIELDS, row, strict=True)), "digits": 0} for row in _RIG_SLIDERS
)

PAGE_FILE = "playground.html"


class TunableMemory(NamedTuple):
    """Memory of a :class:`Tunable`."""

    own: Any  # of the controller
    gains: dict[str, NDArray[np.float64]]  # each ()


class Tunable:
    """A classical controller that takes some of its gains from its memory; it starts with its own gains.

    Args:
        controller: any controller whose class makes it from gains and task by plain arithmetic.
        names: the gains that can be changed.
    """

    def __init__(self, controller: ClassicalController, names: tuple[str, ...]) -> None:
        self.controller = controller
        self.names = names

    def predict(
        self,
        observation: Observation,
        state: TunableMemory | None = None,
        episode_start: NDArray[np.bool_] | None = None,
        deterministic: bool = True,
    ) -> tuple[NDArray[np.float32], TunableMemory]:
        """Commands for the observations; see :class:`~hydro_agents.controllers.base.Controller`."""
        original = self.controller.gains
        values = dict(original)
        gains = state.gains if state is not None else {name: np.array(values[name]) for name in self.names}
        turned = type(original).model_construct(**{**values, **gains})
        controller = type(self.controller)(turned, self.controller.config)
        own = state.own if state is not None else None
        action, own = controller.predict(observation, own, episode_start, deterministic)
        return action, TunableMemory(own, gains)


@dataclass(frozen=True)
class Choice:
    """A controller by its kind, as ``hydro evaluate --agent`` names it."""

    kind: str
    name: str
    gains: dict[str, tuple[str, str]]  # field → label of its slider, unit


CHOICES = (
    Choice(
        "pid",
        "PID",
        {
            "proportional": ("Proportional gain", "1/m"),
            "integral": ("Integral gain", "1/(m s)"),
            "derivative": ("Derivative gain", "s/m"),
            "feedforward_extending": ("Feed-forward extending", "s/m"),
            "feedforward_retracting": ("Feed-forward retracting", "s/m"),
        },
    ),
    Choice(
        "flow_linearising",
        "Flow linearisation",
        {
            "position_gain": ("Position gain, per pace of the loop", ""),
            "force_rate": ("Accelerating force fed forward", ""),
            "friction": ("Friction fed forward, share of data sheet", ""),
        },
    ),
    Choice("ppo", "PPO on flow linearisation", {}),
)


@dataclass(frozen=True)
class Written:
    """A controller in C."""

    choice: Choice
    code: CCode
    signals: tuple[str, ...]  # that it reads, in order
    gains: dict[str, float]  # tuned values
    sliders: list[dict[str, Any]]


def written(choice: Choice, config: TaskConfig) -> Written:
    """The C of a controller.

    Raises:
        TraceError: the controller cannot be exported exactly.
    """
    controller = shipped(choice.kind, config)
    tuned: dict[str, float] = {}
    sliders: list[dict[str, Any]] = []
    if choice.gains:
        classical = cast("ClassicalController", controller)
        tuned = {name: float(getattr(classical.gains, name)) for name in choice.gains}
        space = search_space(type(classical.gains), config.plant)
        for name, (words, unit) in choice.gains.items():
            low, high, logarithmic = space[name]
            limits = (tuned[name] / 10.0, tuned[name] * 10.0) if logarithmic else (low, high)
            slider = {"name": words, "unit": unit, "low": limits[0], "high": limits[1], "value": tuned[name]}
            identity = {"gain": f"{choice.kind}.{name}", "controller": choice.kind, "logarithmic": logarithmic}
            sliders.append({**slider, **identity})
        controller = Tunable(classical, tuple(choice.gains))
    graph = controller_graph(controller, config)
    signals = tuple(signal.name for signal in graph.signals.signals)
    return Written(choice, controller_code(graph, choice.kind), signals, tuned, sliders)


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
    before = [sum(len(one.gains) for one in controllers[:place]) for place in range(len(controllers) + 1)]
    fitted = [getattr(config.sensors, name) for name in SENSORS]
    values = {
        "version": __version__,
        "axes": AXES,
        "structs": translator.structs,
        "functions": translator.functions,
        "channels": [
            (name, [getattr(one, field) for field in _SENSOR]) for name, one in zip(SENSORS, fitted, strict=True)
        ],
        "biases": [one.bias for one in fitted],
        "first_bias": FIRST_BIAS,
        "transducer": [float(numbers["pressure_lag"]), float(numbers["pressure_decay"])],
        "previews": config.references.preview_times,
        "full_voltage": FULL_VOLTAGE,
        "latency": config.command_latency,
        "period": config.control_period,
        "stagger": head.interval // AXES,
        "controllers": [
            {
                "kind": one.choice.kind,
                "memory": memory_type(one.code.name),
                "signals": [_signal(name, config) for name in one.signals],
                "gains": one.gains,
                "first": first,
            }
            for one, first in zip(controllers, before, strict=False)
        ],
        "gains": before[-1],
    }
    sources = {**plant.files, "axis.c": render("axis.c.j2", values, TEMPLATES), **head_code(head).files}
    for one in controllers:
        sources |= one.code.files
    return sources


def _signal(name: str, config: TaskConfig) -> str:
    if name in SENSORS:
        return f"view->measured[{SENSORS.index(name)}]"
    if name == "previous_voltage":
        return f"{FULL_VOLTAGE} * view->command"
    ahead = [
        "reference",
        *(f"reference_in_{1e3 * time:g}ms".replace(".", "_") for time in config.references.preview_times),
    ]
    return f"reference[{ahead.index(name)}]"


def playground_page() -> str:
    """The page: the rig of the default task, with the shipped controllers and leakage head.

    Raises:
        ConfigurationError: the package ziglang is not installed.
        HydroError: the compiler failed.
    """
    head = LeakageHead.load(pretrained_folder() / "leakage_head")
    config = head.settings.task
    own = dict(zip(PARAMETER_PATHS, to_vector(config.plant).tolist(), strict=True))
    controllers = [written(choice, config) for choice in CHOICES]
    sliders = [slider for one in controllers for slider in one.sliders]
    facts = {
        "parameters": PARAMETER_PATHS,
        "own": {
            name: own[name] for name in ("leakage.internal_resistance", *(one["parameter"] for one in RIG_SLIDERS))
        },
        "view": VIEW,
        "previewTimes": config.references.preview_times,
        "period": config.control_period,
        "stroke": config.plant.cylinder.stroke,
        "largestSpeed": min(speed_limits(config.plant)),
        "centre": CENTRE,
        "seed": SEED,
        "testPressure": LEAKAGE_TEST_PRESSURE,
        "litrePerMinute": LITRE_PER_MINUTE,
        "rigSliders": [{**one, "value": own[one["parameter"]] / one["scale"]} for one in RIG_SLIDERS],
        "leakColours": [[round(255 * part) for part in to_rgb(look.colour)] for look in LEAK_LOOKS.values()],
        "oil": OIL,
        "axes": [
            {"name": name, "controller": number} for number, name in enumerate(("PID", "Flow linearisation", "Mine"))
        ],
        "controllers": [{"kind": one.choice.kind, "name": one.choice.name} for one in controllers],
        "gains": [slider["gain"] for slider in sliders],
        "gainSliders": sliders,
        "threshold": head.settings.threshold,
        "window": head.settings.window * config.control_period,
    }
    module = compiled(axis_sources(config, controllers, head), ["-s", *WARNINGS], web_compiler())
    wasm = base64.b64encode(gzip.compress(module, 9, mtime=0)).decode()
    parts = {name: (TEMPLATES / f"{name}.js").read_text(encoding="utf-8") for name in ("machine", "drawing", "plots")}
    script = (TEMPLATES / "page.js").read_text(encoding="utf-8")
    values: dict[str, Any] = {
        **parts,
        "page": script,
        "style": f"{css_rules()}\n{(TEMPLATES / 'style.css').read_text(encoding='utf-8')}",
        "facts": json.dumps(facts, ensure_ascii=False, separators=(",", ":"), default=float),
        "wasm": wasm,
        "window": f"{head.settings.window * config.control_period:g}",
        "version": __version__,
    }
    return render("playground.html.j2", values, TEMPLATES)


def web_compiler() -> list[str]:
    """Command of the compiler for WebAssembly.

    Raises:
        ConfigurationError: the compiler is not installed.
    """
    return [*cross_compiler("wasm32-wasi", "the playground is"), "-mexec-model=reactor"]
