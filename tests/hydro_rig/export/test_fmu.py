"""The FMU: without complaint from FMPy's checker, and the same motion as the kernel's."""

import shutil
from typing import get_args

import numpy as np
import pytest
from command_line import hydro as run

from hydro_env import PlantParameters, TaskConfig, equilibrium, simulate
from hydro_env.plant.parts.leakage import LeakLaw, leak_past_piston
from hydro_env.task.configuration import task_config
from hydro_rig.export.plant import fmu_variables, make_fmu

fmpy = pytest.importorskip("fmpy")
pytestmark = pytest.mark.skipif(
    not any(shutil.which(name) for name in ("cc", "gcc", "clang")), reason="this machine has no C compiler"
)
PERIOD, SAMPLES = 5e-3, 80
VOLTAGE = np.where(np.arange(SAMPLES) < 20, 1.0, -2.0)


@pytest.fixture(scope="module")
def file(tmp_path_factory):
    path = tmp_path_factory.mktemp("fmu") / "axis.fmu"
    path.write_bytes(make_fmu(TaskConfig()))
    return path


def run_fmu(file, start_values, **held):
    names = ["voltage", *held]
    inputs = np.zeros(SAMPLES + 1, dtype=[(name, float) for name in ("time", *names)])
    inputs["time"] = PERIOD * np.arange(SAMPLES + 1)
    inputs["voltage"][:-1] = VOLTAGE
    for name, value in held.items():
        inputs[name] = value
    outputs = ["position", "pressure_a", "measured_pressure_a", "leakage_flow", "holding_voltage"]
    # Values that hold until the next sample: FMPy interpolates between two entries of different times only.
    times = np.repeat(inputs, 2)[1:]
    times["time"][::2] = inputs["time"]
    held_values = np.concatenate([inputs[:1], np.repeat(inputs, 2)[1:-1]])
    held_values["time"] = np.concatenate([[0.0], np.repeat(inputs["time"][1:], 2)])[: len(held_values)]
    for name in names:
        held_values[name] = np.repeat(inputs[name], 2)[: len(held_values)]
    return fmpy.simulate_fmu(
        str(file),
        stop_time=PERIOD * SAMPLES,
        output_interval=PERIOD,
        start_values={**start_values, **held},
        input=held_values,
        output=outputs,
    )


def test_the_checker_has_no_complaint(file):
    from fmpy.validation import validate_fmu

    assert validate_fmu(str(file)) == []


@pytest.mark.filterwarnings("ignore:missing input")
@pytest.mark.parametrize("law", get_args(LeakLaw))
def test_it_moves_as_the_kernel_does(law, file, tmp_path):
    if law != TaskConfig().leakage.law:
        file = tmp_path / "axis.fmu"
        file.write_bytes(make_fmu(task_config(plant={"leakage": leak_past_piston(0.03, law)}, leakage={"law": law})))
    plant = PlantParameters().replace(leakage=leak_past_piston(2.0, law), valve={"null_shift": 0.01})
    rest, voltage = equilibrium(plant, 0.02)
    expected = simulate(plant, VOLTAGE, PERIOD, rest)
    result = run_fmu(file, {"initial_position": 0.02}, **{"leakage": 2.0, "fault.valve_null_shift": 0.01})
    assert np.ptp(expected.position) > 5e-3
    assert np.abs(result["position"] - expected.position).max() <= 1e-9 * np.ptp(expected.position)
    assert np.abs(result["pressure_a"] - expected.pressure_a).max() <= 1e-9 * np.ptp(expected.pressure_a)
    assert result["holding_voltage"][0] == pytest.approx(voltage, abs=1e-9)
    np.testing.assert_allclose(result["leakage_flow"], expected.leakage_flow, rtol=1e-6, atol=1e-12)
    # The transducer is late, and arrives.
    late = np.abs(result["measured_pressure_a"] - result["pressure_a"])
    assert late.max() > 1e3
    assert late[-1] < late.max()


def test_a_place_that_cannot_be_held_is_an_error(file):
    with pytest.raises(Exception, match=r"fmi2ExitInitializationMode|initial_position"):
        run_fmu(file, {"initial_position": 0.19})


def test_its_variables_have_units_and_the_rig_s_values():
    variables = {variable.name: variable for variable in fmu_variables(TaskConfig())}
    assert variables["rig.load.mass"].start == 60.0
    assert variables["rig.load.mass"].unit == "kg"
    assert variables["leakage"].start == pytest.approx(0.03)
    assert variables["position"].causality == "output"
    assert all(variable.unit.isascii() for variable in variables.values())


def test_the_command_writes_it_once(tmp_path):
    folder = tmp_path / "plant"
    result = run("export", "plant", "--rig", "symmetric_eha", "--output", folder)
    assert result.returncode == 0, result.stderr
    assert sorted(path.name for path in folder.iterdir() if not path.name.startswith(".")) == [
        "hydro_axis.fmu",
        "plant.c",
        "plant.h",
    ]
    again = run("export", "plant", "--output", folder)
    assert again.returncode == 2
    unknown = run("export", "controler", "--output", tmp_path / "other")
    assert unknown.returncode == 2
    assert "export 'controler': unknown; known: plant, leakage_head" in unknown.stderr
