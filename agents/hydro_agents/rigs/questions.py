"""The questions of `hydro new-rig`: figures on nameplates, data sheets and drawings."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import NamedTuple

from hydro_env import ConfigurationError
from hydro_env.mistakes import one_of
from hydro_env.task.sensors import SENSORS
from hydro_env.units import UNITS, in_si

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
