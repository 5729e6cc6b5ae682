"""Numbers of the rig file that identification writes: every unit is read back."""

import math

import yaml

from hydro_agents.rigs.found_rig import _line, _with_unit
from hydro_env import PlantParameters
from hydro_env.plant.parameters import PARAMETER_PATHS
from hydro_env.task.rig import rig_from


def test_every_number_of_a_rig_is_read_back_from_its_text_with_unit():
    plant = PlantParameters()
    values = {path: getattr(getattr(plant, path.split(".")[0]), path.split(".")[1]) for path in PARAMETER_PATHS}
    values = {path: float(value) for path, value in values.items() if isinstance(value, int | float)}
    assert len(values) > 40
    groups: dict[str, list[str]] = {}
    for path, value in values.items():
        group, field = path.split(".")
        groups.setdefault(group, []).append(f"  {_line(field, _with_unit(path, value, plant))}\n")
    text = "".join(f"{group}:\n{''.join(lines)}" for group, lines in groups.items())
    for unit in ("bar", "l/min", "Hz", "GPa", "cm³"):
        assert f" {unit}\n" in text
    read = rig_from(yaml.safe_load(text), "rig.yaml").plant
    for path, value in values.items():
        group, field = path.split(".")
        assert math.isclose(getattr(getattr(read, group), field), value, rel_tol=1e-5), path
