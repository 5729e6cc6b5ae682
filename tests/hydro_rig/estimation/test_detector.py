"""The estimator as a detector: it reads the leak, names other faults, and tells what it cannot read."""

import numpy as np
import pytest
from faulty_windows import FAULTS, made

from hydro_agents.detection.detector import SIGNALS, Cause, Reading, Why, Windows, measured_run
from hydro_agents.detection.monitor import HeadDetector
from hydro_agents.detection.operations import at_rest
from hydro_agents.evaluation.leak_protocol import DetectorChoice, make_detector
from hydro_agents.learning.loading import shipped
from hydro_agents.running.cases import Cases
from hydro_agents.running.seeds import VALIDATION_SEEDS
from hydro_env import TaskConfig
from hydro_env.task.configuration import task_config
from hydro_rig.estimation.estimator import EstimatorDetector, healthy_range
from hydro_rig.estimation.two_stage import TwoStageDetector

CONFIG = TaskConfig()
CAUSES = {"none": Cause.NONE, "rod seal": Cause.EXTERNAL_LEAK, "sensor": Cause.SENSOR, "return line": Cause.RETURN_LINE}


@pytest.mark.parametrize("fault", FAULTS)
def test_the_estimator_reads_the_leak_and_names_the_fault(fault):
    reading = EstimatorDetector().read(made(fault, 0.5), CONFIG)
    assert reading.answers.all()
    assert reading.cause.tolist() == [CAUSES.get(fault, Cause.VALVE)] * 2
    np.testing.assert_allclose(reading.flow_lpm, 0.5, atol=0.05)
    assert (reading.probability > 0.99).all()
    assert all(bool(text) == (fault != "none") for text in reading.fault)


def test_only_windows_with_all_commands_are_read():
    windows = made("none", 0.5)
    windows.signals[0, SIGNALS.index("previous_command"), 3] = np.nan
    reading = EstimatorDetector().read(windows, CONFIG)
    assert reading.answers.tolist() == [False, True]
    assert reading.why.tolist() == [Why.NO_COMMANDS, Why.ANSWERED]
    assert reading.cause[0] == Cause.UNDETERMINED
    assert np.isnan(reading.flow_lpm[0])
    windows.signals[1, SIGNALS.index("previous_command"), 3] = np.nan
    nothing = EstimatorDetector().read(windows, CONFIG)
    assert nothing.why.tolist() == [Why.NO_COMMANDS] * 2
    assert not nothing.answers.any()


def test_a_window_that_no_leak_explains_is_unknown():
    windows = made("none", 0.5)
    windows.signals[0, 0] = windows.signals[0, 0, ::-1]  # no axis moves against its command
    assert EstimatorDetector(restarts=0).read(windows, CONFIG).cause.tolist() == [Cause.UNKNOWN, Cause.NONE]


def test_the_estimator_comes_by_name_and_refuses_no_rig():
    detector = make_detector(DetectorChoice(kind="estimator"))
    assert isinstance(detector, EstimatorDetector)
    assert detector.refuses(TaskConfig(control_period=0.01), 10) == ""
    assert detector.threshold is None


def test_edges_are_worn_where_they_are_open_further_than_the_roundest_healthy_ones():
    rig = {"valve.underlap": {"uniform": [0.0, 0.03]}}
    for drawn, own in ({}, 0.02), ({"valve.overlap": {"uniform": [0.01, 0.04]}}, 0.01):
        config = TaskConfig(plant={"valve": {"overlap": 0.02}}, randomisation=rig | drawn)
        assert healthy_range(config, "valve.overlap") == (pytest.approx(own - 0.015), np.inf)


def test_at_rest_the_head_cannot_tell_a_leak_from_a_shifted_valve_and_the_estimator_is_asked():
    task, seeds = task_config(at_rest(CONFIG), episode_duration=4.0), VALIDATION_SEEDS.start + 997_000 + np.arange(8)
    cases = Cases(seeds, np.repeat([0.01, 0.3], 4), faults={"valve_null_shift": np.full(8, -0.01)})
    windows = Windows.of(measured_run(task, shipped("pid", task), cases)[0][:, :, -CONFIG.steps :])
    head, asked = HeadDetector.load(), []
    reading = head.read(windows, CONFIG)
    assert not reading.answers.any()
    assert np.isnan(reading.score).all()
    assert reading.why.tolist() == [Why.AT_REST] * 8

    class Asked(EstimatorDetector):
        def read(self, windows, task):
            asked.extend(windows.signals)
            return Reading.of(np.full(len(windows), 0.3))

    TwoStageDetector(head, Asked()).read(windows, CONFIG)
    np.testing.assert_array_equal(asked, windows.signals)
