"""Quantities written with their unit: known answers, and where a file may hold them."""

import math

import pytest
from refusal import refused

from hydro_env.plant.parameters import PARAMETER_UNITS, PlantParameters
from hydro_env.task.configuration import task_config
from hydro_env.units import UNITS, flow_from_resistance, in_si, resistance_from_flow

KNOWN = """
63 mm = 0.063 m; 36mm = 0.036 m; 1.5e1 cm = 0.15 m; 160 bar = 160e5 Pa; 250 kPa = 250e3 Pa
6 m/min = 0.1 m/s; 3 dm³ = 3e-3 m³; 4 min = 240.0 s; 20 mV = 0.02 V; 89 N/mm = 89e3 N/m; -2.5 kN = -2500.0 N
1000 psi = 6894757.293168 Pa; 1.4 GPa = 1.4e9 Pa; 16 MPa = 16e6 Pa; 30 mbar = 3000.0 Pa; 2 in = 0.0508 m
2 l/s = 2e-3 m³/s; 6 cm³/min = 1e-7 m³/s; 250 g = 0.25 kg; 2 kN/mm = 2e6 N/m; 12 ms = 0.012 s
300 ns = 3e-7 s; 40 mA = 0.04 A; 40 l/min = 6.666666666666667e-4 m³/s; 2.4 l/min/bar = 4e-10 m³/(s Pa)
100 cm3 = 1e-4 m³; 60 Hz = 376.99111843077515 rad/s; 2 t = 2000.0 kg; -1 % = -0.01 1; 5 μm = 5e-6 m
300 N s/m = 300.0 N s/m
"""


def test_quantities_have_known_values():
    for line in KNOWN.strip().replace("\n", "; ").split("; "):
        given, known = line.split(" = ")
        number, unit = known.split(" ", 1)
        assert in_si(given, unit) == pytest.approx(float(number), rel=1e-12), given


def test_what_is_no_quantity_stays_as_it_is():
    for value in (63, 0.063, "63", "1e5", "1,5 mm", "pipe", "mm", None, True, {"a": 1}, "-.inf"):
        assert in_si(value, "m") is value
    assert in_si(["1 mm", 2.0, "3"], "m") == [0.001, 2.0, "3"]


def test_leaks_that_are_no_flow_are_refused():
    assert resistance_from_flow(1e-320) == resistance_from_flow(0) == math.inf
    assert flow_from_resistance(math.inf) == 0.0
    for wrong in (-1.0, math.nan):
        with refused("must be a number in l/min, at least 0"):
            resistance_from_flow(wrong)
    for wrong in (-1.0, math.nan, 0.0):
        with refused("must be a number in Pa s/m³, above 0"):
            flow_from_resistance(wrong)


def test_the_unit_of_another_quantity_is_refused():
    assert all(known[unit] == 1.0 for unit, known in UNITS.items())  # each table holds the SI unit itself
    with pytest.raises(ValueError, match="unit 'bar': must be one of mm, m, cm, in, um, µm"):
        in_si("63 bar", "m")
    with pytest.raises(ValueError, match="unit 'kg': must be one of N s/m"):
        in_si("63 kg", "N s/m")


def test_a_rig_with_units_is_the_rig_in_si(tmp_path):
    file = tmp_path / "rig.yaml"
    file.write_text(
        "cylinder: {bore_diameter: 40 mm, rod_diameter: 28mm, stroke: 40 cm, dead_volume: 30 cm³}\n"
        "valve: {rated_flow: 10 l/min, rated_pressure_drop: 70 bar, underlap: 1.5 %}\n"
        "load: {mass: 60 kg, spring_stiffness: 89 N/mm}\n"
        "randomisation: {load.mass: {uniform: [50 kg, 0.07 t]}, supply.pressure: {factor: [95 %, 1.05]}}\n"
        "sensors: {pressure_a: {high: 160 bar}}\n"
    )
    config = task_config(rig=file)
    usual = PlantParameters()
    for path in PARAMETER_UNITS:
        group, field = path.split(".")
        read, known = (getattr(getattr(plant, group), field) for plant in (config.plant, usual))
        assert read == known or read == pytest.approx(known, rel=1e-14), path
    assert config.randomisation["load.mass"].uniform == (50.0, 70.0)
    assert config.randomisation["supply.pressure"].factor == (0.95, 1.05)
    assert config.sensors.pressure_a.high == 160e5
