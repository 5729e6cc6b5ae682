"""Mistakes in files, as clumsy hands make them: each is told, with what is allowed and what was meant."""

import re

import pytest
from command_line import hydro, own_lines
from refusal import refused

from hydro_env.errors import UnknownKeyError
from hydro_env.task.configuration import task_config
from hydro_env.task.rig import read_rig

RIGS = [
    # Units and numbers.
    ("cylinder: {bore_diameter: 63 mn}", "'63 mn': unit 'mn': must be one of mm, m, cm, in, um, µm (unit"),
    ("supply: {pressure: 160 bars}", "must be one of bar, MPa, psi, kPa, Pa, mbar, GPa; did you mean bar?"),
    ("randomisation: {load.mass: {uniform: [1 kg, 3 mm]}}", "load.mass: unit 'mm': must be one of kg, t, g"),
    ("load: {mass: heavy}", "load.mass = 'heavy': must be a number within 0.01 to 1000000 (unit: kg)"),
    ("leakage: {internal_resistance: 1}", "must be a number, at least 100000000 (unit"),  # the other bound is infinity
    ("load: {mass: .nan}", "load.mass = nan: "),
    # Names of groups, fields and choices.
    ("loads: {mass: 60}", "loads: unknown key; did you mean load?"),
    ("supply: {model: accumulater}", "must be one of constant, accumulator, pump; did you mean accumulator?"),
    # What does not fit together.
    ("cylinder: {rod_diameter: 0.05}", "rod_diameter = 50 mm does not fit: "),
    ("supply: {tank_pressure: 80e5}", "pressure = 70 bar must be above tank_pressure = 80 bar"),
    ("supply: {relief_slope: 0}", "nothing limits the pressure"),
    ("friction: {breakaway_force: 100}", "breakaway_force = 100 N must not be below coulomb_force = 120 N"),
    ("load: {external_force: 1e6}", "load.external_force = 1e+06 N: "),
    # YAML.
    ("load:\n\tmass: 3", "not valid YAML in line 2: "),
]


@pytest.mark.parametrize(("text", "message"), RIGS)
def test_one_mistake_in_a_rig_is_told_in_one_line(text, message, tmp_path):
    file = tmp_path / "rig.yaml"
    file.write_text(text)
    with refused(f"^{re.escape(str(file))}: .*{re.escape(message)}"):
        task_config(rig=file)


SEVERAL = """\
cylinder:
  bore: 63 mm
  rod_diameter: 0,036
valve: {rated_flow: 10 l/mni, model: spol}
load: {mass: -3}
friction:
randomisation: {load.mas: {factor: [1, 2]}}
sensors: {pressure_a: {hihg: 160 bar}}
mass: 60
"""


def test_all_mistakes_of_a_file_are_told_and_the_command_ends_with_code_2(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "rig.yaml").write_text(SEVERAL)
    with pytest.raises(UnknownKeyError) as caught:
        read_rig("rig.yaml")
    heading, *lines = str(caught.value).splitlines()
    places = ["cylinder.rod_diameter", "cylinder.bore", "valve.model", "valve.rated_flow", "load.mass", "friction"]
    places += ["randomisation.load.mas", "sensors.pressure_a.hihg", "mass"]
    assert [line.split()[0].rstrip(":") for line in lines] == places
    assert str(len(places)) in heading
    answer = hydro("record", "--rig", "rig.yaml", "--output", "a.csv")
    assert (answer.returncode, own_lines(answer.stderr)[0]) == (2, "hydro: rig.yaml: 9 mistakes")
    assert [file.name for file in tmp_path.iterdir()] == ["rig.yaml"]
