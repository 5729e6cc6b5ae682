"""The file of a new rig: given values, computed values, and typical values with ranges for the rest."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from pathlib import Path
from typing import NamedTuple

import jinja2
import yaml

from hydro_env import ConfigurationError
from hydro_env.mistakes import one_of
from hydro_env.task.rig import Rig, rig_from
from hydro_env.task.sensors import SENSORS
from hydro_env.units import FULL_VOLTAGE, LITRE_PER_MINUTE, UNITS, in_si

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
        answers: figures in SI, and texts, by the keys of :data:`hydro_agents.rigs.new_rig.QUESTIONS`.
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


SIGNAL = "V or A"  # unit of the question whose answer is a voltage or a current
LINE_KINDS = ("pipe", "hose")

DIVISORS = ("rated_drop", "step_time", "full_signal")  # optional answers that must be above zero


class Question(NamedTuple):
    """One figure of a rig."""

    name: str  # as the user writes it
    group: str  # heading of the question
    unit: str  # SI; empty: text
    example: str
    what: str
    required: bool = False

    @property
    def key(self) -> str:
        """Its key among the answers."""
        return self.name.replace("-", "_")


QUESTIONS = (
    Question("bore", "cylinder", "m", "63 mm", "Diameter of the bore.", required=True),
    Question("rod", "cylinder", "m", "36 mm", "Diameter of the rod (chamber b).", required=True),
    Question("rod-a", "cylinder", "m", "36 mm", "Diameter of the rod through chamber a, of a double-rod cylinder."),
    Question("stroke", "cylinder", "m", "500 mm", "Stroke.", required=True),
    Question("dead-volume", "cylinder", "m³", "100 cm3", "Oil beyond the stroke, each side: ports, end position."),
    Question("piston-mass", "cylinder", "kg", "8 kg", "Mass of piston and rod."),
    Question("rated-flow", "valve", "m³/s", "40 l/min", "Rated flow of the valve.", required=True),
    Question("rated-drop", "valve", "Pa", "70 bar", "Pressure drop at the rated flow, over both edges: 2 x 35 bar."),
    Question("bandwidth", "valve", "rad/s", "60 Hz", "Frequency at which the spool lags by 90 degrees, small signals."),
    Question("step-time", "valve", "s", "12 ms", "Time of a step of the spool from 0 to 100 %."),
    Question("full-signal", "valve", SIGNAL, "10 V", "Input for full opening: a voltage, or a current of the coil."),
    Question("null-flow", "valve", "m³/s", "0.5 l/min", "Leakage flow of the valve at null, at the supply pressure."),
    Question("overlap", "valve", "1", "10 %", "Dead band to each side of null, of full stroke; 0 % if compensated."),
    Question("spool-ratio", "valve", "1", "0.5", "Edges of chamber b over those of chamber a; 0.5 for a 2:1 spool."),
    Question("supply-pressure", "supply", "Pa", "160 bar", "Supply pressure at the valve.", required=True),
    Question("tank-pressure", "supply", "Pa", "2 bar", "Pressure in the return line at the valve."),
    Question("pump-flow", "supply", "m³/s", "30 l/min", "Flow of the pump; without it the supply counts as constant."),
    Question("accumulator", "supply", "m³", "4 l", "Volume of the accumulator; needs pump-flow."),
    Question("precharge", "supply", "Pa", "130 bar", "Gas pressure of the empty accumulator."),
    Question("mass", "load", "kg", "200 kg", "Moved mass without piston and rod.", required=True),
    Question("external-force", "load", "N", "2 kN", "Constant force on the rod, positive against extension (weight)."),
    Question("spring", "load", "N/m", "50 N/mm", "Stiffness of a spring with its rest at mid-stroke."),
    Question("line-length", "lines", "m", "1.5 m", "Length of each line between valve and cylinder."),
    Question("line-diameter", "lines", "m", "12 mm", "Inner diameter of these lines."),
    Question("line-kind", "lines", "", "hose", f"Kind of these lines: {' or '.join(LINE_KINDS)}."),
    Question("position-noise", "sensors", "m", "0.02 mm", "Noise of the position sensor (standard deviation)."),
    Question("position-accuracy", "sensors", "1", "0.02 %", "Accuracy of the position sensor, of the stroke."),
    Question("position-resolution", "sensors", "m", "5 um", "Smallest step of the position reading."),
    Question("pressure-range", "sensors", "Pa", "250 bar", "Upper end of the range of the pressure sensors."),
    Question("pressure-noise", "sensors", "Pa", "0.2 bar", "Noise of the pressure sensors (standard deviation)."),
    Question("pressure-accuracy", "sensors", "1", "0.5 %", "Accuracy class of the pressure sensors, of their range."),
    Question("pressure-resolution", "sensors", "Pa", "0.01 bar", "Smallest step of the pressure readings."),
    Question("absent", "sensors", "", "spool_position", f"Sensors that the rig lacks: {', '.join(SENSORS[1:])}."),
)


def parsed(question: Question, text: str) -> float | str:
    """An answer: a number in SI, or text.

    Raises:
        ConfigurationError: number or unit is missing, the unit belongs to another quantity, or a word is unknown.
    """
    place, known = f"{question.name} '{text.strip()[:40]}'", _known_words(question)
    if known:
        words = [word.strip() for word in text.split(",")]
        if unknown := [word for word in words if word not in known]:
            raise ConfigurationError(f"{place}: '{unknown[0][:40]}': {one_of(unknown[0], known)}")
        return ",".join(words)
    try:
        value = in_si(text, _unit(question, text))
    except ValueError as error:
        raise ConfigurationError(f"{place}: {error}") from None
    try:
        number = float(value)
    except ValueError:
        comma = "; decimals need a point" if re.match(r"[-+]?\d*,\d", text.strip()) else ""
        raise ConfigurationError(
            f"{place}: must be a number with its unit, such as {question.example}{comma}"
        ) from None
    share = question.example.endswith("%")
    if isinstance(value, str) and number != 0.0 and (question.unit != "1" or share):
        raise ConfigurationError(f"{place}: needs a unit, such as {question.example}")
    if share and number >= 1.0:
        raise ConfigurationError(f"{place}: must be below 100 %")
    if question.key != "external_force" and not number >= 0.0:
        raise ConfigurationError(f"{place}: must not be negative")
    if number == 0.0 and (question.required or question.key in DIVISORS):
        raise ConfigurationError(f"{place}: must be above 0")
    return number


def _known_words(question: Question) -> tuple[str, ...]:
    return {"line_kind": LINE_KINDS, "absent": SENSORS[1:]}.get(question.key, ())


def _unit(question: Question, text: str) -> str:
    """SI unit of an answer; a full signal in amperes is a current, otherwise a voltage."""
    if question.unit != SIGNAL:
        return question.unit
    return "A" if text.strip().endswith(tuple(UNITS["A"])) else "V"


def answers_from(texts: Mapping[str, str]) -> dict[str, float | str]:
    """All answers by key, from their texts by key.

    Raises:
        ConfigurationError: a required answer is missing, or one is impossible.
    """
    missing = [question.name for question in QUESTIONS if question.required and question.key not in texts]
    if missing:
        raise ConfigurationError(f"new-rig: {', '.join(missing)}: must be given; on a terminal the command asks")
    return {question.key: parsed(question, texts[question.key]) for question in QUESTIONS if question.key in texts}
