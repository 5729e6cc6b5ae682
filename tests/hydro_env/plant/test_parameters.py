"""Physical parameters: derived values, YAML and vector round trips, and the one line that answers a wrong value."""

import math

import pytest
from refusal import refused

from hydro_env import PlantParameters, flow_from_resistance, resistance_from_flow
from hydro_env.plant.arrays import plant_coefficients
from hydro_env.plant.parameters import MODEL_CODES, PARAMETER_PATHS, from_vector, to_vector

CHANGED = PlantParameters().replace(
    cylinder={"bore_diameter": 0.063, "rod_diameter": 0.036},
    load={"mass": 123.4, "spring_stiffness": 0.0, "external_force": -250.0},
    friction={"model": "coulomb"},
    supply={"model": "constant", "pressure": 1.1e7},
    leakage={"internal_resistance": math.inf, "external_resistance": 3e12, "orifice_gain": 2e-9},
)


def test_defaults_are_those_of_the_paper_and_so_are_the_values_derived_from_them():
    p, c = PlantParameters(), plant_coefficients(PlantParameters())
    assert (p.cylinder.bore_diameter, p.cylinder.rod_diameter, p.cylinder.stroke) == (0.040, 0.028, 0.400)
    assert (p.load.mass, p.load.spring_stiffness) == (60.0, 89e3)
    assert (p.valve.rated_flow, p.valve.rated_pressure_drop) == (pytest.approx(1.6667e-4, rel=1e-4), 70e5)
    assert (p.fluid.density, p.fluid.bulk_modulus) == (872.0, 1.4e9)
    assert p.supply.accumulator_volume == 1e-3
    assert (c.area_a, c.area_b, c.edge_gain) == pytest.approx((1.2566e-3, 6.409e-4, 8.909e-8), rel=1e-4)
    volumes = (30e-6 + 1.2566e-3 * 0.2, 30e-6 + 6.409e-4 * 0.2)
    assert (c.volume_a0, c.volume_b0, 1.0 / c.inverse_mass) == pytest.approx((*volumes, 63.0), rel=1e-4)
    for flow, resistance in ((0.03, 2e13), (0.1, 6e12), (1.0, 6e11), (4.0, 1.5e11), (0.0, math.inf)):
        assert resistance_from_flow(flow) == pytest.approx(resistance)
        assert flow_from_resistance(resistance_from_flow(flow)) == pytest.approx(flow)


@pytest.mark.parametrize("parameters", [PlantParameters(), CHANGED], ids=["default", "changed"])
def test_yaml_and_vector_give_back_an_equal_object(parameters, tmp_path):
    path = tmp_path / "deeper" / "rig.yaml"
    parameters.to_yaml(path)
    assert PlantParameters.from_yaml(path) == parameters
    assert [file.name for file in path.parent.iterdir()] == ["rig.yaml"]  # no temporary file is left
    path.write_text("load:\n  mass: 75\nsupply:\n  pressure: 8e6\n")  # YAML 1.1 reads 8e6 as text
    assert PlantParameters.from_yaml(path) == PlantParameters().replace(load={"mass": 75.0}, supply={"pressure": 8e6})
    vector = to_vector(parameters)
    assert vector.shape == (len(PARAMETER_PATHS),)
    assert from_vector(vector) == parameters
    assert vector[PARAMETER_PATHS.index("load.mass")] == parameters.load.mass
    code = int(vector[PARAMETER_PATHS.index("friction.model")])
    assert MODEL_CODES["friction.model"][code] == parameters.friction.model


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
                    with refused(rf"{group}\.{field} = "):
                        PlantParameters.from_dict({group: {field: beyond}})
                    checked += 1
    assert checked > 60
