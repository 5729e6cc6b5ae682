"""The leakage head on the rig of a task: the one for any axis moves there."""

import numpy as np
import pytest
from refusal import refused
from sklearn.metrics import roc_auc_score

from hydro_agents.controllers.flow_linearising import FlowLinearising, FlowLinearisingGains
from hydro_agents.detection.detector import MeasuredColumns, Windows, measured_run
from hydro_agents.detection.head import LeakageHead
from hydro_agents.detection.monitor import HeadDetector
from hydro_agents.detection.sheet import leak_scale
from hydro_agents.running.cases import Cases
from hydro_agents.running.folders import pretrained_folder
from hydro_agents.running.seeds import VALIDATION_SEEDS
from hydro_env import ServoHydraulicVectorEnv, TaskConfig
from hydro_env.task.configuration import task_config
from hydro_env.task.drawn_rigs import rig_tasks

RIGS = rig_tasks(task_config(law={"split": "validation", "first": 7000, "count": 4, "preview_paces": []}))
BLIND = next(task for task in RIGS if not task.sensors.spool_position.fitted)
ANY = LeakageHead.load(pretrained_folder() / "leakage_head_any_axis")
ONE = LeakageHead.load(pretrained_folder() / "leakage_head")


@pytest.mark.parametrize("task", [RIGS[0], BLIND], ids=["all sensors", "no spool sensor"])
def test_the_head_for_any_axis_finds_leaks_on_rigs_that_it_never_saw(task):
    large = min(leak_scale(task), 20.0)  # the unit of the rig, in l/min
    sizes = np.repeat([0.01, 1.0], 60)
    cases = Cases(VALIDATION_SEEDS.start + 990_000 + np.arange(120), large * sizes)
    signals, _ = measured_run(task, FlowLinearising(FlowLinearisingGains(), task), cases)
    found = HeadDetector.load().on(task).estimate_windows(signals)
    assert roc_auc_score(sizes == 1.0, found.probability) > 0.9
    assert 0.3 < np.median(found.flow_lpm[sizes == 1.0]) / large < 1.6


def test_a_parameter_that_no_drawn_rig_varies_does_not_put_a_rig_outside():
    task = TaskConfig()  # its file gives the supply a range
    sizes = np.repeat([0.001, 3.0], 40)
    cases = Cases(VALIDATION_SEEDS.start + 996_000 + np.arange(80), sizes)
    signals, _ = measured_run(task, FlowLinearising(FlowLinearisingGains(), task), cases)
    found = ANY.moved_to(task).estimate_windows(signals)
    assert found.outside.mean() < 0.3  # all of them, if a feature that never varied counted
    assert roc_auc_score(sizes == 3.0, found.probability) > 0.95


def test_a_head_reads_what_a_rig_without_a_spool_sensor_has():
    head = ANY.moved_to(BLIND)
    assert head.settings.window * BLIND.control_period == pytest.approx(2.0, rel=0.01)
    env = ServoHydraulicVectorEnv(2, BLIND)
    controller = FlowLinearising(FlowLinearisingGains(), BLIND)
    observation, state, memory, seen = env.reset(seed=5)[0], None, None, []
    for _ in range(head.settings.window):
        seen.append(observation)
        answer, state = head.predict(observation, state)
        action, memory = controller.predict(observation, memory)
        observation, *_ = env.step(action)
    layout = MeasuredColumns.of(BLIND)
    whole = head.estimate_windows(layout.si(np.stack(seen, axis=2)[:, layout.columns]))
    np.testing.assert_array_equal(np.column_stack(whole), answer)
    assert np.isfinite(whole.probability).all()


def test_the_shipped_head_serves_its_rig_and_the_one_for_any_axis_the_others():
    detector, other = HeadDetector.load(), RIGS[0]
    assert detector.on(TaskConfig()).settings == ONE.settings
    assert detector.on(other).settings == ANY.moved_to(other).settings
    signals, _ = measured_run(
        other, FlowLinearising(FlowLinearisingGains(), other), Cases(VALIDATION_SEEDS.start + 995_000 + np.arange(8))
    )
    reading, found = detector.read(Windows.of(signals), other), ANY.moved_to(other).estimate_windows(signals)
    flagged = found.probability >= ANY.settings.threshold
    np.testing.assert_array_equal((reading.score >= detector.threshold)[reading.answers], flagged[reading.answers])
    with refused("must be a leakage head for any axis"):
        ONE.moved_to(other)
