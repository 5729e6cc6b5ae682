"""The FMU: FMPy's checker, and the kernel's motion."""

from typing import get_args

import numpy as np
import pytest
from command_line import assert_one_clear_line, hydro

from hydro_env import PlantParameters, TaskConfig, equilibrium, simulate
from hydro_env.plant.parameters import MODEL_CODES
from hydro_env.plant.parts.leakage import LeakLaw, leak_past_piston
from hydro_env.task.configuration import task_config
from hydro_rig.export import plant
from hydro_rig.export.c_files import c_compiler
from hydro_rig.export.plant import make_fmus

PERIOD, SAMPLES, PLACE = 5e-3, 80, 0.02
VOLTAGE = np.where(np.arange(SAMPLES) < 20, 1.0, -2.0)

fmpy = pytest.importorskip("fmpy", reason="the extra 'dev' brings it")
pytestmark = pytest.mark.skipif(c_compiler() is None, reason="this machine has no C compiler")


@pytest.fixture(scope="module")
def file(tmp_path_factory):
    path = tmp_path_factory.mktemp("fmu") / "axis.fmu"
    path.write_bytes(make_fmus(TaskConfig())[0])
    return path


@pytest.fixture(scope="module")
def newer(tmp_path_factory):
    path = tmp_path_factory.mktemp("fmu") / "axis3.fmu"
    path.write_bytes(make_fmus(TaskConfig())[1])
    return path


def test_in_fmi_3_the_checker_has_no_complaint_and_the_motion_is_the_same(file, newer):
    from fmpy.validation import validate_fmu

    assert validate_fmu(str(newer)) == []
    names = ["position", "pressure_a", "leakage_flow", "holding_voltage"]
    steps = np.array([(PERIOD * n, v) for n, v in enumerate(VOLTAGE)], dtype=[("time", "f8"), ("voltage", "f8")])
    options = {"stop_time": PERIOD * SAMPLES, "output_interval": PERIOD, "output": names, "input": steps}
    options |= {"start_values": {"initial_position": PLACE, "leakage": 1.0}, "fmi_type": "CoSimulation"}
    old, new = (fmpy.simulate_fmu(str(one), **options) for one in (file, newer))
    assert np.ptp(old["position"]) > 0.005
    for name in ("time", *names):
        assert np.array_equal(old[name], new[name]), name
    assert {each.unit for each in fmpy.read_model_description(str(newer)).modelVariables} >= {"Pa s/m3", "l/min"}


def test_in_fmi_3_a_wrong_value_is_logged_in_one_line(newer):
    lines = []
    log = {"logger": lambda *said: lines.append(said[-1].decode())}
    with pytest.raises(Exception, match="fmi3SetFloat64"):
        fmpy.simulate_fmu(str(newer), start_values={"rig.load.mass": -1.0}, **log)
    assert lines[0].startswith("rig.load.mass = -1 kg: must be a number within")
    axis = fmpy.instantiate_fmu(fmpy.extract(str(newer)), fmpy.read_model_description(str(newer)), **log)
    axis.enterInitializationMode(startTime=-1.0)
    axis.exitInitializationMode()
    assert axis.doStep(-1.0, PERIOD)[-1] == PERIOD - 1.0
    with pytest.raises(Exception, match="fmi3DoStep"):
        axis.doStep(-1.0, PERIOD)
    assert lines[1:] == ["step from -1 s: must begin where the last one ended, at -0.995 s"]


def run_fmu(file, **values):
    """Outputs of the FMU under the voltages, by name; at every sample and at the end."""
    names = ["position", "pressure_a", "measured_pressure_a", "leakage_flow", "holding_voltage"]
    axis = Instance(file)
    axis.set(**values)
    axis.fmu.exitInitializationMode()
    rows = [axis.get(*names)]
    for sample, voltage in enumerate(VOLTAGE):
        axis.set(voltage=voltage)
        axis.fmu.doStep(sample * PERIOD, PERIOD)
        rows.append(axis.get(*names))
    axis.fmu.terminate()
    axis.fmu.freeInstance()
    return dict(zip(names, np.array(rows).T, strict=True))


class Instance:
    """An FMU in initialisation mode, and what it logged."""

    def __init__(self, file):
        description = fmpy.read_model_description(str(file))
        self.references = {variable.name: variable.valueReference for variable in description.modelVariables}
        self.codes = {variable.name for variable in description.modelVariables if variable.type == "Enumeration"}
        self.lines = []
        self.fmu = fmpy.instantiate_fmu(fmpy.extract(str(file)), description, "CoSimulation", logger=self.log)
        self.fmu.setupExperiment(startTime=0.0)
        self.fmu.enterInitializationMode()

    def log(self, environment, name, status, category, message):
        self.lines.append(message.decode())

    def set(self, **values):
        for name, value in values.items():
            write = self.fmu.setInteger if name in self.codes else self.fmu.setReal
            write([self.references[name]], [value])

    def get(self, *names):
        read = self.fmu.getInteger if self.codes.issuperset(names) else self.fmu.getReal
        return read([self.references[name] for name in names])

    def refused(self, call, *arguments, **values):
        """The one line that a failing call logs."""
        self.lines.clear()
        with pytest.raises(Exception, match="fmi2"):
            call(*arguments, **values)
        (line,) = self.lines
        return line


def test_units_are_those_of_si(file):
    """By hand: the leakage resistance in Pa s/m³ is kg/(m⁴ s); l/min is the one unit that is no SI unit."""
    units = {unit.name: unit.baseUnit for unit in fmpy.read_model_description(str(file)).unitDefinitions}
    resistance, flow, voltage = units["Pa s/m3"], units["l/min"], units["V"]
    assert (resistance.kg, resistance.m, resistance.s, resistance.A, resistance.factor) == (1, -4, -1, 0, 1.0)
    assert (flow.m, flow.s, flow.factor) == (3, -1, pytest.approx(1.0 / 60_000.0))
    assert (voltage.kg, voltage.m, voltage.s, voltage.A) == (1, 2, -3, -1)
    assert [name for name, unit in units.items() if unit is None] == ["m3/(s sqrt Pa)"]
    assert {name for name, unit in units.items() if unit and unit.factor != 1.0} == {"l/min"}


def test_the_checker_has_no_complaint(file):
    from fmpy.validation import validate_fmu

    assert validate_fmu(str(file)) == []


@pytest.mark.parametrize("law", get_args(LeakLaw))
def test_it_moves_as_the_kernel_does(law, file, tmp_path):
    if law != TaskConfig().leakage.law:
        file = tmp_path / "axis.fmu"
        rig = PlantParameters().replace(leakage=leak_past_piston(0.03, law)).model_dump()
        file.write_bytes(make_fmus(task_config(plant=rig, leakage={"law": law}))[0])
    own = PlantParameters().replace(leakage=leak_past_piston(2.0, law), valve={"null_shift": 0.01})
    rest, voltage = equilibrium(own, PLACE)
    expected = simulate(own, VOLTAGE, PERIOD, rest)
    result = run_fmu(file, **{"initial_position": PLACE, "leakage": 2.0, "fault.valve_null_shift": 0.01})
    assert np.ptp(expected.position) > 5e-3
    assert np.abs(result["position"] - expected.position).max() <= 1e-9 * np.ptp(expected.position)
    assert np.abs(result["pressure_a"] - expected.pressure_a).max() <= 1e-9 * np.ptp(expected.pressure_a)
    assert result["holding_voltage"][0] == pytest.approx(voltage, abs=1e-9)
    np.testing.assert_allclose(result["leakage_flow"], expected.leakage_flow, rtol=1e-6, atol=1e-12)
    # The transducer is late, and arrives.
    late = np.abs(result["measured_pressure_a"] - result["pressure_a"])
    assert late.max() > 1e3
    assert late[-1] < late.max()


def test_outputs_in_initialisation_mode_are_those_of_the_equilibrium(file):
    axis = Instance(file)
    names = ["position", "pressure_a", "pressure_b", "supply_pressure", "measured_pressure_a", "holding_voltage"]
    for values, changes in (
        ({"initial_position": PLACE}, {}),
        ({"leakage": 2.0}, {"leakage": leak_past_piston(2.0, "laminar")}),
        ({"rig.supply.pressure": 9e6}, {"leakage": leak_past_piston(2.0, "laminar"), "supply": {"pressure": 9e6}}),
    ):
        axis.set(**values)
        state, voltage = equilibrium(PlantParameters().replace(**changes), PLACE)
        expected = {**state, "measured_pressure_a": state["pressure_a"], "holding_voltage": voltage}
        assert axis.get(*names) == pytest.approx([expected[name] for name in names], rel=1e-9)
    axis.set(voltage=axis.get("holding_voltage")[0])
    axis.fmu.exitInitializationMode()
    for sample in range(100):
        axis.fmu.doStep(sample * PERIOD, PERIOD)
    assert axis.get("position")[0] == pytest.approx(PLACE, abs=1e-7)
    axis.fmu.doStep(100 * PERIOD + 1e-9, PERIOD)
    for other in (0.2, 0.6):  # before the end of the last step, and after it
        assert axis.refused(axis.fmu.doStep, other, PERIOD).startswith(f"step from {other:g} s")


def test_a_model_is_an_item_of_an_enumeration(file, newer):
    start = {"rig.friction.model": MODEL_CODES["friction.model"].index("none"), "voltage": 3.0}
    expected = simulate(PlantParameters().replace(friction={"model": "none"}), np.full(20, 3.0), PERIOD).position
    for one in (file, newer):
        variables = {each.name: each for each in fmpy.read_model_description(str(one)).modelVariables}
        for path, items in MODEL_CODES.items():
            named = variables[f"rig.{path}"].declaredType.items
            assert [(item.name, int(item.value)) for item in named] == [(name, n) for n, name in enumerate(items)]
        run = fmpy.simulate_fmu(str(one), stop_time=0.1, output_interval=PERIOD, start_values=start)
        assert np.abs(run["position"] - expected).max() <= 1e-9 * np.ptp(expected)


def test_what_is_out_of_range_or_fixed_is_refused_in_one_line(file):
    axis = Instance(file)
    for name, value in {
        "rig.valve.rated_flow": -1e-4,
        "rig.friction.model": 7,
        "rig.valve.model": -1,
        "rig.load.mass": -1.0,
        "leakage": -3.0,
        "voltage": np.nan,
        "initial_position": 0.3,
        "position": 0.1,
    }.items():
        before = axis.get(name)
        assert axis.refused(axis.set, **{name: value}).startswith(name)
        assert axis.get(name) == before
    model, mass = axis.references["rig.valve.model"], axis.references["rig.load.mass"]
    assert "an enumeration" in axis.refused(axis.fmu.setReal, [model], [1.0])
    assert "no enumeration" in axis.refused(axis.fmu.getInteger, [mass])
    axis.set(**{"rig.cylinder.stroke": 0.1, "initial_position": 0.06})
    assert axis.refused(axis.get, "position").startswith("initial_position = 0.06 m")
    axis.set(**{"rig.cylinder.stroke": 0.4, "initial_position": 0.19})
    assert "cannot be held" in axis.refused(axis.fmu.exitInitializationMode)
    axis.set(initial_position=PLACE)
    axis.fmu.exitInitializationMode()
    mass = axis.get("rig.load.mass")
    assert axis.refused(axis.set, **{"rig.load.mass": 6000.0}).startswith("rig.load.mass")
    assert axis.get("rig.load.mass") == mass
    axis.set(leakage=1.0)
    axis.fmu.reset()
    axis.set(**{"rig.load.mass": 70.0})


def test_its_description_is_of_this_rig(tmp_path, monkeypatch):
    monkeypatch.setattr(plant, "compiled", lambda *_: b"")
    file = tmp_path / "axis.fmu"
    file.write_bytes(make_fmus(task_config(plant={"load": {"mass": 80.0}, "cylinder": {"stroke": 0.5}}))[0])
    description = fmpy.read_model_description(str(file))
    variables = {variable.name: variable for variable in description.modelVariables}
    mass, place, model = (variables[name] for name in ("rig.load.mass", "initial_position", "rig.valve.model"))
    assert (float(mass.start), float(mass.min), float(mass.max)) == (80.0, 0.01, 1e6)
    assert (float(place.min), float(place.max)) == (-0.25, 0.25)
    assert (float(model.min), float(model.max)) == (0.0, 2.0)
    origins = ("paper", "assumed", "derived")
    assert [name for name, variable in variables.items() if any(word in variable.description for word in origins)] == []
    assert all(variables[name].min is not None for name in variables if variables[name].causality != "output")
    assert variables["rig.load.mass"].unit == "kg"
    assert float(variables["leakage"].start) == pytest.approx(0.03)
    # An output passes a change of an input on after the next step; at the start the voltage changes no output.
    assert all(unknown.dependencies == [] for unknown in description.outputs)
    known = {variable.name for variable in description.initialUnknowns[0].dependencies}
    assert known == {name for name, variable in variables.items() if variable.causality != "output"} - {"voltage"}


def test_the_command_writes_it_once(tmp_path):
    folder = tmp_path / "plant"
    result = hydro("export", "plant", "--rig", "symmetric_eha", "--output", folder)
    assert result.returncode == 0, result.stderr
    written = {path.name for path in folder.iterdir() if not path.name.startswith(".")}
    assert written == {"hydro_axis.fmu", "hydro_axis_fmi3.fmu", "hydro_axis.mo", "plant.c", "plant.h"}
    assert_one_clear_line(hydro("export", "plant", "--output", folder), "holds results already")
    unknown = hydro("export", "controler", "--output", tmp_path / "other")
    assert_one_clear_line(unknown, "export 'controler': unknown; known: plant, leakage_head")
