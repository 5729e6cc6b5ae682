"""Axes of Exudyn: their rigs, and, where it is installed, that they begin at rest and leak as told."""

import importlib.util
import math

import numpy as np
import pandas as pd
import pytest

from benchmarks.foreign_plants import LEAKS, PLANTS, UNTUNED, Axis, references, summary, task_of
from hydro_env.units import LITRE_PER_MINUTE

needs_exudyn = pytest.mark.skipif(importlib.util.find_spec("exudyn") is None, reason="needs the extra foreign")


def test_the_rigs_come_from_nameplates_alone(tmp_path):
    tasks = {name: task_of(machine, tmp_path, name) for name, machine in PLANTS.items()}
    plain, told = tasks["flexible_crane"].plant, tasks["flexible_crane_told"].plant
    assert tasks["rigid_crane"].plant == plain
    assert told.load.tip_frequency == pytest.approx(2 * math.pi * 6.0)
    assert told.rigid.replace(load={"tip_frequency": plain.load.tip_frequency}) == plain
    for name, machine in PLANTS.items():
        for time in (machine.period, machine.latency):
            assert round(time / machine.step) * machine.step == pytest.approx(time, abs=1e-12)
        areas = tasks[name].plant.cylinder
        assert machine.areas()[0] == pytest.approx(math.pi / 4 * areas.bore_diameter**2)
        wanted = references(tasks[name], 0.2, ["ramp", "sine"])
        assert wanted.shape == (2, round(0.2 / machine.period))
        assert np.abs(wanted).max() < machine.stroke / 2


def test_errors_are_relative_to_those_of_the_same_axis():
    errors = {("slide", UNTUNED): 60.0, ("slide", "pid"): 90.0, ("rigid_crane", UNTUNED): 50.0}
    rows = pd.DataFrame(
        [
            {"plant": plant, "controller": name, "leak": leak, "error_um": error * (1 + leak), "travel": 2.0}
            for (plant, name), error in errors.items()
            for leak in LEAKS
        ]
    )
    assert summary(rows)["ratio"].tolist() == pytest.approx([1, 1, 1.5, 1.5, 1, 1])


@needs_exudyn
@pytest.mark.parametrize("plant", PLANTS)
def test_an_axis_begins_at_rest_and_its_chambers_exchange_the_oil_of_the_leak(plant):
    machine, position, leak, samples = PLANTS[plant], 0.05, 1.0, []
    Axis(machine, position, leak).run(0.05, lambda true: samples.append(true) or 0.0)
    true = np.array(samples)
    assert true[:, 0] == pytest.approx(position, abs=2e-4)
    pressures = true[:, 1:3]
    oil = leak * LITRE_PER_MINUTE / 100e5 * np.trapezoid(pressures[:, 0] - pressures[:, 1], dx=machine.period)
    for chamber, sign in enumerate((1.0, -1.0)):
        area = machine.areas()[chamber]
        volume = machine.dead_volume + area * (machine.stroke / 2 + sign * position)
        squeezed = volume * (pressures[-1, chamber] - pressures[0, chamber]) / machine.bulk_modulus
        swept = sign * area * (true[-1, 0] - true[0, 0])
        assert squeezed + swept == pytest.approx(-sign * oil, rel=0.02)
