"""The file of a new rig: given values, computed values, and typical values with ranges for the rest."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path

import jinja2
import yaml

from hydro_env import ConfigurationError
from hydro_env.task.rig import Rig, rig_from
from hydro_env.units import FULL_VOLTAGE, LITRE_PER_MINUTE, UNITS

TEMPLATE = Path(__file__).with_name("new_rig.yaml.j2")
"""The file with its comments: every field, its value, where the value comes from, and its range."""

BAR = 1e5
STEEL = 7850.0  # kg/m³
ASSUMED_ACCURACY = 2e-4  # of the stroke: largest constant error of the position sensor that follows from a rig
COIL_RESISTANCE = 2.5  # Ω; only its ratio to the amplifier's gain counts

Answers = Mapping[str, float | str]

SENSOR_FIELDS = {"noise": "noise", "resolution": "resolution", "high": "range"}
"""Fields of a sensor, and the words of their questions."""


def new_rig(answers: Answers, texts: Mapping[str, str], source: str) -> tuple[str, Rig]:
    """The text of a rig's file, and the rig that it describes.

    Args:
        answers: figures in SI, and texts, by the keys of :data:`hydro_agents.rigs.questions.QUESTIONS`.
        texts: the answers as the user wrote them.
        source: name of the file, for messages.

    Raises:
        ConfigurationError: the figures contradict each other, or the rig cannot work.
    """
    if "accumulator" in answers and "pump_flow" not in answers:
        raise ConfigurationError("accumulator: needs pump-flow; without a pump the supply counts as constant")
    if ("line_length" in answers) != ("line_diameter" in answers):
        raise ConfigurationError("line-length and line-diameter: give both, or none")
    if "pressure_accuracy" in answers and "pressure_range" not in answers:
        raise ConfigurationError("pressure-accuracy: needs pressure-range, of which it is a share")
    texts = {key: text.strip() for key, text in texts.items()}
    environment = jinja2.Environment(undefined=jinja2.StrictUndefined, trim_blocks=True, lstrip_blocks=True)
    environment.filters["unit"] = _in_unit
    template = environment.from_string(TEMPLATE.read_text(encoding="utf-8"))
    numbers = _figures(answers, texts)
    text = template.render(texts=texts, source=source, n=numbers, sensors=_sensors(answers, texts, numbers["bias"]))
    return f"{text}\n", rig_from(yaml.safe_load(text), source)


def _in_unit(value: float, si: str, unit: str) -> str:
    """An SI value as text with three digits in a unit of :data:`~hydro_env.units.UNITS`."""
    return f"{value / UNITS[si][unit]:.3g} {unit}"


def _figures(answers: Answers, texts: Mapping[str, str]) -> dict[str, float]:
    """What follows from the answers, in SI."""
    figures = {key: value for key, value in answers.items() if isinstance(value, float)}
    bore, stroke, supply = figures["bore"], figures["stroke"], figures["supply_pressure"]
    area, rod_area = (0.25 * math.pi * diameter**2 for diameter in (bore, figures["rod"]))
    pump_flow = figures.get("pump_flow", 0.0)
    piston_mass = STEEL * (1.2 * stroke * rod_area + 0.5 * bore * area)
    # Only the sum of load and piston matters: one range covers the uncertainty of both.
    unsure = 0.05 + (0.0 if "piston_mass" in figures else 0.3 * piston_mass / figures["mass"])
    null_share = figures.get("null_flow", 0.0) / figures["rated_flow"]
    line_area = 0.25 * math.pi * figures.get("line_diameter", 0.0) ** 2
    return {
        "bandwidth": 2.0 * math.pi * 80.0,
        **figures,
        **_amplifier(figures.get("full_signal", FULL_VOLTAGE), texts.get("full_signal", "").endswith("A")),
        "dead_volume": 0.1 * area * stroke,
        "piston_mass": piston_mass,
        "end_stop_stiffness": area * supply / 0.5e-3,
        "bar_on_bore": BAR * area,
        "null_share": null_share * math.sqrt(figures.get("rated_drop", 70.0 * BAR) / supply),
        "line_volume": line_area * figures.get("line_length", 0.0),
        "hose": "line_length" in figures and answers.get("line_kind") == "hose",
        "mass_unsure": unsure,
        "relief_slope": pump_flow / (5.0 * BAR),
        "supply_line_litres": max(0.02 * pump_flow / LITRE_PER_MINUTE, 0.1),
        "precharge": 0.8 * supply,
        "bias": figures.get("position_accuracy", ASSUMED_ACCURACY) * stroke,
    }


def _amplifier(full_signal: float, current: bool) -> dict[str, float]:
    """Gains with which a signal (V, or A of the coil) opens the valve fully."""
    if current:
        gains = {"amplifier_gain": COIL_RESISTANCE * full_signal / FULL_VOLTAGE, "spool_gain": 1.0 / full_signal}
    else:
        gains = {"amplifier_gain": 0.625 * FULL_VOLTAGE / full_signal, "spool_gain": 0.4}
    return {"current": current, **gains}


def _sensors(answers: Answers, texts: Mapping[str, str], bias: float) -> dict[str, dict[str, str]]:
    """Fields of the sensors that were given; what is not given follows from the rig."""
    sensors: dict[str, dict[str, str]] = {}
    for name, key in {"position": "position", "pressure_a": "pressure", "pressure_b": "pressure"}.items():
        given = {field: f"{key}_{word}" for field, word in SENSOR_FIELDS.items()}
        sensors[name] = {field: texts[question] for field, question in given.items() if question in texts}
    if "position_accuracy" in answers:
        sensors["position"]["bias"] = _in_unit(bias, "m", "mm")
    share, reach = answers.get("pressure_accuracy"), answers.get("pressure_range")
    if isinstance(share, float) and isinstance(reach, float):
        for name in ("pressure_a", "pressure_b"):
            sensors[name]["bias"] = _in_unit(share * reach, "Pa", "bar")
    absent = str(answers.get("absent", "")).split(",")
    sensors |= {name: {"fitted": "false"} for name in absent if name}
    return {name: fields for name, fields in sensors.items() if fields}
