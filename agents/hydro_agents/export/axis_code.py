"""The axes of the playground as C: the plant with sensors and controllers, one control period at a time.

Sensors, noise and the transducers' lag are translated from the functions that the environment compiles, with the same
counter-based random numbers: an axis of the page measures what an axis of the environment measures.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from hydro_agents.detection.head import LeakageEstimate, LeakageHead
from hydro_agents.export.c_types import DOUBLE, INT, UINT64
from hydro_agents.export.choices import Written
from hydro_agents.export.head_code import head_code
from hydro_agents.export.plant_code import plant_code, render
from hydro_agents.export.translator import Translator
from hydro_env import TaskConfig, __version__
from hydro_env.plant.equations import Derived
from hydro_env.plant.states import State
from hydro_env.task.random_numbers import between, noise_pair
from hydro_env.task.sensors import SENSORS
from hydro_env.task.settings import settings_of
from hydro_env.task.signals import FIRST_BIAS, lagged, sensor_reading
from hydro_env.units import FULL_VOLTAGE

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
                "memory": one.code.memory,
                "signals": [_signal(name, config) for name in one.signals],
                "gains": one.gains,
                "first": first,
            }
            for one, first in zip(controllers, before, strict=False)
        ],
        "gains": before[-1],
    }
    sources = {"plant.h": plant.header, "plant.c": plant.source, "axis.c": render("axis.c.j2", values, TEMPLATES)}
    detector = head_code(head)
    sources |= {"leakage_head.h": detector.header, "leakage_head.c": detector.source}
    for one in controllers:
        sources |= {f"{one.code.name}.h": one.code.header, f"{one.code.name}.c": one.code.source}
    return sources


def _signal(name: str, config: TaskConfig) -> str:
    """The C expression for a signal of a controller."""
    if name in SENSORS:
        return f"view->measured[{SENSORS.index(name)}]"
    if name == "previous_voltage":
        return f"{FULL_VOLTAGE} * view->command"
    ahead = [
        "reference",
        *(f"reference_in_{1e3 * time:g}ms".replace(".", "_") for time in config.references.preview_times),
    ]
    return f"reference[{ahead.index(name)}]"
