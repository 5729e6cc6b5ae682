"""The file of a fleet: each axis has its rig, map, oil and limit, the same for ``hydro trend`` and ``hydro watch``."""

import pytest
from command_line import hydro
from refusal import refused

from hydro_env.task.configuration import task_config
from hydro_rig.watching.fleet import Fleet
from hydro_rig.watching.stream import FleetWatch

MAP = "time: t\ncommand: {column: u, unit: V}\nposition: {column: x, unit: mm}\n"
FLEET = """\
rig: press.yaml
limit: 0.2
axes:
  press: {}
  lift: {rig: kovari_2015, oil: 32, limit: 0.4, map: maps/lift.yaml}
"""


@pytest.fixture
def folder(tmp_path):
    hydro("new-rig", "bore=50mm", "rod=28mm", "stroke=500mm", "rated-flow=40l/min", "supply-pressure=160bar",
          "mass=200kg", "-o", tmp_path / "press.yaml")  # fmt: skip
    (tmp_path / "maps").mkdir()
    (tmp_path / "maps" / "lift.yaml").write_text(MAP)
    (tmp_path / "fleet.yaml").write_text(FLEET)
    return tmp_path


def test_each_axis_has_what_its_file_says(folder):
    fleet = Fleet.load(folder / "fleet.yaml")
    press, lift = fleet.axis("press"), fleet.axis("lift")
    assert (press.limit, lift.limit) == (0.2, 0.4)
    assert press.task == task_config(rig=folder / "press.yaml")
    assert (press.oil.at_40, lift.oil.at_40) == (46.0, 32.0)
    assert press.columns is None
    assert lift.columns.command.column == "u"
    assert fleet.missing("crane").startswith("axis 'crane' is not in ")
    assert not Fleet(press).missing("crane")


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("axes: {}\n", "axes"),
        ("axes: {a: {rigs: x}}\n", "rigs"),
        ("axes: {a: {rig: absent.yaml}}\n", "axes.a: "),
        ("axes: {a: {oil: 45}}\n", "oil 45"),
        ("axes: {a: {limit: -1}}\n", "limit"),
    ],
)
def test_a_mistake_names_file_and_field(tmp_path, text, told):
    (tmp_path / "fleet.yaml").write_text(text)
    with refused(told) as caught:
        Fleet.load(tmp_path / "fleet.yaml")
    assert "fleet.yaml" in str(caught.value)


def test_rows_are_read_by_the_map_of_their_axis_and_those_of_a_stranger_are_left_out(folder, capsys):
    watched = FleetWatch(Fleet.load(folder / "fleet.yaml"), folder / "watch.csv")
    lines = ["axis,t,u,x", "lift,1.0,2,5", "crane,1.0,2,5", "lift,1.005,2,5", "crane,1.005,2,5"]
    assert not list(watched.looks(lines))
    assert list(watched.axes) == ["lift"]
    assert watched.axes["lift"].newest == 1.005
    assert capsys.readouterr().err.count("axis 'crane' is not in ") == 1
