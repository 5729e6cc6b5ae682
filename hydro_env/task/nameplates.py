"""A rig from its nameplates: given values, computed values, and typical values with ranges for the rest."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Mapping
from typing import NamedTuple

import yaml

from hydro_env.errors import ConfigurationError
from hydro_env.mistakes import one_of
from hydro_env.plant.parameters import PlantParameters
from hydro_env.task.rig import Rig, rig_from
from hydro_env.task.sensors import SENSORS
from hydro_env.units import FULL_VOLTAGE, LITRE_PER_MINUTE, UNITS, in_si

BAR = 1e5
STEEL = 7850.0  # kg/m³
ASSUMED_ACCURACY = 2e-4  # of the stroke: largest constant error of the position sensor that follows from a rig
COIL_RESISTANCE = 2.5  # Ω; only its ratio to the amplifier's gain counts

LOADER = getattr(yaml, "CSafeLoader", yaml.SafeLoader)  # libyaml is several times as fast

Answers = Mapping[str, float | str]
Line = tuple[str, str, str]  # field, value as text, origin of the value

NEEDS = {
    "accumulator": "pump_flow",
    "line_length": "line_diameter",
    "line_diameter": "line_length",
    "pressure_accuracy": "pressure_range",
}
"""Answers that need another one."""

SENSOR_FIELDS = {"noise": "noise", "resolution": "resolution", "high": "range"}
"""Fields of a sensor, and the words of their questions."""

HEADER = """\
# A rig, written by hydro new-rig. Each value has its origin: given, computed, or assumed. Correct each
# value that you know better. A value without a unit is in SI; pressures are gauge pressures.
# Next: hydro check-rig --rig {source}
"""


def new_rig(answers: Answers, texts: Mapping[str, str], source: str) -> tuple[str, Rig]:
    """The text of a rig's file, and the rig that it describes.

    Args:
        answers: figures in SI, and texts, by the keys of :data:`QUESTIONS`.
        texts: the answers as the user wrote them.
        source: name of the file, for messages.

    Raises:
        ConfigurationError: the figures contradict each other, or the rig cannot work.
    """
    for key, needed in NEEDS.items():
        if key in answers and needed not in answers:
            raise ConfigurationError(f"{key.replace('_', '-')}: needs {needed.replace('_', '-')}")
    plate = _Plate(answers, texts)
    text = HEADER.format(source=source) + "".join(
        f"{group}:{comment}\n" + "".join(f"  {field}: {value}  # {origin}\n" for field, value, origin in lines)
        for group, comment, lines in plate.groups()
    )
    if sensors := plate.sensors():
        text += "sensors:  # as given; check-rig shows the rest\n"
        for name, fields in sensors.items():
            text += f"  {name}: {{{', '.join(f'{field}: {value}' for field, value in fields.items())}}}\n"
    how = "given" if "position_accuracy" in texts else "assumed"
    share = f"{100 * plate.bias / plate.si['stroke']:.3g} % of the stroke"
    text += f"# largest constant error of the position sensor (bias), {how}: {_in(plate.bias, 'm', 'mm')}, {share}\n"
    return text, rig_from(yaml.load(text, LOADER), source)


def _in(value: float, si: str, unit: str) -> str:
    """An SI value as text with three digits in a unit of :data:`~hydro_env.units.UNITS`."""
    return f"{value / UNITS[si][unit]:.3g} {unit}"


class _Plate:
    """What is given of a rig, and what follows from it.

    Args:
        answers: figures in SI, and texts.
        texts: the answers as the user wrote them.
    """

    def __init__(self, answers: Answers, texts: Mapping[str, str]) -> None:
        self.answers, self.texts = answers, {key: text.strip() for key, text in texts.items()}
        self.si = {key: value for key, value in answers.items() if isinstance(value, float)}
        self.area = 0.25 * math.pi * self.si["bore"] ** 2
        self.bias = self.si.get("position_accuracy", ASSUMED_ACCURACY) * self.si["stroke"]  # m
        rod_area = 0.25 * math.pi * self.si["rod"] ** 2
        self.piston_mass = STEEL * (1.2 * self.si["stroke"] * rod_area + 0.5 * self.si["bore"] * self.area)  # kg
        self.hose = "line_length" in answers and answers.get("line_kind") == "hose"
        self.supply = "accumulator" if "accumulator" in answers else "pump" if "pump_flow" in answers else "constant"

    def groups(self) -> Iterator[tuple[str, str, Iterator[Line]]]:
        """Name, comment and lines of each group of the file."""
        for name in PlantParameters.model_fields:
            yield name, "", getattr(self, f"_{name}")()
        uncertain = "  # uncertain values: each episode draws them; hydro identify narrows them with a recording"
        yield "randomisation", uncertain, self._ranges()

    def _given(self, field: str, key: str, otherwise: str = "", origin: str = "") -> Line:
        """A line with the value that the user gave, or else with another one."""
        return (field, self.texts[key], "given") if key in self.texts else (field, otherwise, origin)

    def _cylinder(self) -> Iterator[Line]:
        stiffness = self.area * self.si["supply_pressure"] / 0.5e-3
        dead = _in(0.1 * self.area * self.si["stroke"], "m³", "cm³")
        yield self._given("bore_diameter", "bore")
        yield self._given("rod_diameter", "rod")
        yield self._given("rod_diameter_a", "rod_a", "0", "assumed: no rod through chamber a")
        yield self._given("stroke", "stroke")
        yield self._given("dead_volume", "dead_volume", dead, "assumed: 10 % of bore area times stroke")
        steel = "computed: steel rod of 1.2 strokes, piston of half a bore"
        yield self._given("piston_mass", "piston_mass", f"{self.piston_mass:.3g} kg", steel)
        yield "end_stop_stiffness", _in(stiffness, "N/m", "kN/mm"), "assumed: full force presses 0.5 mm"
        yield "end_stop_damping", f"{1e-3 * stiffness:.3g}", "assumed: 1 ms times the stiffness; N s/m"

    def _valve(self) -> Iterator[Line]:
        si, texts = self.si, self.texts
        yield "model", "spool", "the bandwidth describes spool and drive together"
        yield self._given("rated_flow", "rated_flow")
        usual = "assumed: servo valves are rated at 70 bar, proportional valves often at 10 bar"
        yield self._given("rated_pressure_drop", "rated_drop", "70 bar", usual)
        usual = "assumed: a servo valve of this size; a proportional valve has 20 to 50 Hz"
        yield self._given("natural_frequency", "bandwidth", "80 Hz", usual)
        yield "damping_ratio", "0.8", "assumed"
        if "step_time" in texts:
            yield "slew_limit", f"{1 / si['step_time']:.4g}", f"computed: full stroke in {texts['step_time']}; 1/s"
        else:
            usual = "assumed: 0.2 times the natural frequency in rad/s; 1/s"
            yield "slew_limit", f"{0.2 * si.get('bandwidth', 2.0 * math.pi * 80.0):.3g}", usual
        overlap = si.get("overlap", 0.0)
        if "null_flow" in texts:
            drop = math.sqrt(si.get("rated_drop", 70.0 * BAR) / si["supply_pressure"])
            share = si["null_flow"] / si["rated_flow"] * drop
            if overlap:  # rounder edges let this flow pass over their overlap
                share = math.sqrt(share * (share + 2.0 * overlap / (1.0 - overlap)))
            yield "underlap", f"{100 * share:.3g} %", f"computed from a null flow of {texts['null_flow']}"
        elif overlap:
            yield "underlap", "0.2 %", "assumed: edges of an overlapped spool are nearly sharp"
        else:
            yield "underlap", "1 %", "assumed: a servo valve's lap"
        yield self._given("overlap", "overlap", "0 %", "assumed: none, as in servo valves")
        yield "null_shift", "0 %", "assumed: adjusted"
        yield self._given("edge_ratio", "spool_ratio", "1", "assumed: equal edges")
        yield "coil_resistance", f"{COIL_RESISTANCE:g}", "assumed; Ω; only its ratio to the gain counts"
        full, current = si.get("full_signal", FULL_VOLTAGE), texts.get("full_signal", "").endswith("A")
        origin = "assumed: full opening at 10 V"
        if "full_signal" in texts:
            origin = f"computed: full opening at {texts['full_signal']}"
            origin += ", which the amplifier sends at a command of 10 V" if current else ""
        amplifier = COIL_RESISTANCE * full / FULL_VOLTAGE if current else 0.625 * FULL_VOLTAGE / full
        yield "amplifier_gain", f"{amplifier:.6g}", origin
        yield "spool_gain", f"{1.0 / full if current else 0.4:.6g}", "full opening per ampere"

    def _lines(self) -> Iterator[Line]:
        value, origin = "0 cm³", "not given: the dead volume's range covers short lines"
        if "line_length" in self.si:
            volume = 0.25 * math.pi * self.si["line_diameter"] ** 2 * self.si["line_length"]
            value, origin = _in(volume, "m³", "cm³"), "computed: {line_length} of {line_diameter}".format(**self.texts)
        yield "volume_a", value, origin
        yield "volume_b", value, origin
        if self.hose:
            yield "wall_bulk_modulus", "0.3 GPa", "assumed: hose; V dp/dV of its wall"

    def _fluid(self) -> Iterator[Line]:
        yield "density", "872", "assumed: mineral oil ISO VG 46; kg/m³"
        yield "bulk_modulus", "1.2 GPa", "assumed"
        yield "air_fraction", "0.4 %", "assumed"

    def _load(self) -> Iterator[Line]:
        yield self._given("mass", "mass")
        yield self._given("spring_stiffness", "spring", "0", "assumed: no spring")
        yield "viscous_damping", f"{4 * (BAR * self.area):.3g}", "assumed: 4 bar on the bore at 1 m/s; N s/m"
        yield self._given("external_force", "external_force", "0", "assumed: none")

    def _friction(self) -> Iterator[Line]:
        yield "model", "stribeck", "assumed"
        yield "coulomb_force", f"{2 * (BAR * self.area):.3g} N", "assumed: 2 bar on the bore"
        yield "breakaway_force", f"{3 * (BAR * self.area):.3g} N", "assumed: 1.5 times the Coulomb force"
        yield "stribeck_velocity", "12 mm/s", "assumed"
        yield "transition_velocity", "1.5 mm/s", "assumed: smooths the sign of the speed"

    def _supply(self) -> Iterator[Line]:
        constant = self.supply == "constant"
        yield "model", self.supply, "assumed: pump not given" if constant else "from the figures given"
        yield self._given("pressure", "supply_pressure")
        yield self._given("tank_pressure", "tank_pressure", "1 bar", "assumed")
        if constant:
            return
        flow, usual = self.si["pump_flow"], "assumed: 80 % of the supply pressure"
        yield self._given("pump_flow", "pump_flow")
        slope = _in(flow / (5.0 * BAR), "m³/(s Pa)", "l/min/bar")
        yield "relief_slope", slope, "assumed: 5 bar more at full flow"
        if self.supply == "pump":
            litres = max(0.02 * flow / LITRE_PER_MINUTE, 0.1)
            yield "line_volume", f"{litres:.2g} l", "assumed: pressure line"
            return
        yield self._given("accumulator_volume", "accumulator")
        low = _in(0.8 * self.si["supply_pressure"], "Pa", "bar")
        yield self._given("precharge_pressure", "precharge", low, usual)
        yield "polytropic_index", "1.3", "assumed: nitrogen, neither isothermal nor adiabatic"

    def _leakage(self) -> Iterator[Line]:
        yield "internal_resistance", "2.0e+13", "assumed: a new seal, 0.03 l/min at 100 bar"

    def _ranges(self) -> Iterator[Line]:
        """The distributions of the uncertain values."""
        texts = self.texts
        if "dead_volume" in texts:
            yield "cylinder.dead_volume", "{factor: [0.8, 1.2]}", "drawings omit bores and pockets"
        else:
            origin = "published cylinders: 3 to 30 %, with hoses more"
            yield "cylinder.dead_volume", "{log_factor: [0.3, 3.0]}", origin
        yield "valve.rated_flow", "{factor: [0.9, 1.1]}", "tolerance of valves in series"
        if "bandwidth" in texts:
            yield "valve.natural_frequency", "{factor: [0.8, 1.25]}", "depends on pressure and amplitude"
        else:
            yield "valve.natural_frequency", "{log_factor: [0.4, 2.0]}", "proportional to fast servo valve"
        yield "valve.damping_ratio", "{uniform: [0.5, 1.1]}", "published valves"
        if "step_time" not in texts:
            yield "valve.slew_limit", "{log_factor: [0.5, 2.0]}", "step times of data sheets"
        overlapped = self.si.get("overlap", 0.0) > 0.0
        if overlapped:
            yield "valve.overlap", "{factor: [0.8, 1.2]}", "tolerance of the edges"
        if "null_flow" in texts:
            yield "valve.underlap", "{factor: [0.3, 1.2]}", "a pilot stage takes part of the null flow"
        elif not overlapped:
            yield "valve.underlap", "{uniform: [0 %, 3 %]}", "critical lap to worn edges"
        yield "valve.null_shift", "{uniform: [-1 %, 1 %]}", "temperature and supply"
        if self.hose:
            yield "lines.wall_bulk_modulus", "{log_uniform: [0.1 GPa, 1 GPa]}", "textile to wire braid"
        yield "fluid.bulk_modulus", "{uniform: [0.8 GPa, 1.6 GPa]}", "oils in service"
        yield "fluid.air_fraction", "{log_uniform: [0.1 %, 1.5 %]}", "well to badly bled"
        # Only the sum of load and piston matters: one range covers the uncertainty of both.
        unsure = 0.05 + (0.0 if "piston_mass" in texts else 0.3 * self.piston_mass / self.si["mass"])
        mass = f"{{factor: [{max(1 - unsure, 0.5):.3g}, {1 + unsure:.3g}]}}"
        yield "load.mass", mass, "weighed or from a drawing; piston and rod included"
        if "spring" in texts:
            yield "load.spring_stiffness", "{factor: [0.9, 1.1]}", "tolerance of springs"
        yield "load.viscous_damping", "{log_factor: [0.25, 5.0]}", "published cylinders: 1 to 20 bar"
        yield "friction.coulomb_force", "{log_factor: [0.25, 2.5]}", "low-friction to standard seals: 0.5 to 5 bar"
        times = "{uniform: [1.1, 1.9], times: friction.coulomb_force}"
        yield "friction.breakaway_force", times, "of the Coulomb force"
        yield "friction.stribeck_velocity", "{log_factor: [0.4, 2.5]}", "published seals"
        yield "supply.pressure", "{factor: [0.97, 1.03]}", "setting and gauge"
        if "tank_pressure" not in texts:
            yield "supply.tank_pressure", "{uniform: [0 bar, 4 bar]}", "return filter"
        if self.supply != "constant":
            yield "supply.pump_flow", "{factor: [0.92, 1.0]}", "volumetric efficiency"
            yield "supply.relief_slope", "{log_factor: [0.3, 2.5]}", "droop under flow"
        if self.supply == "pump":
            yield "supply.line_volume", "{log_factor: [0.3, 3.0]}", "length of the line"

    def sensors(self) -> dict[str, dict[str, str]]:
        """Fields of the sensors that were given; what is not given follows from the rig."""
        sensors: dict[str, dict[str, str]] = {}
        for name, key in {"position": "position", "pressure_a": "pressure", "pressure_b": "pressure"}.items():
            given = {field: f"{key}_{word}" for field, word in SENSOR_FIELDS.items()}
            sensors[name] = {field: self.texts[question] for field, question in given.items() if question in self.texts}
            if f"{key}_accuracy" in self.si:
                error = self.bias, "m", "mm"
                if key == "pressure":
                    error = self.si["pressure_accuracy"] * self.si["pressure_range"], "Pa", "bar"
                sensors[name]["bias"] = _in(*error)
        absent = str(self.answers.get("absent", "")).split(",")
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
    place = f"{question.name} '{text.strip()[:40]}'"
    known = {"line_kind": LINE_KINDS, "absent": SENSORS[1:]}.get(question.key)
    if known:
        words = [word.strip() for word in text.split(",")]
        if unknown := [word for word in words if word not in known]:
            raise ConfigurationError(f"{place}: '{unknown[0][:40]}': {one_of(unknown[0], known)}")
        return ",".join(words)
    unit = question.unit
    if unit == SIGNAL:
        unit = "A" if text.strip().endswith(tuple(UNITS["A"])) else "V"
    try:
        value = in_si(text, unit)
    except ValueError as error:
        raise ConfigurationError(f"{place}: {error}") from None
    try:
        number = float(value)
    except ValueError:
        comma = "; decimals need a point" if re.match(r"[-+]?\d*,\d", text.strip()) else ""
        example = f"must be a number with its unit, such as {question.example}"
        raise ConfigurationError(f"{place}: {example}{comma}") from None
    share = question.example.endswith("%")
    if isinstance(value, str) and number != 0.0 and (question.unit != "1" or share):
        raise ConfigurationError(f"{place}: needs a unit, such as {question.example}")
    if share and not 0.0 <= number < 1.0:
        raise ConfigurationError(f"{place}: must be within 0 to 100 %")
    if number == 0.0 and (question.required or question.key in DIVISORS):
        raise ConfigurationError(f"{place}: must be above 0")
    if question.key != "external_force" and not number >= 0.0:
        raise ConfigurationError(f"{place}: must not be negative")
    return number


def answers_from(texts: Mapping[str, str]) -> dict[str, float | str]:
    """All answers by key, from their texts by key.

    Raises:
        ConfigurationError: a required answer is missing, or one is impossible.
    """
    missing = [question.name for question in QUESTIONS if question.required and question.key not in texts]
    if missing:
        raise ConfigurationError(f"new-rig: {', '.join(missing)}: must be given; on a terminal the command asks")
    return {question.key: parsed(question, texts[question.key]) for question in QUESTIONS if question.key in texts}
