"""The Modelica text, simulated by a compiler that nobody here wrote: the axis moves as in the fast simulation."""

import re

import numpy as np
import pytest

from hydro_env import equilibrium, simulate
from hydro_env.plant.parameters import MODEL_CODES, PARAMETER_PATHS
from hydro_env.plant.parts.leakage import leak_past_piston
from hydro_env.plant.states import VAPOUR_PRESSURE
from hydro_env.task.configuration import task_config
from hydro_rig.export.plant import modelica_text

rumoca = pytest.importorskip("rumoca", reason="the extra 'dev' brings it")

STEP, LEAK, FORCE = 1e-3, 1.0, 50.0  # s, l/min, N
VOLUMES = {"lines": {"volume_a": 2e-5, "volume_b": 3e-5, "wall_bulk_modulus": 3e8}}
EVERY_PART = {
    "lines": {"volume_a": 1e-4, "volume_b": 1.5e-4, "length_a": 2.0, "length_b": 3.0, "wall_bulk_modulus": 5e8},
    "load": {"tip_share": 0.6, "tip_frequency": 40.0},
    "valve": {"underlap": 0.0, "overlap": 0.02, "knee_opening": 0.3, "edge_ratio": 0.6, "null_shift": 0.01},
    "friction": {"model": "lugre"},
    "supply": {"model": "pump"},
    "leakage": {"external_resistance": 2e12},
}


def moved_alike(config, *pieces):
    """The run under pieces of (duration in s, voltage): the text gives the same signals within 1e-4 of their ranges."""
    switches, end = "0", sum(duration for duration, _ in pieces)
    for duration, volts in reversed(pieces):
        switches = f"if time < {end} then {volts} else {switches}"
        end -= duration
    trial = f"""
    model Trial
      HydroAxis axis;
    equation
      axis.voltage = {switches};
      axis.leakage = {LEAK};
      axis.external_force = {FORCE};
    end Trial;"""
    model = rumoca.Session().loads(modelica_text(config) + trial, model="Trial")
    accuracy = rumoca.SimConfig(rtol=1e-8, atol=1e-10)
    leak = {name: value for name, value in leak_past_piston(LEAK, config.leakage.law).items() if 0.0 < value < np.inf}
    plant = config.plant.replace(leakage=leak, load={"external_force": config.plant.load.external_force + FORCE})
    voltage = np.repeat([volts for _, volts in pieces], [round(duration / STEP) for duration, _ in pieces])
    ours = simulate(plant, voltage, STEP, equilibrium(config.plant, 0.0)[0])
    theirs = model.simulate(t=(0.0, ours.time[-1]), dt=STEP, config=accuracy)
    assert np.ptp(ours.position) > 2e-3
    for name in ("position", "velocity", "pressure_a", "pressure_b", "supply_pressure", "leakage_flow"):
        there = np.interp(ours.time, theirs.time, theirs[f"axis.{name}"])
        assert np.abs(there - ours[name]).max() <= 1e-4 * np.ptp(ours[name]), name
    return ours


def test_the_papers_axis_and_one_from_nameplates_move_as_in_the_fast_simulation(other_rig):
    for rig in (None, other_rig):
        moved_alike(task_config(rig=rig), (0.1, 3.0), (0.1, -5.0))


@pytest.mark.parametrize("parts", [EVERY_PART, VOLUMES])
def test_an_axis_with_other_parts_moves_as_in_the_fast_simulation(parts):
    moved_alike(task_config(plant=parts, leakage={"law": "orifice"}), (0.1, 3.0), (0.1, -6.0))


@pytest.mark.parametrize(("path", "model"), [(path, model) for path, models in MODEL_CODES.items() for model in models])
def test_every_model_of_a_part_is_in_the_text(path, model):
    group, field = path.split(".")
    moved_alike(task_config(plant={group: {field: model}}), (0.1, 3.0), (0.1, -5.0))


def test_every_number_of_a_rig_is_in_the_text():
    rigs = task_config(), task_config(plant=EVERY_PART, leakage={"law": "orifice"})
    texts = "".join(modelica_text(rig) for rig in rigs)
    assert [path for path in {*PARAMETER_PATHS} - {*MODEL_CODES} if not re.search(rf"rig\.{path}\b", texts)] == []


@pytest.mark.parametrize(("direction", "duration"), [(1.0, 0.5), (-1.0, 0.8)])
def test_every_limit_of_the_axis_is_in_the_text(direction, duration):
    """A mass of 20 t: it runs into its stop, and oil cavitates when it bounces and when the valve closes."""
    heavy, supply = {"mass": 2e4, "spring_stiffness": 0.0, "viscous_damping": 0.0}, {"pressure": 140e5}
    plant = {"load": heavy, "supply": supply, "cylinder": {"stroke": 0.18}, "valve": {"amplifier_gain": 1.0}}
    run = moved_alike(task_config(plant=plant), (duration, 10.0 * direction), (0.05, -3.0 * direction), (0.35, 0.0))
    assert min(run.pressure_a.min(), run.pressure_b.min()) == VAPOUR_PRESSURE
    assert (direction * run.position).max() > 0.09
    assert (direction * run.spool_position).max() == 1.0
    assert (direction * run.spool_velocity).max() == 100.0  # the slew limit
