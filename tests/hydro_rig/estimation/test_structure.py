"""Parts that the file of a rig does not tell are found where the readings ask for them, and the leak beside them."""

import numpy as np
import pytest

from hydro_agents.detection.detector import HALF_WIDTH, Windows
from hydro_agents.learning.loading import shipped
from hydro_agents.running.cases import Cases
from hydro_env import TaskConfig
from hydro_env.plant.states import Structure
from hydro_env.task.configuration import task_config
from hydro_env.task.sensors import PRESSURE_A, SENSORS
from hydro_rig.estimation.estimator import EstimatorDetector
from hydro_rig.estimation.known_windows import known_windows
from hydro_rig.estimation.model import Model
from hydro_rig.estimation.structure import Part
from hydro_rig.estimation.unknowns import LEAKAGE, priors_of

CONFIG = TaskConfig()
TIP = {"load": {"tip_share": 0.8, "tip_frequency": 40.0, "tip_damping_ratio": 0.01}}
LINES = {"lines": {"volume_a": 4e-4, "volume_b": 4e-4, "length_a": 3.0, "length_b": 3.0}}
SEAL = {"friction": {"model": "lugre", "bristle_stiffness": 1e6, "bristle_damping": 2e3}}


def windows(plant, leak=0.1, **sensors):
    """A window of 2 s of an axis whose plant has these parts."""
    config = task_config(CONFIG, plant=plant, sensors=sensors)
    cases = Cases(np.array([90_220_000]), np.array([leak]), np.array(["multi_sine"]))
    return config, known_windows(config, shipped("pid", config), cases, 0.5, 2.0)


def test_the_model_of_an_axis_with_every_part_is_what_the_environment_does():
    config, known = windows(TIP | LINES, enabled=False, pressures_at="valve")
    model = Model(config, priors_of(config, (LEAKAGE,)), known.signals[:, -1], known.physical, known.start)
    assert model.structure == Structure(lines=True, tip=True)
    read = model.readings(model.prior.scaled(known.leakage_flow_lpm[:, None])) * model.noise[:, None]
    signals = known.signals[:, : len(SENSORS)]
    np.testing.assert_allclose(read, signals, rtol=1e-9, atol=1e-9)
    rigid = Model(CONFIG, priors_of(CONFIG, (LEAKAGE,)), known.signals[:, -1], known.physical, known.start)
    other = rigid.readings(rigid.prior.scaled(known.leakage_flow_lpm[:, None])) * rigid.noise[:, None]
    assert np.abs(other - read)[:, PRESSURE_A].max() > 0.05 * np.ptp(signals[:, PRESSURE_A])


@pytest.mark.parametrize(("plant", "part"), [(SEAL, Part.SEAL), ({}, None)], ids=["seal", "none"])
def test_a_part_is_found_without_the_file_and_the_leak_beside_it(plant, part):
    _, known = windows(plant)
    reading, found = EstimatorDetector(restarts=0).read_and_fit(Windows.of(known.signals), CONFIG)
    assert found.parts.tolist() == [() if part is None else (part,)]
    deviation = (reading.high_lpm[0] - reading.low_lpm[0]) / (2.0 * HALF_WIDTH)
    assert deviation < 0.02
    assert reading.flow_lpm[0] == pytest.approx(0.1, abs=3.0 * deviation)
    assert not reading.fault.any()
