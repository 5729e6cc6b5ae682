"""The detectors of the project as the protocol reads them."""

import numpy as np
import pytest

from hydro_agents.detection.detectors import EXTERNAL, NONE, RETURN, SENSOR, VALVE, DetectorChoice, logit
from hydro_agents.detection.readers import EstimatorReader, HeadReader, make_detector, named_fault
from hydro_agents.estimation.unknowns import default_unknowns, priors_of
from hydro_env import ConfigurationError, TaskConfig
from hydro_env.files import validate

CONFIG = TaskConfig()
MORE = ("valve.null_shift", "supply.tank_pressure")


class Found:
    """An estimate with one unknown far from its prior and all others at theirs."""

    def __init__(self, name, shift):
        self.names = (*default_unknowns(CONFIG), *MORE)
        self.priors = priors_of(CONFIG, self.names)
        self.odd, self.shift = name, shift

    def __len__(self):
        return 1

    def value(self, name):
        prior = self.priors[name]
        shift = self.shift * prior.deviation if name == self.odd else 0.0
        return np.array([prior.mean * np.exp(shift) if prior.logarithmic else prior.mean + shift])

    def deviation(self, name):
        prior = self.priors[name]
        return np.array([1e-3 * prior.deviation * (self.value(name)[0] if prior.logarithmic else 1.0)])


@pytest.mark.parametrize(
    ("name", "shift", "verdict"),
    [
        ("valve.null_shift", 1.0, VALVE),
        ("valve.null_shift", 0.3, NONE),
        ("valve.rated_flow", -4.0, VALVE),
        ("valve.underlap", 3.0, VALVE),
        ("valve.rated_flow", 1.0, NONE),
        ("supply.tank_pressure", 2.0, RETURN),
        ("spool_position_bias", 4.0, SENSOR),
        ("spool_position_bias", -1.5, NONE),
        ("external_leakage_flow_lpm", 20.0, EXTERNAL),
        ("load.mass", 5.0, NONE),
        ("leakage_flow_lpm", 1.0, NONE),
    ],
)
def test_an_unknown_far_outside_its_range_names_the_fault(name, shift, verdict):
    assert named_fault(Found(name, shift), CONFIG).tolist() == [verdict]


def test_the_shipped_head_reads_the_windows_of_its_task_and_no_others():
    reader = make_detector(DetectorChoice(kind="head"))
    assert isinstance(reader, HeadReader)
    assert reader.refuses(CONFIG, 400) == ""
    assert "windows of" in reader.refuses(CONFIG, 20)
    other = TaskConfig(control_period=0.01)
    assert "another rig" in reader.refuses(other, 400)
    assert np.isfinite(reader.threshold)


def test_a_detector_of_ones_own_is_named_by_module_and_attribute():
    reader = make_detector(DetectorChoice(kind="small_leaks:Spread"))
    assert (type(reader).__name__, reader.refuses(CONFIG, 60)) == ("Spread", "")
    with pytest.raises(ConfigurationError, match="is no leak detector, it has no threshold, refuses, read"):
        make_detector(DetectorChoice(kind="small_leaks:SMALL"))
    with pytest.raises(ConfigurationError, match="has no 'Absent'"):
        make_detector(DetectorChoice(kind="small_leaks:Absent"))
    with pytest.raises(ConfigurationError, match="kind = 'network': must be head, estimator, or module:attribute"):
        validate(DetectorChoice, {"kind": "network"}, "own.yaml")


def test_the_estimator_reads_everything():
    reader = make_detector(
        DetectorChoice(kind="estimator", task={"faults": {"valve_null_shift": {"probability": 0.1}}})
    )
    assert isinstance(reader, EstimatorReader)
    assert reader.refuses(TaskConfig(control_period=0.01), 10) == ""
    assert reader.threshold is None


def test_the_logit_of_certainty_is_finite():
    assert np.isfinite(logit(np.array([0.0, 1.0]))).all()
    assert logit(np.array([0.5]))[0] == 0.0
