"""The detectors of the project and of others: what they read, refuse and name."""

import re
from pathlib import Path

import numpy as np
import pytest
from faulty_windows import made
from refusal import refused

from hydro_agents.detection.detector import Cause, Why, logit, threshold_at_false_alarm_rate
from hydro_agents.detection.features import LABELS
from hydro_agents.detection.monitor import OTHER_CAUSES, HeadDetector
from hydro_agents.evaluation.leak_protocol import DetectorChoice, make_detector
from hydro_env import TaskConfig
from hydro_env.files import validate
from hydro_env.task.configuration import task_config

CONFIG = TaskConfig()


def test_the_shipped_head_reads_the_windows_of_its_axis_and_leaves_others_to_that_for_any_axis():
    detector = make_detector(DetectorChoice(kind="head"))
    assert isinstance(detector, HeadDetector)
    assert detector.refuses(CONFIG, 400) == ""
    assert "windows of at least 2 s" in detector.refuses(CONFIG, 20)
    alone, slow = HeadDetector(detector.head), TaskConfig(control_period=0.01)
    assert "a control period of 5 ms" in alone.refuses(slow, 400)
    heavy = CONFIG.model_copy(update={"plant": CONFIG.plant.replace(load={"mass": 900.0})})
    assert "another rig" in alone.refuses(heavy, 400)
    assert detector.refuses(heavy, 400) == detector.refuses(slow, 200) == ""
    deaf = task_config(slow, sensors={"pressure_a": {"fitted": False}})
    assert "reads pressure_a, but this rig has no such sensor" in detector.refuses(deaf, 200)
    assert np.isfinite(detector.threshold)


@pytest.mark.parametrize("fault", ["valve", "rod seal", "sensor"])
def test_the_head_names_the_fault_with_the_largest_excess(fault):
    detector, windows = make_detector(DetectorChoice(kind="head")), made(fault, 0.01, 800)
    reading, found = detector.read(windows, CONFIG), detector.head.estimate_windows(windows.signals)
    thresholds = logit(detector.head.tensors["thresholds"])
    for window in np.flatnonzero(reading.answers):
        excess = {
            cause: logit(getattr(found, name))[window] - thresholds[LABELS.index(name)]
            for cause, name in zip(OTHER_CAUSES, LABELS[1:], strict=True)
        }
        best = max(excess, key=excess.get)
        assert reading.cause[window] == (best if excess[best] > 0.0 else Cause.NONE)
        assert (best.in_full in reading.fault[window]) == (excess[best] > 0.0)


def test_a_stuck_sensor_gives_no_answer():
    windows = made("none", 0.5, 400)
    windows.signals[0, 1] = windows.signals[0, 1, 0]
    reading = make_detector(DetectorChoice(kind="head")).read(windows, CONFIG)
    assert reading.answers.tolist() == [False, True]
    assert reading.why[0] == Why.OUTSIDE


def test_a_detector_of_ones_own_is_named_by_module_and_attribute():
    reader = make_detector(DetectorChoice(kind="small_leaks:Spread"))
    assert (type(reader).__name__, reader.refuses(CONFIG, 60)) == ("Spread", "")
    with refused("is no leak detector, it has no threshold, refuses, read"):
        make_detector(DetectorChoice(kind="small_leaks:SMALL"))
    with refused("kind = 'network': must be head, estimator, or module:attribute"):
        validate(DetectorChoice, {"kind": "network"}, "own.yaml")


def test_the_detector_of_the_page_works_in_the_protocol_and_under_an_alarm(tmp_path, monkeypatch):
    page = (Path(__file__).parents[3] / "docs" / "own_controller.md").read_text(encoding="utf-8")
    (text,) = (
        block for block in re.findall(r"```python\n(.*?)```", page, flags=re.DOTALL) if "AlikePressures" in block
    )
    (tmp_path / "my_detector.py").write_text(text, encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    detector = make_detector(DetectorChoice(kind="my_detector:AlikePressures"))
    tight, leaking = (detector.read(made("none", leak, 400), CONFIG) for leak in (0.01, 10.0))
    assert leaking.score.mean() > tight.score.mean()
    assert "needs both pressures" in detector.refuses(TaskConfig(sensors={"pressure_a": {"fitted": False}}), 400)


@pytest.mark.parametrize("count", [1, 100, 1000])
@pytest.mark.parametrize("rate", [0.0, 0.01])
@pytest.mark.parametrize("decimals", [1, 12])
def test_threshold_never_exceeds_the_false_alarm_rate(count, rate, decimals):
    healthy = np.round(np.random.default_rng(count).random(count), decimals)
    threshold = threshold_at_false_alarm_rate(healthy, rate)
    assert np.mean(healthy >= threshold) <= rate
    # It is the lowest: the next healthy score below it would be too many.
    assert np.mean(healthy >= healthy[healthy < threshold].max()) > rate
