"""The file of a rig from its nameplates: the questions, the answers, and a text in which every value has its origin."""

from collections.abc import Mapping
from typing import Any, NamedTuple

from hydro_env import ConfigurationError
from hydro_env.mistakes import one_of
from hydro_env.plant.parameters import PARAMETER_UNITS
from hydro_env.task.nameplates import FIELDS, curve_fit, lap_and_knee, position_error, rig_values
from hydro_env.task.rig import Rig, rig_from
from hydro_env.task.sensors import CHANNEL_UNITS, SENSORS
from hydro_env.types import ByName
from hydro_env.units import FACTORS, UNITS, in_si, split_quantity

SIGNAL = "V or A"  # unit of the question whose answer is a voltage or a current
WORDS = {
    "line_kind": ("pipe", "hose"),
    "line_waves": ("yes", "no"),
    "edges": ("rounded", "sharp"),
    "pressure_sensors": ("cylinder", "valve"),
    "absent": SENSORS[1:],
}
"""Answers that are words."""
ABOVE_ZERO = ("rated_drop", "step_time", "full_signal", "structure_share")  # optional answers


class Question(NamedTuple):
    """One figure of a rig."""

    name: str  # as the user writes it
    group: str  # heading of the question
    unit: str  # SI; empty: text
    example: str  # in the unit in which the file shows it
    what: str
    required: bool = False

    @property
    def key(self) -> str:
        """Its key among the answers."""
        return self.name.replace("-", "_")


_ASKED = {
    "cylinder": (
        ("bore", "m", "63 mm", "Diameter of the bore.", True),
        ("rod", "m", "36 mm", "Diameter of the rod (chamber b).", True),
        ("rod-a", "m", "36 mm", "Diameter of the rod through chamber a, of a double-rod cylinder."),
        ("stroke", "m", "500 mm", "Stroke.", True),
        ("dead-volume", "m³", "100 cm3", "Oil beyond the stroke, each side: ports, end position."),
        ("piston-mass", "kg", "8 kg", "Mass of piston and rod."),
    ),
    "valve": (
        ("rated-flow", "m³/s", "40 l/min", "Rated flow of the valve.", True),
        ("rated-drop", "Pa", "70 bar", "Pressure drop at the rated flow, over both edges: 2 x 35 bar."),
        ("bandwidth", "rad/s", "60 Hz", "Frequency at which the spool lags by 90 degrees, small signals."),
        ("step-time", "s", "12 ms", "Time of a step of the spool from 0 to 100 %."),
        ("full-signal", SIGNAL, "10 V", "Input for full opening: a voltage, or a current of the coil."),
        ("null-flow", "m³/s", "0.5 l/min", "Leakage flow of the valve at null, at the supply pressure."),
        ("overlap", "1", "10 %", "Dead band to each side of null, of full stroke; 0 % if compensated."),
        ("flow-curve", "", "20%:4%, 50%:30%, 100%:100%", "Catalogue's flow curve: points SIGNAL:FLOW, of full."),
        ("edges", "", "sharp", "Metering edges: rounded (worn), or sharp as in the textbook."),
        ("spool-ratio", "1", "0.5", "Edges of chamber b over those of chamber a; 0.5 for a 2:1 spool."),
    ),
    "supply": (
        ("supply-pressure", "Pa", "160 bar", "Supply pressure at the valve.", True),
        ("tank-pressure", "Pa", "2 bar", "Pressure in the return line at the valve."),
        ("pump-flow", "m³/s", "30 l/min", "Flow of the pump; without it the supply counts as constant."),
        ("accumulator", "m³", "4 l", "Volume of the accumulator; needs pump-flow."),
        ("precharge", "Pa", "130 bar", "Gas pressure of the empty accumulator."),
    ),
    "load": (
        ("mass", "kg", "200 kg", "Moved mass without piston and rod.", True),
        ("external-force", "N", "2 kN", "Constant force on the rod, positive against extension (weight)."),
        ("spring", "N/m", "50 N/mm", "Stiffness of a spring with its rest at mid-stroke."),
        ("structure-frequency", "rad/s", "6 Hz", "Lowest natural frequency of boom or frame, if you know it."),
        ("structure-share", "1", "50 %", "Share of the mass that swings with it."),
        ("structure-damping", "1", "0.02", "Damping ratio of this swing."),
    ),
    "lines": (
        ("line-length", "m", "1.5 m", "Length of each line between valve and cylinder."),
        ("line-diameter", "m", "12 mm", "Inner diameter of these lines."),
        ("line-kind", "", "hose", "Kind of these lines: pipe or hose."),
        ("line-waves", "", "yes", "Simulate waves in them: yes from some 2 m on, or with sensors at the valve."),
    ),
    "sensors": (
        ("position-noise", "m", "0.02 mm", "Noise of the position sensor (standard deviation)."),
        ("position-accuracy", "1", "0.02 %", "Accuracy of the position sensor, of the stroke."),
        ("position-resolution", "m", "5 um", "Smallest step of the position reading."),
        ("pressure-range", "Pa", "250 bar", "Upper end of the range of the pressure sensors."),
        ("pressure-noise", "Pa", "0.2 bar", "Noise of the pressure sensors (standard deviation)."),
        ("pressure-accuracy", "1", "0.5 %", "Accuracy class of the pressure sensors, of their range."),
        ("pressure-resolution", "Pa", "0.01 bar", "Smallest step of the pressure readings."),
        ("pressure-sensors", "", "valve", "Where the pressure sensors sit: cylinder or valve."),
        ("absent", "", "spool_position", f"Sensors that the rig lacks: {', '.join(SENSORS[1:])}."),
    ),
}
"""By heading: name, unit, example, what it is; ``True``: it must be given."""

QUESTIONS = tuple(Question(name, group, *rest) for group, rows in _ASKED.items() for name, *rest in rows)


def parsed(question: Question, text: str) -> float | str:
    """An answer: a number in SI, or text.

    Raises:
        ConfigurationError: number or unit is missing, the unit belongs to another quantity, or a word is unknown.
    """
    place = f"{question.name} '{text.strip()[:40]}'"
    known = WORDS.get(question.key)
    if known:
        words = [word.strip() for word in text.split(",")]
        for word in words:
            if word not in known:
                raise ConfigurationError(f"{place}: '{word[:40]}': {one_of(word, known)}")
        return ",".join(words)
    if question.key == "flow_curve":
        try:
            lap_and_knee(text)
        except ValueError as error:
            raise ConfigurationError(f"{place}: {error}, such as {question.example}") from None
        return text
    unit, share = question.unit, question.example.endswith("%")
    if unit == SIGNAL:
        unit = "A" if text.strip().endswith(tuple(UNITS["A"])) else "V"
    try:
        value = in_si(text, unit)
        number = float(value)
        if isinstance(value, str) and number != 0.0 and (unit != "1" or share):
            raise ValueError("has no unit")
    except ValueError:
        raise ConfigurationError(f"{place}: must be a number with its unit, such as {question.example}") from None
    if share and not 0.0 <= number < 1.0:
        raise ConfigurationError(f"{place}: must be within 0 to 100 %")
    positive = question.required or question.key in ABOVE_ZERO
    if question.key != "external_force" and not (number > 0.0 or (number == 0.0 and not positive)):
        raise ConfigurationError(f"{place}: must be above 0")
    return number


def answers_from(texts: Mapping[str, str]) -> ByName:
    """The figures of a rig (:func:`~hydro_env.task.nameplates.rig_values`), from the texts of the answers by key.

    Raises:
        ConfigurationError: a required answer is missing, or one is impossible.
    """
    missing = [question.name for question in QUESTIONS if question.required and question.key not in texts]
    if missing:
        raise ConfigurationError(f"new-rig: {', '.join(missing)}: must be given; on a terminal the command asks")
    if texts.get("pressure_sensors", "").strip() == "valve" and "line_length" not in texts:
        raise ConfigurationError("pressure-sensors=valve: needs line-length: without lines both places are one")
    figures = {question.key: parsed(question, texts[question.key]) for question in QUESTIONS if question.key in texts}
    if "full_signal" in figures:
        is_current = texts["full_signal"].strip().endswith("A")
        figures["full_current" if is_current else "full_voltage"] = figures.pop("full_signal")
    return figures


def written_answers(figures: ByName) -> dict[str, str]:
    """The figures of a rig by key, as people write them."""
    examples = {question.key: question.example for question in QUESTIONS}
    examples |= {"full_voltage": "10 V", "full_current": "40 mA"}
    texts = {}
    for key, value in figures.items():
        _, unit = split_quantity(examples[key].replace("cm3", "cm³"))
        texts[key] = value if isinstance(value, str) else _shown(value, unit)
    return texts


def _shown(value: Any, unit: str) -> str:
    """A value of the file, its numbers in a unit; one that :data:`UNITS` does not have is SI."""
    if isinstance(value, tuple):
        return f"[{', '.join(_shown(end, unit) for end in value)}]"
    if not isinstance(value, float):
        return str(value).lower()
    return f"{value / FACTORS.get(unit, 1.0):.12g} {unit}".strip()


HEADER = """\
# A rig, written by hydro new-rig. Each value has its origin: given, computed, or assumed. Correct each
# value that you know better. A value without a unit is in SI; pressures are gauge pressures.
# Next: hydro check-rig --rig {source}
"""

ORIGINS = {
    "cylinder.rod_diameter_a": "assumed: no rod through chamber a",
    "cylinder.dead_volume": "assumed: 10 % of bore area times stroke",
    "cylinder.piston_mass": "computed: steel rod of 1.2 strokes, piston of half a bore",
    "cylinder.end_stop_stiffness": "assumed: full force presses 0.5 mm",
    "cylinder.end_stop_damping": "assumed: 1 ms times the stiffness",
    "valve.model": "the bandwidth describes spool and drive together",
    "valve.rated_pressure_drop": "assumed: servo valves are rated at 70 bar, proportional valves often at 10 bar",
    "valve.natural_frequency": "assumed: a servo valve of this size; a proportional valve has 20 to 50 Hz",
    "valve.slew_limit": "assumed: 0.2 times the natural frequency in rad/s",
    "valve.underlap": "assumed: a servo valve's lap; edges of an overlapped spool are nearly sharp",
    "valve.overlap": "assumed: none, as in servo valves",
    "valve.null_shift": "assumed: adjusted",
    "valve.edge_ratio": "assumed: equal edges",
    "valve.coil_resistance": "assumed; only its ratio to the gain counts",
    "valve.amplifier_gain": "assumed: full opening at 10 V",
    "valve.spool_gain": "full opening per ampere",
    "load.tip_share": "assumed: half of the mass swings",
    "load.tip_damping_ratio": "assumed: welded steel",
    "lines.volume_a": "not given: the dead volume's range covers short lines",
    "lines.wall_bulk_modulus": "assumed: hose; V dp/dV of its wall",
    "fluid.density": "assumed: mineral oil ISO VG 46",
    "load.spring_stiffness": "assumed: no spring",
    "load.viscous_damping": "assumed: 4 bar on the bore at 1 m/s",
    "load.external_force": "assumed: none",
    "friction.coulomb_force": "assumed: 2 bar on the bore",
    "friction.breakaway_force": "assumed: 1.5 times the Coulomb force",
    "friction.transition_velocity": "assumed: smooths the sign of the speed",
    "supply.model": "from the figures given",
    "supply.relief_slope": "assumed: 5 bar more at full flow",
    "supply.line_volume": "assumed: pressure line",
    "supply.precharge_pressure": "assumed: 80 % of the supply pressure",
    "supply.polytropic_index": "assumed: nitrogen, neither isothermal nor adiabatic",
    "leakage.internal_resistance": "assumed: a new seal, 0.03 l/min at 100 bar",
}
"""Where values come from that are not given; the others are assumed."""

SPREADS = {
    "cylinder.dead_volume": "published cylinders: 3 to 30 %, with hoses more; drawings omit bores and pockets",
    "valve.rated_flow": "tolerance of valves in series",
    "valve.natural_frequency": "depends on pressure and amplitude; proportional to fast servo valve",
    "valve.damping_ratio": "published valves",
    "valve.slew_limit": "step times of data sheets",
    "valve.overlap": "tolerance of the edges",
    "valve.underlap": "critical lap to worn edges; a pilot stage takes part of the null flow",
    "valve.null_shift": "temperature and supply",
    "lines.wall_bulk_modulus": "textile to wire braid",
    "fluid.bulk_modulus": "oils in service",
    "fluid.air_fraction": "well to badly bled",
    "fluid.kinematic_viscosity": "temperature and grade of the oil",
    "load.mass": "weighed or from a drawing; piston and rod included",
    "load.spring_stiffness": "tolerance of springs",
    "load.tip_frequency": "position of the boom, load",
    "load.tip_share": "position of the boom, load",
    "load.tip_damping_ratio": "welded to bolted structures",
    "load.viscous_damping": "published cylinders: 1 to 20 bar",
    "friction.coulomb_force": "low-friction to standard seals: 0.5 to 5 bar",
    "friction.breakaway_force": "of the Coulomb force",
    "friction.stribeck_velocity": "published seals",
    "supply.pressure": "setting and gauge",
    "supply.tank_pressure": "return filter",
    "supply.pump_flow": "volumetric efficiency",
    "supply.relief_slope": "droop under flow",
    "supply.line_volume": "length of the line",
}
"""Where the ranges of uncertain values come from."""


SHOWN_IN = {
    "cylinder.dead_volume": "cm³",
    "lines.volume_a": "cm³",
    "lines.volume_b": "cm³",
    "lines.wall_bulk_modulus": "GPa",
    "fluid.bulk_modulus": "GPa",
    "fluid.air_fraction": "%",
    "valve.underlap": "%",
    "valve.overlap": "%",
    "valve.null_shift": "%",
}
"""Units of the file that are not the first ones of :data:`~hydro_env.units.UNITS`."""


def unit_in_file(path: str) -> str:
    """The unit in which the file shows a parameter; one that begins with a digit would count as a number."""
    own = PARAMETER_UNITS[path]
    usual = next(iter(UNITS[own])) if own in UNITS and own != "1" else own
    return SHOWN_IN.get(path, "" if usual.startswith("1") else usual)


def new_rig(figures: ByName, source: str) -> tuple[str, Rig]:
    """The text of a rig's file, and the rig that it describes.

    Args:
        figures: of :func:`answers_from`.
        source: name of the file, for messages.

    Raises:
        ConfigurationError: the figures contradict each other, or the rig cannot work.
    """
    values = rig_values(figures)
    rig = rig_from(values, source)
    texts = written_answers(figures)
    origins = _origins(texts, curve_fit(figures))
    given = {path: texts[key] for key, path in FIELDS.items() if key in texts}
    text = HEADER.format(source=source)
    ranges, sensors = values.pop("randomisation"), values.pop("sensors")
    for group, fields in values.items():
        text += f"{group}:\n"
        for field, value in fields.items():
            path = f"{group}.{field}"
            origin = "given" if path in given else origins.get(path, "assumed")
            text += f"  {field}: {given.get(path) or _shown(value, unit_in_file(path))}  # {origin}\n"
    text += "randomisation:  # uncertain values: each episode draws them; hydro identify narrows them\n"
    for path, draw in ranges.items():
        parts = []
        for name, value in draw.items():
            absolute = name.endswith("uniform") and "times" not in draw
            parts.append(f"{name}: {_shown(value, unit_in_file(path) if absolute else '')}")
        text += f"  {path}: {{{', '.join(parts)}}}  # {SPREADS[path]}\n"
    if sensors:
        text += "sensors:  # as given; check-rig shows the rest\n"
        for name, fields in sensors.items():
            if not isinstance(fields, dict):
                text += f"  {name}: {fields}\n"
                continue
            unit = next(iter(UNITS[CHANNEL_UNITS[name]]))
            parts = [f"{field}: {_shown(value, unit)}" for field, value in fields.items()]
            text += f"  {name}: {{{', '.join(parts)}}}\n"
    how = "given" if "position_accuracy" in texts else "assumed"
    error = position_error(figures)
    share = f"{100 * error / figures['stroke']:.3g} % of the stroke"
    text += f"# largest constant error of the position sensor (bias), {how}: {1e3 * error:.3g} mm, {share}\n"
    return text, rig


def _origins(texts: Mapping[str, str], fit: tuple[float, ...] | None) -> dict[str, str]:
    origins = dict(ORIGINS)
    if "step_time" in texts:
        origins["valve.slew_limit"] = f"computed: full stroke in {texts['step_time']}"
    if "null_flow" in texts:
        origins["valve.underlap"] = f"computed from a null flow of {texts['null_flow']}"
    if "full_voltage" in texts:
        origins["valve.amplifier_gain"] = f"computed: full opening at {texts['full_voltage']}"
    if "full_current" in texts:
        sent = f"{texts['full_current']}, which the amplifier sends at a command of 10 V"
        origins["valve.amplifier_gain"] = f"computed: full opening at {sent}"
    if fit:
        fitted = f"fitted to the flow curve; differs by up to {100.0 * fit[-1]:.2g} % of full flow"
        origins |= dict.fromkeys(("valve.overlap", "valve.knee_position", "valve.knee_opening"), fitted)
    if texts.get("edges") == "sharp":
        origins["valve.underlap"] = "given: sharp edges"
        if "null_flow" in texts and (fit or "overlap" in texts):
            origins["valve.underlap"] += ", which pass no null flow with this lap"
        elif not fit:
            source = "computed from the null flow" if "null_flow" in texts else "assumed"
            origins["valve.overlap"] = f"{source}: all four edges are open at the null"
    if texts.get("line_waves") == "yes":
        origins |= {"lines.length_a": "given", "lines.length_b": "given"}
    if "line_length" in texts:
        origins["lines.volume_a"] = f"computed: {texts['line_length']} of {texts['line_diameter']}"
    if "pump_flow" not in texts:
        origins["supply.model"] = "assumed: pump not given"
    return origins | {"lines.volume_b": origins["lines.volume_a"]}
