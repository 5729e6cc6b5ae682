"""Physical parameters: derived values, YAML and vector round trips, and the one line that answers a wrong value."""

import math

import numpy as np
import pytest
from refusal import refused

from hydro_env import PlantParameters, flow_from_resistance, resistance_from_flow
from hydro_env.errors import ConfigurationError
from hydro_env.plant.arrays import plant_coefficients
from hydro_env.plant.parameters import MODEL_CODES, PARAMETER_PATHS, from_vector, to_vector
from hydro_env.task.configuration import task_config

CHANGED = PlantParameters().replace(
    cylinder={"bore_diameter": 0.063, "rod_diameter": 0.036},
    load={"mass": 123.4, "spring_stiffness": 0.0, "external_force": -250.0},
    friction={"model": "coulomb"},
    supply={"model": "constant", "pressure": 1.1e7},
    leakage={"internal_resistance": math.inf, "external_resistance": 3e12, "orifice_gain": 2e-9},
)


def test_derived_values_of_the_model():
    c = plant_coefficients(PlantParameters())
    assert c.area_a == pytest.approx(1.2566e-3, rel=1e-4)
    assert c.area_b == pytest.approx(6.409e-4, rel=1e-4)
    assert c.edge_gain == pytest.approx(8.909e-8, rel=1e-4)
    assert c.volume_a0 == pytest.approx(30e-6 + 1.2566e-3 * 0.2, rel=1e-4)
    assert c.volume_b0 == pytest.approx(30e-6 + 6.409e-4 * 0.2, rel=1e-4)
    assert 1.0 / c.inverse_mass == pytest.approx(63.0)


def test_defaults_are_those_of_the_paper():
    p = PlantParameters()
    assert (p.cylinder.bore_diameter, p.cylinder.rod_diameter, p.cylinder.stroke) == (0.040, 0.028, 0.400)
    assert (p.load.mass, p.load.spring_stiffness) == (60.0, 89e3)
    assert (p.valve.rated_flow, p.valve.rated_pressure_drop) == (pytest.approx(1.6667e-4, rel=1e-4), 70e5)
    assert (p.fluid.density, p.fluid.bulk_modulus) == (872.0, 1.4e9)
    assert p.supply.accumulator_volume == 1e-3


@pytest.mark.parametrize(
    ("flow_lpm", "resistance"), [(0.03, 2e13), (0.1, 6e12), (0.3, 2e12), (1.0, 6e11), (4.0, 1.5e11), (0.0, math.inf)]
)
def test_leakage_in_the_words_of_practice(flow_lpm, resistance):
    assert resistance_from_flow(flow_lpm) == pytest.approx(resistance)
    assert flow_from_resistance(resistance_from_flow(flow_lpm)) == pytest.approx(flow_lpm)


@pytest.mark.parametrize("parameters", [PlantParameters(), CHANGED], ids=["default", "changed"])
def test_yaml_gives_back_an_equal_object(parameters, tmp_path):
    path = tmp_path / "deeper" / "rig.yaml"
    parameters.to_yaml(path)
    assert PlantParameters.from_yaml(path) == parameters
    assert [file.name for file in path.parent.iterdir()] == ["rig.yaml"]  # no temporary file is left


def test_yaml_may_name_only_what_differs(tmp_path):
    path = tmp_path / "rig.yaml"
    path.write_text("load:\n  mass: 75\nsupply:\n  pressure: 8e6\n")  # YAML 1.1 reads 8e6 as text
    assert PlantParameters.from_yaml(path) == PlantParameters().replace(load={"mass": 75.0}, supply={"pressure": 8e6})
    path.write_text("")
    assert PlantParameters.from_yaml(path) == PlantParameters()


@pytest.mark.parametrize("parameters", [PlantParameters(), CHANGED], ids=["default", "changed"])
def test_vector_gives_back_an_equal_object(parameters):
    vector = to_vector(parameters)
    assert vector.shape == (len(PARAMETER_PATHS),)
    assert from_vector(vector) == parameters
    assert vector[PARAMETER_PATHS.index("load.mass")] == parameters.load.mass
    code = int(vector[PARAMETER_PATHS.index("friction.model")])
    assert MODEL_CODES["friction.model"][code] == parameters.friction.model


def test_parameters_are_frozen():
    parameters = PlantParameters()
    with pytest.raises(ConfigurationError, match="is frozen"):
        parameters.load.mass = 80.0
    with pytest.raises(ConfigurationError, match="is frozen"):
        parameters.load = CHANGED.load
    changed = parameters.replace(load={"mass": 80.0})
    assert (parameters.load.mass, changed.load.mass) == (60.0, 80.0)


WRONG = {
    "unknown key": ("load: {weight: 60}", "load.weight = 60: unknown key; known here: mass, spring_stiffness"),
    "unknown group": (
        "loads: {mass: 60}",
        "loads: unknown key; did you mean load. known here: cylinder, valve, lines, fluid, load",
    ),
    "bar instead of Pa": (
        "supply: {pressure: 70}",
        "supply.pressure = 70: must be a number within 100000 to 1e.08 .unit: Pa",
    ),
    "mm instead of m": (
        "cylinder: {stroke: 400}",
        "cylinder.stroke = 400: must be a number within 0.01 to 10 .unit: m",
    ),
    "l/min": ("valve: {rated_flow: 10}", "valve.rated_flow = 10: must be a number within 1e-07 to 0.1 .unit: m³/s"),
    "sign": ("load: {mass: -60.0}", "load.mass = -60.0: must be a number within 0.01 to 1e.06 .unit: kg"),
    "NaN": ("load: {mass: .nan}", "load.mass = nan: .*unit: kg"),
    "NaN as text": ("load: {mass: nan}", "load.mass = 'nan': .*unit: kg"),
    "infinite": ("load: {mass: .inf}", r"load.mass = inf: must be a number within 0.01 to 1e.06 .unit: kg"),
    "bool": ("load: {mass: true}", "load.mass = true: must be a number, not true/false .*unit: kg"),
    "text": ("load: {mass: heavy}", "load.mass = 'heavy': .* number.*unit: kg"),
    "wrong unit": ("load: {mass: 60 bar}", "load.mass = '60 bar': unit 'bar': must be one of kg, t, g .*unit: kg"),
    "list": ("load: {mass: [60]}", r"load.mass = \[60\]: .* number.*unit: kg"),
    "nothing": ("load: {mass: }", "load.mass: .* number.*unit: kg"),
    "choice": ("friction: {model: sticky}", "friction.model = 'sticky': .*none, coulomb, stribeck, lugre"),
    "group is a number": ("load: 60", "load = 60: .*"),
    "rod does not fit": (
        "cylinder: {rod_diameter: 0.05}",
        "rod_diameter = 50 mm does not fit: .* bore_diameter = 40 mm",
    ),
    "tank above supply": (
        "supply: {tank_pressure: 80e5}",
        "pressure = 70 bar must be above tank_pressure = 80 bar",
    ),
    "precharge": ("supply: {precharge_pressure: 75e5}", "precharge_pressure = 75 bar must be below pressure"),
    "breakaway": (
        "friction: {breakaway_force: 100}",
        "breakaway_force = 100 N must not be below coulomb_force = 120 N",
    ),
    "a list": ("- load", "must be a mapping of settings, not a list"),
    "not YAML": ("load: {mass: 60", "not valid YAML in line 1: .*"),
    "line break in a key": ('"lo\\nad": 1', "lo ad = 1: unknown key.*"),
    "number as a key": ("7: 1", "7.*"),
}


@pytest.mark.parametrize(("text", "message"), WRONG.values(), ids=WRONG)
def test_a_wrong_value_is_answered_with_one_line(text, message, tmp_path):
    path = tmp_path / "wrong.yaml"
    path.write_text(text)
    with refused(f"^{path}: .*{message}"):
        PlantParameters.from_yaml(path)


@pytest.mark.parametrize(
    ("values", "bounds"),
    [
        ({"load": {"mass": -60.0}}, " within 0.01 to 1e+06"),
        ({"load": {"mass": 1e9}}, " within 0.01 to 1e+06"),
        ({"leakage": {"internal_resistance": 1.0}}, ", at least 1e+08 (unit"),  # the other is infinity
    ],
)
def test_both_bounds_are_told(values, bounds):
    with pytest.raises(ConfigurationError) as caught:
        PlantParameters.from_dict(values)
    assert f"must be a number{bounds}" in str(caught.value)


def test_both_bounds_are_told_where_a_field_holds_many():
    with pytest.raises(ConfigurationError) as caught:
        task_config(None, references={"weights": {"step": -1.0}})
    assert "must be a number within 0 to 1e+06" in str(caught.value)


def test_unreadable_files_are_answered_with_one_line(tmp_path):
    binary = tmp_path / "binary.yaml"
    binary.write_bytes(bytes(range(128, 256)))
    for path, reason in ((tmp_path / "absent.yaml", "No such file"), (tmp_path, "directory"), (binary, "not a text")):
        with pytest.raises(ConfigurationError, match=f"^{path}: cannot be read: .*{reason}"):
            PlantParameters.from_yaml(path)


def test_replace_and_vectors_are_validated():
    with pytest.raises(ConfigurationError, match=r"unknown group 'loads'; did you mean load\? known: cylinder"):
        PlantParameters().replace(loads={"mass": 1.0})
    with pytest.raises(ConfigurationError, match=r"load\.mass = -1"):
        PlantParameters().replace(load={"mass": -1.0})
    vector = to_vector(PlantParameters())
    vector[PARAMETER_PATHS.index("load.mass")] = np.nan
    with pytest.raises(ConfigurationError, match=r"load\.mass = nan"):
        from_vector(vector)


def test_every_bound_itself_is_allowed_and_a_step_beyond_is_not():
    """Each limit that the message names is the limit that holds."""
    checked = 0
    for group, info in PlantParameters.model_fields.items():
        for field, details in info.annotation.model_fields.items():
            for bound in details.metadata:
                for sign, name in ((-1.0, "ge"), (1.0, "le")):
                    limit = getattr(bound, name, None)
                    if limit is None or not math.isfinite(limit):
                        continue
                    beyond = limit + sign * max(abs(limit), 1e-3) * 0.01
                    with pytest.raises(ConfigurationError, match=rf"{group}\.{field} = "):
                        PlantParameters.from_dict({group: {field: beyond}})
                    checked += 1
    assert checked > 60
