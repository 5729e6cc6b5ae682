"""A rig from the figures of its nameplates: given values, computed values, and typical values with ranges for the rest.

``hydro new-rig`` writes the same values as a file, each with its origin (:mod:`hydro_agents.rigs.rig_file`).
"""

import math
from collections.abc import Mapping
from functools import cache

import numpy as np

from hydro_env.errors import ConfigurationError
from hydro_env.types import ByName
from hydro_env.units import FULL_VOLTAGE, LITRE_PER_MINUTE, in_si, rounded

BAR = 1e5
STEEL = 7850.0  # kg/m³
STRUCTURE_SHARE, STRUCTURE_DAMPING = 0.5, 0.02  # share of the mass behind a structure that bends; welded steel
ASSUMED_ACCURACY = 2e-4  # of the stroke: largest constant error of the position sensor that follows from a rig
COIL_RESISTANCE = 2.5  # Ω; only its ratio to the amplifier's gain counts
BANDWIDTH = 502.654824574367  # rad/s; 80 Hz
LARGEST_LAP = 0.4  # of full stroke, that a flow curve gives: its range ends below half a stroke
WORST_FIT = 0.1  # of full flow: largest difference to a point of a flow curve

Figures = ByName  # numbers in SI, and texts, by the keys of the questions

FIELDS = {
    "bore": "cylinder.bore_diameter",
    "rod": "cylinder.rod_diameter",
    "rod_a": "cylinder.rod_diameter_a",
    "stroke": "cylinder.stroke",
    "dead_volume": "cylinder.dead_volume",
    "piston_mass": "cylinder.piston_mass",
    "rated_flow": "valve.rated_flow",
    "rated_drop": "valve.rated_pressure_drop",
    "bandwidth": "valve.natural_frequency",
    "overlap": "valve.overlap",
    "spool_ratio": "valve.edge_ratio",
    "supply_pressure": "supply.pressure",
    "tank_pressure": "supply.tank_pressure",
    "pump_flow": "supply.pump_flow",
    "accumulator": "supply.accumulator_volume",
    "precharge": "supply.precharge_pressure",
    "mass": "load.mass",
    "external_force": "load.external_force",
    "spring": "load.spring_stiffness",
    "structure_frequency": "load.tip_frequency",
    "structure_share": "load.tip_share",
    "structure_damping": "load.tip_damping_ratio",
}
"""Figures that are values of the rig themselves."""

NEEDS = {
    "accumulator": "pump_flow",
    "line_length": "line_diameter",
    "line_diameter": "line_length",
    "pressure_accuracy": "pressure_range",
    "line_waves": "line_length",
    "structure_share": "structure_frequency",
    "structure_damping": "structure_frequency",
}
"""Figures that need another one."""

RANGE_ENDS = {"valve.overlap": 0.49, "load.tip_share": 0.98, "load.tip_damping_ratio": 0.98}
"""Largest ends of the ranges of these fields, just below the limits of the fields."""

RANGES: dict[str, ByName] = {
    "cylinder.dead_volume": {"log_factor": (0.3, 3.0)},
    "valve.rated_flow": {"factor": (0.9, 1.1)},
    "valve.natural_frequency": {"log_factor": (0.4, 2.0)},
    "valve.damping_ratio": {"uniform": (0.5, 1.1)},
    "valve.slew_limit": {"log_factor": (0.5, 2.0)},
    "valve.overlap": {"factor": (0.8, 1.2)},
    "valve.underlap": {"uniform": (0.0, 0.03)},
    "valve.null_shift": {"uniform": (-0.01, 0.01)},
    "lines.wall_bulk_modulus": {"log_uniform": (0.1e9, 1e9)},
    "fluid.bulk_modulus": {"uniform": (0.8e9, 1.6e9)},
    "fluid.air_fraction": {"log_uniform": (0.001, 0.015)},
    "fluid.kinematic_viscosity": {"log_factor": (0.3, 3.0)},
    "load.mass": {},  # by the mass of the piston
    "load.tip_frequency": {"log_factor": (0.7, 1.4)},
    "load.tip_share": {"factor": (0.6, 1.4)},
    "load.tip_damping_ratio": {"log_factor": (0.5, 2.0)},
    "load.spring_stiffness": {"factor": (0.9, 1.1)},
    "load.viscous_damping": {"log_factor": (0.25, 5.0)},
    "friction.coulomb_force": {"log_factor": (0.25, 2.5)},
    "friction.breakaway_force": {"uniform": (1.1, 1.9), "times": "friction.coulomb_force"},
    "friction.stribeck_velocity": {"log_factor": (0.4, 2.5)},
    "supply.pressure": {"factor": (0.97, 1.03)},
    "supply.tank_pressure": {"uniform": (0.0, 4 * BAR)},
    "supply.pump_flow": {"factor": (0.92, 1.0)},
    "supply.relief_slope": {"log_factor": (0.3, 2.5)},
    "supply.line_volume": {"log_factor": (0.3, 3.0)},
}
"""Distributions of the uncertain values of a rig of which little is known, SI."""


def rig_values(figures: Figures) -> dict[str, ByName]:
    """The content of a rig's file, in SI, from the figures of its nameplates.

    Args:
        figures: numbers in SI by the keys of ``QUESTIONS`` in :mod:`hydro_agents.rigs.rig_file`; texts for
            ``flow_curve`` (:func:`lap_and_knee`), ``line_kind`` (pipe or hose), ``line_waves`` (yes or no), ``edges``
            (rounded or sharp), ``pressure_sensors`` (cylinder or valve) and ``absent`` (sensors that the rig lacks,
            with commas).

    Raises:
        ConfigurationError: a figure lacks another one.
    """
    for key, needed in NEEDS.items():
        if key in figures and needed not in figures:
            raise ConfigurationError(f"{key.replace('_', '-')}: needs {needed.replace('_', '-')}")
    area = 0.25 * math.pi * figures["bore"] ** 2
    stiffness, damping = area * figures["supply_pressure"] / 0.5e-3, rounded(4 * (BAR * area))
    values = {
        "cylinder": {
            "bore_diameter": figures["bore"],
            "rod_diameter": figures["rod"],
            "rod_diameter_a": 0.0,
            "stroke": figures["stroke"],
            "dead_volume": rounded(0.1 * area * figures["stroke"], "cm³"),
            "piston_mass": rounded(_piston_mass(figures), "kg"),
            "end_stop_stiffness": rounded(stiffness, "kN/mm"),
            "end_stop_damping": rounded(1e-3 * stiffness),
        },
        "valve": _valve(figures),
        "lines": _lines(figures),
        "fluid": {"density": 872.0, "bulk_modulus": 1.2e9, "air_fraction": 0.004},
        "load": {"mass": figures["mass"], "spring_stiffness": 0.0, "viscous_damping": damping, "external_force": 0.0},
        "friction": {
            "model": "stribeck",
            "coulomb_force": rounded(2 * (BAR * area), "N"),
            "breakaway_force": rounded(3 * (BAR * area), "N"),
            "stribeck_velocity": 0.012,
            "transition_velocity": 0.0015,
        },
        "supply": _supply(figures),
        "leakage": {"internal_resistance": 2e13},
    }
    if "structure_frequency" in figures:
        values["load"] |= {"tip_share": STRUCTURE_SHARE, "tip_damping_ratio": STRUCTURE_DAMPING}
    for key, path in FIELDS.items():
        if key in figures:
            group, field = path.split(".")
            values[group][field] = figures[key]
    values["randomisation"] = _ranges(figures, values)
    values["sensors"] = _sensors(figures)
    return values


def _piston_mass(figures: Figures) -> float:
    """Mass in kg of a steel rod of 1.2 strokes and a piston of half a bore."""
    bore, rod = 0.25 * math.pi * figures["bore"] ** 2, 0.25 * math.pi * figures["rod"] ** 2
    return STEEL * (1.2 * figures["stroke"] * rod + 0.5 * figures["bore"] * bore)


@cache
def lap_and_knee(curve: str, lap: float | None = None) -> tuple[float, float, float, float]:
    """Overlap, position and opening of the knee, and what they leave, that fit the flow curve of a catalogue best.

    Args:
        curve: points of signal and flow at the rated drop, each in % of full: ``20%:4%, 50%:30%, 100%:100%``.
        lap: overlap that is known, of full stroke.

    Returns:
        Overlap, of full stroke; position and opening of the knee (:func:`~hydro_env.plant.parts.valve.edge_openings`);
        and the largest difference to a point, of full flow.

    Raises:
        ValueError: these are no rising points that end at 100 % of both.
    """
    try:
        points = [[in_si(part.strip(), "1") for part in point.split(":")] for point in curve.split(",")]
    except ValueError:
        points = [[]]
    if any(len(point) != 2 or not all(isinstance(part, float) for part in point) for point in points):
        raise ValueError("must be points SIGNAL:FLOW in %")
    signal, flow = np.array(points).T
    rises = (np.diff(signal) > 0.0).all() and (np.diff(flow) >= 0.0).all() and min(signal[0], flow[0]) >= 0.0
    if len(points) < 3 or not rises:
        raise ValueError("must be three points or more that rise from 0 % on")
    if signal[-1] != 1.0 or flow[-1] != 1.0:
        raise ValueError("must end at 100%:100%")
    laps = np.linspace(0.0, LARGEST_LAP, 201) if lap is None else lap
    overlap, knee = np.meshgrid(laps, np.linspace(0.01, 0.99, 99), indexing="ij")
    beyond = np.maximum(signal - overlap[..., None], 0.0) / (1.0 - overlap[..., None])
    above = np.maximum(beyond - knee[..., None], 0.0) / (1.0 - knee[..., None])
    below = np.minimum(beyond / knee[..., None], 1.0) - above  # flow = above + opening at the knee · below
    weight = np.maximum((below**2).sum(-1), 1e-9)
    opening = np.clip(((flow - above) * below).sum(-1) / weight, 0.01, 0.99)
    rest = np.abs(flow - above - opening[..., None] * below)
    best = np.unravel_index(np.argmin((rest**2).sum(-1)), knee.shape)
    lap, position, part = (rounded(values[best]) for values in (overlap, knee, opening))
    return lap, position, part, rest[best].max()


def curve_fit(figures: Figures) -> tuple[float, float, float, float] | None:
    """:func:`lap_and_knee` of the flow curve among figures, with the lap that they give.

    Raises:
        ConfigurationError: no lap and knee come near the curve.
    """
    if "flow_curve" not in figures:
        return None
    curve, lap = figures["flow_curve"], figures.get("overlap")
    fit = lap_and_knee(curve, lap)
    if fit[-1] > WORST_FIT:
        band = "a dead band" if lap is None else f"a dead band of {100 * lap:.3g} %"
        raise ConfigurationError(
            f"flow-curve '{curve.strip()[:40]}': the model holds two straight lines beyond {band}; the nearest differ "
            f"by {100 * fit[-1]:.2g} % of full flow, allowed are {100 * WORST_FIT:g} %"
        )
    return fit


def _valve(figures: Figures) -> ByName:
    curve, overlap = {}, figures.get("overlap", 0.0)
    fit = curve_fit(figures)
    if fit:
        overlap, curve["knee_position"], curve["knee_opening"], _ = fit
    underlap = 0.002 if overlap else 0.01
    if "null_flow" in figures:
        drop = math.sqrt(figures.get("rated_drop", 70.0 * BAR) / figures["supply_pressure"])
        share = figures["null_flow"] / figures["rated_flow"] * drop
        if overlap:  # rounder edges let this flow pass over their overlap
            share = math.sqrt(share * (share + 2.0 * overlap / (1.0 - overlap)))
        underlap = rounded(share, "%")
    if figures.get("edges") == "sharp":
        if not overlap and not fit:  # all four are open by the lap at the null
            overlap = rounded(-0.5 * underlap / (1.0 - 0.5 * underlap), "%")
        underlap = 0.0
    slew_limit = rounded(0.2 * figures.get("bandwidth", BANDWIDTH))
    if "step_time" in figures:
        slew_limit = rounded(1 / figures["step_time"], digits=4)
    amplifier, spool = 0.625 * FULL_VOLTAGE / figures.get("full_voltage", FULL_VOLTAGE), 0.4
    if "full_current" in figures:  # which the amplifier sends at 10 V
        amplifier = COIL_RESISTANCE * figures["full_current"] / FULL_VOLTAGE
        spool = 1.0 / figures["full_current"]
    return {
        "model": "spool",
        "rated_flow": figures["rated_flow"],
        "rated_pressure_drop": 70.0 * BAR,
        "natural_frequency": BANDWIDTH,
        "damping_ratio": 0.8,
        "slew_limit": slew_limit,
        "underlap": underlap,
        "overlap": overlap,
        **curve,
        "null_shift": 0.0,
        "edge_ratio": 1.0,
        "coil_resistance": COIL_RESISTANCE,
        "amplifier_gain": rounded(amplifier, digits=6),
        "spool_gain": rounded(spool, digits=6),
    }


def _lines(figures: Figures) -> dict[str, float]:
    volume = 0.0
    if "line_length" in figures:
        volume = rounded(0.25 * math.pi * figures["line_diameter"] ** 2 * figures["line_length"], "cm³")
    lines = {"volume_a": volume, "volume_b": volume}
    if _has_hose(figures):
        lines["wall_bulk_modulus"] = 0.3e9
    if figures.get("line_waves") == "yes":
        lines |= {"length_a": figures["line_length"], "length_b": figures["line_length"]}
    return lines


def _has_hose(figures: Figures) -> bool:
    return "line_length" in figures and figures.get("line_kind") == "hose"


def _supply(figures: Figures) -> ByName:
    supply = {"model": "constant", "pressure": figures["supply_pressure"], "tank_pressure": BAR}
    if "pump_flow" not in figures:
        return supply
    flow = figures["pump_flow"]
    supply |= {"model": "pump", "pump_flow": flow, "relief_slope": rounded(flow / (5.0 * BAR), "l/min/bar")}
    if "accumulator" not in figures:
        return supply | {"line_volume": rounded(1e-3 * max(0.02 * flow / LITRE_PER_MINUTE, 0.1), "l", 2)}
    precharge = rounded(0.8 * figures["supply_pressure"], "bar")
    gas = {"accumulator_volume": figures["accumulator"], "precharge_pressure": precharge, "polytropic_index": 1.3}
    return supply | {"model": "accumulator"} | gas


def _ranges(figures: Figures, values: Mapping[str, ByName]) -> ByName:
    """The distributions of the uncertain values; what is given has a narrower one, or none."""
    ranges = dict(RANGES)
    if "dead_volume" in figures:
        ranges["cylinder.dead_volume"] = {"factor": (0.8, 1.2)}
    if "bandwidth" in figures:
        ranges["valve.natural_frequency"] = {"factor": (0.8, 1.25)}
    if "null_flow" in figures:
        ranges["valve.underlap"] = {"factor": (0.3, 1.2)}
    # Only the sum of load and piston matters: one range covers the uncertainty of both.
    unsure = 0.05
    if "piston_mass" not in figures:
        unsure += 0.3 * _piston_mass(figures) / figures["mass"]
    ranges["load.mass"] = {"factor": (rounded(max(1 - unsure, 0.5)), rounded(1 + unsure))}
    for path, most in RANGE_ENDS.items():
        group, field = path.split(".")
        [(form, (low, high))] = ranges[path].items()
        own = max(values[group].get(field, 0.0), 0.1)  # below that no factor reaches the end
        ranges[path] = {form: (low, rounded(min(high, most / own)))}
    overlapped, model = values["valve"]["overlap"] != 0.0, values["supply"]["model"]
    known = {
        "valve.slew_limit": "step_time" in figures,
        "valve.overlap": not overlapped,
        "valve.underlap": values["valve"]["underlap"] == 0.0 or (overlapped and "null_flow" not in figures),
        "load.tip_frequency": "structure_frequency" not in figures,
        "load.tip_share": "structure_frequency" not in figures,
        "load.tip_damping_ratio": "structure_frequency" not in figures,
        "lines.wall_bulk_modulus": not _has_hose(figures),
        "fluid.kinematic_viscosity": figures.get("line_waves") != "yes",
        "load.spring_stiffness": "spring" not in figures,
        "supply.tank_pressure": "tank_pressure" in figures,
        "supply.pump_flow": model == "constant",
        "supply.relief_slope": model == "constant",
        "supply.line_volume": model != "pump",
    }
    return {path: draw for path, draw in ranges.items() if not known.get(path)}


def position_error(figures: Figures) -> float:
    """Largest constant error of the position sensor, m."""
    return figures.get("position_accuracy", ASSUMED_ACCURACY) * figures["stroke"]


def _sensors(figures: Figures) -> ByName:
    """Fields of the sensors that were given; what is not given follows from the rig."""
    sensors = {}
    if "pressure_sensors" in figures:
        sensors["pressures_at"] = figures["pressure_sensors"]
    for kind, names in {"position": ("position",), "pressure": ("pressure_a", "pressure_b")}.items():
        keys = {"noise": f"{kind}_noise", "resolution": f"{kind}_resolution", "high": f"{kind}_range"}
        fields = {field: figures[key] for field, key in keys.items() if key in figures}
        if kind == "position" and "position_accuracy" in figures:
            fields["bias"] = rounded(position_error(figures), "mm")
        if kind == "pressure" and "pressure_accuracy" in figures:
            fields["bias"] = rounded(figures["pressure_accuracy"] * figures["pressure_range"], "bar")
        if fields:
            sensors |= {name: dict(fields) for name in names}
    return sensors | {name: {"fitted": False} for name in figures.get("absent", "").split(",") if name}
