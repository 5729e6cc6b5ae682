"""The whole job, small: its tables, and that it goes on from its files; the detectors."""

import numpy as np
import pytest
from command_line import assert_one_clear_line, hydro

from agents.alarms.alarm import AlarmSettings, LeakAlarm
from agents.alarms.calibration import scale_of
from agents.alarms.detector import Activity, Cause, EstimatorDetector, Evidence, HeadDetector
from agents.alarms.job import FAULTS, LEVELS, AlarmJob, run_job
from agents.alarms.looks import Looks
from agents.alarms.store import Bench
from agents.controllers import PID, ObservationLayout, PIDGains
from agents.leakage.head import SIGNALS, HeadSettings, LeakageHead, LeakageNetwork
from hydro_env import ConfigurationError, TaskConfig

CONFIG = TaskConfig()
JOB = AlarmJob(hours=0.6, shift=60.0, past=15.0, after=5.0, axes=4, interval=1.0, learning=4)


class Noise:
    """A detector that knows nothing: its score is the noise of the position's last digits."""

    window = 200

    def __call__(self, signals):
        score = 1e4 * np.diff(signals[:, SIGNALS.index("position")], n=2, axis=1)[:, ::20].mean(axis=1)
        unknown = np.full(len(score), np.nan)
        return Evidence(score, unknown, np.ones(len(score)), np.zeros(len(score), dtype=np.int8))


@pytest.mark.filterwarnings("error")
def test_the_job_writes_its_tables_and_goes_on_from_its_files(tmp_path):
    bench = Bench(CONFIG, {"PID": PID(PIDGains(proportional=60.0), CONFIG)}, Noise(), "noise", tmp_path)
    seen = []
    settings, tables = run_job(bench, JOB, lambda *step: seen.append(step))
    assert all(each.threshold > 0.0 for each in settings.sums)
    assert settings.false_alarms_per_100_h == 1.0
    assert settings.interval == 1.0
    assert len(tables["delays"]) == len(LEVELS) * len(Activity)
    assert len(tables["other_faults"]) == len(FAULTS)
    assert tables["false_alarms"]["alarms"].is_monotonic_decreasing
    assert {phase for phase, _, _ in seen} >= {"validation_healthy", "test_healthy"}
    written = {path.name: path.stat().st_mtime_ns for path in tmp_path.iterdir()}
    again, _ = run_job(bench, JOB)
    assert again == settings
    assert written == {path.name: path.stat().st_mtime_ns for path in tmp_path.iterdir()}


def test_scale_counts_looks_that_stray_together_for_little():
    generator, count = np.random.default_rng(0), 200
    white = generator.normal(0.0, 1.0, (50, count))
    together = np.repeat(generator.normal(0.0, 1.0, (50, count // 10)), 10, axis=1)

    def looks(score):
        full = np.full(score.shape, np.nan)
        kinds = [np.full(score.shape, kind, dtype=np.int8) for kind in (0, Activity.MOVING)]
        return Looks(np.arange(count, dtype=float), score, full, full, *kinds, full)

    assert scale_of(looks(white), [], Activity.MOVING, 50).spread == pytest.approx(1.0, rel=0.1)
    assert scale_of(looks(together), [], Activity.MOVING, 50).spread == pytest.approx(np.sqrt(10.0), rel=0.15)
    with pytest.raises(ConfigurationError, match="0 healthy axes were slow"):
        scale_of(looks(white), [], Activity.SLOW, 50)


def test_the_head_is_a_detector_that_needs_all_samples():
    layout = ObservationLayout.of(CONFIG)
    head = LeakageHead(LeakageNetwork(width=8), HeadSettings(layout, 100, 0.5, {}))
    detector = HeadDetector(head)
    scale = np.array([layout.scale[layout.index(name)] for name in SIGNALS])[:, None]
    observed = np.random.default_rng(1).normal(0.0, 0.3, (3, len(SIGNALS), 100)).astype(np.float32)
    signals = observed * scale
    signals[2, 1, 50] = np.nan
    found = detector(signals)
    expected = head.estimate_signals(observed[:2])
    np.testing.assert_allclose(1.0 / (1.0 + np.exp(-found.score[:2])), expected.probability, rtol=1e-4)
    np.testing.assert_allclose(found.flow_lpm[:2], expected.flow_lpm, rtol=1e-4)
    assert np.isnan(found.score[2])
    assert detector(signals[2:]).cause.tolist() == [Cause.SEAL_OR_NOTHING]


def test_an_estimator_is_a_detector_and_a_misfit_counts_for_nothing():
    class Found:
        holds = np.array([True, False])

        def value(self, name):
            return {"leakage_flow_lpm": np.array([0.12, 3.0])}[name]

        def deviation(self, name):
            return {"leakage_flow_lpm": np.array([0.002, 0.002])}[name]

    detector = EstimatorDetector(lambda signals: Found(), 100)
    evidence = detector(np.zeros((2, 5, 100)))
    assert evidence.cause.tolist() == [Cause.SEAL_OR_NOTHING, Cause.UNKNOWN]
    scales = {a.name.lower(): {"highest_baseline": 0.03, "spread": 0.001, "shift": 0.1} for a in Activity}
    alarm = LeakAlarm(AlarmSettings(scales=scales, sums=({"method": "cusum", "threshold": 4.0},)))
    result, _ = alarm.update(evidence, np.array([Activity.MOVING] * 2, dtype=np.int8), alarm.begin(2))
    assert result.alarm.tolist() == [True, False]


@pytest.mark.parametrize(
    ("options", "parts"),
    [
        (("--hours", "-3"), ("hours = -3", "above 0")),
        (("--rate", "0"), ("rate = 0", "above 0")),
        (("--head", "nowhere"), ("nowhere.json", "cannot be read")),
        (("--task", "period_10ms"), ("leakage_head", "other observations")),
    ],
)
def test_bad_options_of_the_command_get_one_line_and_leave_nothing(tmp_path, options, parts):
    assert_one_clear_line(hydro("alarms", "--output", tmp_path / "new", *options), *parts)
    assert not (tmp_path / "new").exists()
