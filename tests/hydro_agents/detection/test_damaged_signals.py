"""Signals with gaps: a rig without a spool sensor."""

import numpy as np

from hydro_agents.detection.damaged_signals import repaired
from hydro_agents.detection.detector import measured_run
from hydro_agents.detection.operations import MANNERS, Operation
from hydro_agents.detection.sheet import sheet_of
from hydro_agents.running.cases import Cases
from hydro_agents.running.seeds import TRAINING_SEEDS
from hydro_env.task.configuration import task_config
from hydro_env.task.sensors import SPOOL


def test_without_a_spool_sensor_the_nominal_valve_answers_the_commands():
    task = task_config(randomisation={}, sensors={"enabled": False})
    seeds = TRAINING_SEEDS.start + 945_000 + np.arange(3)
    signals, _ = measured_run(task, Operation(MANNERS["dithering"], task, 3, 0), Cases(seeds))
    blind = signals.copy()
    blind[:, SPOOL] = np.nan
    filled, lost = repaired(blind, sheet_of(task))
    assert lost[:, SPOOL].tolist() == [1.0, 1.0, 1.0]
    assert np.ptp(signals[:, SPOOL]) > 0.05
    np.testing.assert_allclose(filled[:, SPOOL], signals[:, SPOOL], atol=2e-3)
    np.testing.assert_array_equal(np.delete(filled, SPOOL, axis=1), np.delete(signals, SPOOL, axis=1))
