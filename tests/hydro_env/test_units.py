"""Quantities written with their unit: known answers, and where a file may hold them."""

import math

import pytest
from refusal import refused

from hydro_env import TaskConfig
from hydro_env.plant.parameters import PARAMETER_UNITS, PlantParameters
from hydro_env.task.configuration import task_config
from hydro_env.units import UNITS, flow_from_resistance, in_si, resistance_from_flow
from hydro_rig.recordings.columns import factor

KNOWN = {
    ("63 mm", "m"): 0.063,
    ("36mm", "m"): 0.036,
    ("1.5e1 cm", "m"): 0.15,
    ("160 bar", "Pa"): 160e5,
    ("250 kPa", "Pa"): 250e3,
    ("6 m/min", "m/s"): 0.1,
    ("3 dm³", "m³"): 3e-3,
    ("4 min", "s"): 240.0,
    ("20 mV", "V"): 0.02,
    ("89 N/mm", "N/m"): 89e3,
    ("-2.5 kN", "N"): -2500.0,
    ("1000 psi", "Pa"): 6894757.293168,
    ("1.4 GPa", "Pa"): 1.4e9,
    ("16 MPa", "Pa"): 16e6,
    ("30 mbar", "Pa"): 3000.0,
    ("2 in", "m"): 0.0508,
    ("2 l/s", "m³/s"): 2e-3,
    ("6 cm³/min", "m³/s"): 1e-7,
    ("250 g", "kg"): 0.25,
    ("2 kN/mm", "N/m"): 2e6,
    ("12 ms", "s"): 0.012,
    ("300 ns", "s"): 3e-7,
    ("40 mA", "A"): 0.04,
    ("40 l/min", "m³/s"): 40e-3 / 60,
    ("2.4 l/min/bar", "m³/(s Pa)"): 4e-10,
    ("100 cm3", "m³"): 1e-4,
    ("60 Hz", "rad/s"): 120 * math.pi,
    ("2 t", "kg"): 2000.0,
    ("-1 %", "1"): -0.01,
    ("5 μm", "m"): 5e-6,
    ("300 N s/m", "N s/m"): 300.0,
}


@pytest.mark.parametrize(("given", "number"), KNOWN.items(), ids=[text for text, _ in KNOWN])
def test_quantities_have_known_values(given, number):
    assert in_si(*given) == pytest.approx(number, rel=1e-14)


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


def test_recordings_and_tasks_know_the_same_units():
    assert factor("position", "mm", "x") == 1e-3
    assert factor("pressure_a", "psi", "x") == pytest.approx(6894.757293168)
    with refused("x: unit 'furlong': must be one of mm, m, "):
        factor("position", "furlong", "x")
    config = TaskConfig(control_period="4 ms", references={"step_range": ["1 mm", "2 cm"]})
    assert (config.control_period, config.references.step_range) == (0.004, (0.001, 0.02))


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
