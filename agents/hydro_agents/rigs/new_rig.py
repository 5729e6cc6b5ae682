"""The file of a new rig: given values, computed values, and typical values with ranges for the rest."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import NamedTuple

import yaml

from hydro_env import ConfigurationError
from hydro_env.task.rig import Rig, rig_from
from hydro_env.units import FULL_VOLTAGE, LITRE_PER_MINUTE, UNITS

BAR = 1e5
STEEL = 7850.0  # kg/m³
ASSUMED_ACCURACY = 2e-4  # of the stroke: largest constant error of the position sensor that follows from a rig

Answers = Mapping[str, float | str]


class Entry(NamedTuple):
    """One line of the file: a field, its value as text, and its origin; a range if the value is uncertain."""

    path: str  # group.field
    value: str
    origin: str
    range: str = ""  # as YAML; empty: the value is certain
    reason: str = ""  # of the range


class _Values:
    """Turns answers into entries: the given figure, or a default value with its origin."""

    def __init__(self, answers: Answers, texts: Mapping[str, str]) -> None:
        self.answers, self.texts = answers, texts

    def number(self, key: str, otherwise: float = 0.0) -> float:
        value = self.answers.get(key, otherwise)
        return value if isinstance(value, float) else otherwise

    def given(self, path: str, key: str, otherwise: tuple[str, str], sure: str = "", unsure: str = "") -> Entry:
        """An entry for an answer.

        Args:
            path: of the field.
            key: of the answer.
            otherwise: value and origin without an answer.
            sure: range and reason, as ``range; reason``, of a given value.
            unsure: the same for the default value.
        """
        known = key in self.answers
        value, origin = (self.texts[key].strip(), "given") if known else otherwise
        limits, _, reason = (sure if known else unsure).partition("; ")
        return Entry(path, value, origin, limits, reason)


def in_unit(value: float, unit: str, si: str) -> str:
    """An SI value as text with three digits in a unit of :data:`~hydro_env.units.UNITS`."""
    return f"{value / UNITS[si][unit]:.3g} {unit}"


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
        raise ConfigurationError("--accumulator: needs --pump-flow; without a pump the supply counts as constant")
    if ("line_length" in answers) != ("line_diameter" in answers):
        raise ConfigurationError("--line-length and --line-diameter: give both, or none")
    if "pressure_accuracy" in answers and "pressure_range" not in answers:
        raise ConfigurationError("--pressure-accuracy: needs --pressure-range, of which it is a share")
    values = _Values(answers, texts)
    area = 0.25 * math.pi * values.number("bore") ** 2
    entries = [
        *_cylinder(values, area),
        *_valve(values),
        *_lines(values),
        *_fluid(),
        *_load(values, area),
        *_friction(area),
        *_supply(values),
        Entry("leakage.internal_resistance", "2.0e+13", "assumed: a new seal, 0.03 l/min at 100 bar"),
    ]
    text = _written(entries, _sensors(values), source)
    return text, rig_from(yaml.safe_load(text), source)


def _cylinder(values: _Values, area: float) -> list[Entry]:
    swept = area * values.number("stroke")
    push = area * values.number("supply_pressure") / 0.5e-3
    return [
        values.given("cylinder.bore_diameter", "bore", ("", "")),
        values.given("cylinder.rod_diameter", "rod", ("", "")),
        values.given("cylinder.rod_diameter_a", "rod_a", ("0", "assumed: no rod through chamber a")),
        values.given("cylinder.stroke", "stroke", ("", "")),
        values.given(
            "cylinder.dead_volume",
            "dead_volume",
            (in_unit(0.1 * swept, "cm³", "m³"), "assumed: 10 % of bore area times stroke"),
            "{factor: [0.8, 1.2]}; drawings omit bores and pockets",
            "{log_factor: [0.3, 3.0]}; published cylinders: 3 to 30 %, with hoses more",
        ),
        values.given(
            "cylinder.piston_mass",
            "piston_mass",
            (f"{_steel_mass(values, area):.3g} kg", "computed: steel rod of 1.2 strokes, piston of half a bore"),
        ),
        Entry("cylinder.end_stop_stiffness", in_unit(push, "kN/mm", "N/m"), "assumed: full force presses 0.5 mm"),
        Entry("cylinder.end_stop_damping", f"{1e-3 * push:.3g}", "assumed: 1 ms times the stiffness; N s/m"),
    ]


def _steel_mass(values: _Values, area: float) -> float:
    """Mass in kg of a steel rod of 1.2 strokes and a piston of half a bore."""
    rod = 0.25 * math.pi * values.number("rod") ** 2
    return STEEL * (1.2 * values.number("stroke") * rod + 0.5 * values.number("bore") * area)


def _valve(values: _Values) -> list[Entry]:
    frequency = values.number("bandwidth", 2.0 * math.pi * 80.0)
    resistance, gain, spool_gain, signal = 2.5, 0.625, 0.4, "assumed: full opening at 10 V"
    if "full_signal" in values.answers:
        full, signal = values.number("full_signal"), f"computed: full opening at {values.texts['full_signal'].strip()}"
        if values.texts["full_signal"].strip().endswith("A"):
            gain, spool_gain = resistance * full / FULL_VOLTAGE, 1.0 / full
            signal = f"{signal}, which the amplifier sends at a command of 10 V"
        else:
            gain *= FULL_VOLTAGE / full
    underlap = ("1 %", "assumed: a servo valve's lap; zero with a measured overlap")
    width = "{uniform: [0 %, 3 %]}; critical lap to worn edges"
    if "overlap" in values.answers:
        underlap, width = ("0.2 %", "assumed: edges of an overlapped spool are nearly sharp"), ""
    elif "null_flow" in values.answers:
        drops = values.number("rated_drop", 70.0 * BAR) / values.number("supply_pressure")
        share = values.number("null_flow") / values.number("rated_flow") * math.sqrt(drops)
        underlap = (f"{100.0 * share:.3g} %", f"computed from a null flow of {values.texts['null_flow'].strip()}")
        width = "{factor: [0.3, 1.2]}; a pilot stage takes part of the null flow"
    return [
        Entry("valve.model", "spool", "the bandwidth describes spool and drive together"),
        values.given("valve.rated_flow", "rated_flow", ("", ""), "{factor: [0.9, 1.1]}; tolerance of valves in series"),
        values.given(
            "valve.rated_pressure_drop",
            "rated_drop",
            ("70 bar", "assumed: servo valves are rated at 70 bar, proportional valves often at 10 bar"),
        ),
        values.given(
            "valve.natural_frequency",
            "bandwidth",
            ("80 Hz", "assumed: a servo valve of this size; a proportional valve has 20 to 50 Hz"),
            "{factor: [0.8, 1.25]}; depends on pressure and amplitude",
            "{log_factor: [0.4, 2.0]}; proportional to fast servo valve",
        ),
        Entry("valve.damping_ratio", "0.8", "assumed", "{uniform: [0.5, 1.1]}", "published valves"),
        Entry(
            "valve.slew_limit",
            f"{1.0 / values.number('step_time'):.4g}",
            f"computed: full stroke in {values.texts['step_time'].strip()}; 1/s",
        )
        if "step_time" in values.answers
        else Entry(
            "valve.slew_limit",
            f"{0.2 * frequency:.3g}",
            "assumed: 0.2 times the natural frequency in rad/s; 1/s",
            "{log_factor: [0.5, 2.0]}",
            "step times of data sheets",
        ),
        Entry("valve.underlap", *underlap, *_split(width)),
        values.given(
            "valve.overlap",
            "overlap",
            ("0 %", "assumed: none, as in servo valves"),
            "{factor: [0.8, 1.2]}; tolerance of the edges",
        ),
        Entry("valve.null_shift", "0 %", "assumed: adjusted", "{uniform: [-1 %, 1 %]}", "temperature and supply"),
        values.given("valve.edge_ratio", "spool_ratio", ("1", "assumed: equal edges")),
        Entry("valve.coil_resistance", f"{resistance:g}", "assumed; Ω; only its ratio to the gain counts"),
        Entry("valve.amplifier_gain", f"{gain:.6g}", signal),
        Entry("valve.spool_gain", f"{spool_gain:.6g}", "full opening per ampere"),
    ]


def _split(text: str) -> tuple[str, str]:
    limits, _, reason = text.partition("; ")
    return limits, reason


def _lines(values: _Values) -> list[Entry]:
    if "line_length" not in values.answers:
        none = "not given: the dead volume's range covers short lines"
        return [Entry(f"lines.volume_{side}", "0 cm³", none) for side in "ab"]
    volume = 0.25 * math.pi * values.number("line_diameter") ** 2 * values.number("line_length")
    origin = f"computed: {values.texts['line_length'].strip()} of {values.texts['line_diameter'].strip()}"
    entries = [Entry(f"lines.volume_{side}", in_unit(volume, "cm³", "m³"), origin) for side in "ab"]
    if values.answers.get("line_kind") == "hose":
        soft = ("{log_uniform: [0.1 GPa, 1 GPa]}", "textile to wire braid")
        entries.append(Entry("lines.wall_bulk_modulus", "0.3 GPa", "assumed: hose; V dp/dV of its wall", *soft))
    return entries


def _fluid() -> list[Entry]:
    return [
        Entry("fluid.density", "872", "assumed: mineral oil ISO VG 46; kg/m³"),
        Entry("fluid.bulk_modulus", "1.2 GPa", "assumed", "{uniform: [0.8 GPa, 1.6 GPa]}", "oils in service"),
        Entry("fluid.air_fraction", "0.4 %", "assumed", "{log_uniform: [0.1 %, 1.5 %]}", "well to badly bled"),
    ]


def _load(values: _Values, area: float) -> list[Entry]:
    damping = 4.0 * BAR * area
    # Only the sum of load and piston matters: one range covers the uncertainty of both.
    unsure = 0.05 + (
        0.0 if "piston_mass" in values.answers else 0.3 * _steel_mass(values, area) / values.number("mass")
    )
    low, high = max(1.0 - unsure, 0.5), 1.0 + unsure
    return [
        values.given(
            "load.mass",
            "mass",
            ("", ""),
            f"{{factor: [{low:.3g}, {high:.3g}]}}; weighed or from a drawing; piston and rod included",
        ),
        values.given(
            "load.spring_stiffness", "spring", ("0", "assumed: no spring"), "{factor: [0.9, 1.1]}; tolerance of springs"
        ),
        Entry(
            "load.viscous_damping",
            f"{damping:.3g}",
            "assumed: 4 bar on the bore at 1 m/s; N s/m",
            "{log_factor: [0.25, 5.0]}",
            "published cylinders: 1 to 20 bar",
        ),
        values.given("load.external_force", "external_force", ("0", "assumed: none")),
    ]


def _friction(area: float) -> list[Entry]:
    return [
        Entry("friction.model", "stribeck", "assumed"),
        Entry(
            "friction.coulomb_force",
            f"{2.0 * BAR * area:.3g} N",
            "assumed: 2 bar on the bore",
            "{log_factor: [0.25, 2.5]}",
            "low-friction to standard seals: 0.5 to 5 bar",
        ),
        Entry(
            "friction.breakaway_force",
            f"{3.0 * BAR * area:.3g} N",
            "assumed: 1.5 times the Coulomb force",
            "{uniform: [1.1, 1.9], times: friction.coulomb_force}",
            "of the Coulomb force",
        ),
        Entry("friction.stribeck_velocity", "12 mm/s", "assumed", "{log_factor: [0.4, 2.5]}", "published seals"),
        Entry("friction.transition_velocity", "1.5 mm/s", "assumed: smooths the sign of the speed"),
    ]


def _supply(values: _Values) -> list[Entry]:
    regulated = "pump_flow" in values.answers
    model = "accumulator" if "accumulator" in values.answers else "pump" if regulated else "constant"
    entries = [
        Entry("supply.model", model, "from the figures given" if regulated else "assumed: pump not given"),
        values.given("supply.pressure", "supply_pressure", ("", ""), "{factor: [0.97, 1.03]}; setting and gauge"),
        values.given(
            "supply.tank_pressure",
            "tank_pressure",
            ("1 bar", "assumed"),
            "",
            "{uniform: [0 bar, 4 bar]}; return filter",
        ),
    ]
    if not regulated:
        return entries
    slope, droop = values.number("pump_flow") / (5.0 * BAR), ("{log_factor: [0.3, 2.5]}", "droop under flow")
    entries += [
        values.given("supply.pump_flow", "pump_flow", ("", ""), "{factor: [0.92, 1.0]}; volumetric efficiency"),
        Entry("supply.relief_slope", f"{slope:.3g}", "assumed: 5 bar more at full flow; m³/(s Pa)", *droop),
    ]
    if model == "pump":
        volume = max(0.02 * values.number("pump_flow") / LITRE_PER_MINUTE, 0.1)  # l
        wide = ("{log_factor: [0.3, 3.0]}", "length of the line")
        return [*entries, Entry("supply.line_volume", f"{volume:.2g} l", "assumed: pressure line", *wide)]
    precharge = 0.8 * values.number("supply_pressure")
    return [
        *entries,
        values.given("supply.accumulator_volume", "accumulator", ("", "")),
        values.given(
            "supply.precharge_pressure",
            "precharge",
            (in_unit(precharge, "bar", "Pa"), "assumed: 80 % of the supply pressure"),
        ),
        Entry("supply.polytropic_index", "1.3", "assumed: nitrogen, neither isothermal nor adiabatic"),
    ]


def _sensors(values: _Values) -> list[str]:
    """Lines of the sensors, with the accuracy of the position; what is not given follows from the rig."""
    texts = values.texts
    sensors: dict[str, dict[str, str]] = {"position": {}, "pressure_a": {}, "pressure_b": {}, "spool_position": {}}
    for field, what in (("noise", "noise"), ("resolution", "resolution"), ("high", "range")):
        for channel, key in (("position", "position"), ("pressure_a", "pressure"), ("pressure_b", "pressure")):
            if f"{key}_{what}" in texts:
                sensors[channel][field] = texts[f"{key}_{what}"].strip()
    share, known = values.number("position_accuracy", ASSUMED_ACCURACY), "position_accuracy" in values.answers
    largest = in_unit(share * values.number("stroke"), "mm", "m")
    if known:
        sensors["position"]["bias"] = largest
    if "pressure_accuracy" in values.answers:
        error = values.number("pressure_accuracy") * values.number("pressure_range")
        for channel in ("pressure_a", "pressure_b"):
            sensors[channel]["bias"] = in_unit(error, "bar", "Pa")
    for channel in str(values.answers.get("absent", "")).split(","):
        if channel:
            sensors[channel] = {"fitted": "false"}
    lines = [
        f"  {channel}: {{{', '.join(f'{name}: {value}' for name, value in fields.items())}}}"
        for channel, fields in sensors.items()
        if fields
    ]
    heading = ["sensors:  # as given; the rest follows from stroke and supply pressure"] if lines else []
    origin = f"{'given' if known else 'assumed'}: {largest}, {100.0 * share:.3g} % of the stroke"
    return [*heading, *lines, f"# largest constant error of the position sensor (bias), {origin}"]


def _written(entries: list[Entry], sensors: list[str], source: str) -> str:
    lines = [
        "# A rig, written by hydro new-rig. Each value has its origin: given, computed, or assumed. Correct each",
        "# value that you know better. A value without a unit is in SI; pressures are gauge pressures.",
        f"# Next: hydro check-rig --rig {source}",
    ]
    group = ""
    for entry in entries:
        first, field = entry.path.split(".")
        if first != group:
            lines.append(f"{first}:")
            group = first
        lines.append(f"  {field}: {entry.value}  # {entry.origin}")
    lines += [
        "randomisation:  # uncertain values: each episode draws them; hydro identify narrows them with a recording",
        *(f"  {entry.path}: {entry.range}  # {entry.reason}" for entry in entries if entry.range),
    ]
    return "\n".join([*lines, *sensors]) + "\n"
