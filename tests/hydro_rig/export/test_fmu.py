"""The FMU: FMPy's checker, and the kernel's motion."""

from typing import get_args

import numpy as np
import pytest
from command_line import assert_one_clear_line, hydro

from hydro_env import PlantParameters, TaskConfig, equilibrium, simulate
from hydro_env.plant.parts.leakage import LeakLaw, leak_past_piston
from hydro_env.task.configuration import task_config
from hydro_rig.export.c_files import c_compiler
from hydro_rig.export.plant import fmu_variables, make_fmu

PERIOD, SAMPLES, PLACE = 5e-3, 80, 0.02
VOLTAGE = np.where(np.arange(SAMPLES) < 20, 1.0, -2.0)

needs_compiler = pytest.mark.skipif(c_compiler() is None, reason="this machine has no C compiler")


@pytest.fixture(scope="module")
def file(tmp_path_factory):
    path = tmp_path_factory.mktemp("fmu") / "axis.fmu"
    path.write_bytes(make_fmu(TaskConfig()))
    return path


def run_fmu(file, **values):
    """Outputs of the FMU under the voltages, by name; at every sample and at the end."""
    fmpy = pytest.importorskip("fmpy")
    description = fmpy.read_model_description(str(file))
    references = {variable.name: variable.valueReference for variable in description.modelVariables}
    names = ["position", "pressure_a", "measured_pressure_a", "leakage_flow", "holding_voltage"]
    axis = fmpy.instantiate_fmu(fmpy.extract(str(file)), description, "CoSimulation")
    axis.setupExperiment(startTime=0.0)
    axis.enterInitializationMode()
    axis.setReal([references[name] for name in values], list(values.values()))
    axis.exitInitializationMode()
    rows = [axis.getReal([references[name] for name in names])]
    for sample, voltage in enumerate(VOLTAGE):
        axis.setReal([references["voltage"]], [voltage])
        axis.doStep(sample * PERIOD, PERIOD)
        rows.append(axis.getReal([references[name] for name in names]))
    axis.terminate()
    axis.freeInstance()
    return dict(zip(names, np.array(rows).T, strict=True))


@needs_compiler
def test_the_checker_has_no_complaint(file):
    pytest.importorskip("fmpy")
    from fmpy.validation import validate_fmu

    assert validate_fmu(str(file)) == []


@needs_compiler
@pytest.mark.parametrize("law", get_args(LeakLaw))
def test_it_moves_as_the_kernel_does(law, file, tmp_path):
    if law != TaskConfig().leakage.law:
        file = tmp_path / "axis.fmu"
        file.write_bytes(make_fmu(task_config(plant={"leakage": leak_past_piston(0.03, law)}, leakage={"law": law})))
    plant = PlantParameters().replace(leakage=leak_past_piston(2.0, law), valve={"null_shift": 0.01})
    rest, voltage = equilibrium(plant, PLACE)
    expected = simulate(plant, VOLTAGE, PERIOD, rest)
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


@needs_compiler
def test_a_place_that_cannot_be_held_is_an_error(file):
    with pytest.raises(Exception, match=r"fmi2ExitInitializationMode|initial_position"):
        run_fmu(file, initial_position=0.19)


def test_its_variables_have_units_and_the_rig_s_values():
    variables = {variable.name: variable for variable in fmu_variables(TaskConfig())}
    assert variables["rig.load.mass"].start == 60.0
    assert variables["rig.load.mass"].unit == "kg"
    assert variables["leakage"].start == pytest.approx(0.03)
    assert variables["position"].causality == "output"
    assert all(variable.unit.isascii() for variable in variables.values())


@needs_compiler
def test_the_command_writes_it_once(tmp_path):
    folder = tmp_path / "plant"
    result = hydro("export", "plant", "--rig", "symmetric_eha", "--output", folder)
    assert result.returncode == 0, result.stderr
    written = {path.name for path in folder.iterdir() if not path.name.startswith(".")}
    assert written == {"hydro_axis.fmu", "plant.c", "plant.h"}
    assert_one_clear_line(hydro("export", "plant", "--output", folder), "holds results already")
    unknown = hydro("export", "controler", "--output", tmp_path / "other")
    assert_one_clear_line(unknown, "export 'controler': unknown; known: plant, leakage_head")
