"""Drawn rigs are rigs of this world, and the judgement of gains on them counts what it says."""

import numpy as np
import pandas as pd
import pytest

from benchmarks.drawn_rigs import BORES_AND_RODS, DEAD, drawn_answers, drawn_task
from benchmarks.no_tuning import family_errors, judged_rig, summary
from hydro_agents.controllers.flow_linearising import FlowLinearising, FlowLinearisingGains
from hydro_agents.rigs.new_rig import QUESTIONS
from hydro_agents.running.seeds import RIGS, UNTUNED_RIGS
from hydro_env import TaskConfig
from hydro_env.plant.analysis import closed_port_natural_frequency, full_pressure_forces, speed_limits
from hydro_env.task.configuration import task_config

ROUNDED = 1.05  # masses and volumes have three digits
LARGEST_GAP = np.sqrt(2.0) * ROUNDED  # neighbouring valve sizes are at most a factor of two apart


def test_drawn_rigs_are_plausible_and_differ(tmp_path):
    known = {question.key for question in QUESTIONS}
    seen = []
    for seed in [*RIGS.take(12), *UNTUNED_RIGS.take(12)]:
        texts, timing = drawn_answers(seed)
        assert texts.keys() <= known
        assert (texts, timing) == drawn_answers(seed)
        task = drawn_task(tmp_path, seed)
        plant, period = task.plant, task.control_period
        assert round(1e3 * plant.cylinder.bore_diameter) in BORES_AND_RODS
        assert 70e5 <= plant.supply.pressure <= 250e5
        assert 30.0 <= plant.valve.natural_frequency / (2.0 * np.pi) <= 150.0
        assert period == timing["control_period"] >= task.command_latency >= 0.5e-3
        assert 0.1 / LARGEST_GAP < np.mean(speed_limits(plant)) < 1.0 * LARGEST_GAP
        assert min(full_pressure_forces(plant)) > 1.2 * plant.load.external_force
        assert (tmp_path / f"rig_{seed}.yaml").is_file()
        assert len(task.randomisation) > 10
        seen.append((plant.cylinder.bore_diameter, plant.load.mass, plant.valve.natural_frequency))
    assert len(set(seen)) == len(seen)


def test_the_mass_gives_the_drawn_frequency_unless_the_supply_could_not_move_it(tmp_path):
    limited = 0
    for seed in UNTUNED_RIGS.take(24, 100):
        plant = drawn_task(tmp_path, seed).plant
        dead = 0.25 * np.pi * plant.cylinder.bore_diameter**2 * plant.cylinder.stroke * DEAD
        assert plant.cylinder.dead_volume == pytest.approx(dead, rel=0.01)
        frequency = closed_port_natural_frequency(plant) / (2.0 * np.pi)
        assert frequency > 5.0  # hoses and piston lower it below the drawn one
        limited += frequency > 80.0 * ROUNDED
    assert limited < 8


def test_errors_are_those_of_the_sensor_and_a_failure_costs_the_stroke():
    task = TaskConfig(episode_duration=0.3)

    class Open:
        """Opens the valve and never closes it: the axis hits its end stop."""

        def predict(self, observation, state=None, episode_start=None, deterministic=True):
            return np.ones((len(observation), 1), np.float32), None

    held, none = family_errors(FlowLinearising(FlowLinearisingGains(), task), task, 0)
    assert none == 0
    assert max(held.values()) < 5e-3
    assert held["pause"] < 60e-6  # the bias of the sensor, up to 80 µm, is none of the controller's
    free = task_config(task, plant={"load": {"spring_stiffness": 0.0}})
    lost, failures = family_errors(Open(), free, 0)
    assert failures > 0
    assert lost["pause"] == pytest.approx(task.plant.cylinder.stroke)


def test_a_rig_gives_a_row_per_controller_and_the_summary_counts_them(tmp_path):
    rows = pd.DataFrame(judged_rig(2, tmp_path, 0))
    assert rows["controller"].iloc[0] == "untuned"
    assert (rows["error_um"] > 0.0).all()
    other = rows.assign(rig=3, error_um=2.0 * rows["error_um"], limit_cycles=5, largest_amplitude_um=70.0)
    line = summary(pd.concat([rows, other]))[0]
    assert line[:4] == ["untuned", "2", "1.00 (1.00–1.00)", "1.00–1.00"]
    assert line[5].endswith(f"on {1 + int(rows['limit_cycles'][0] > 0)} rigs")
    assert line[6] == "70"
