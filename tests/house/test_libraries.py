"""What other people's libraries take of this project; docs/own_controller.md lists them."""

import numpy as np
import pytest

from hydro_env import PlantParameters, linearise


def test_control_libraries_take_the_linearised_axis():
    plant = PlantParameters().replace(friction={"model": "none"})
    a, b, c, d = linearise(plant, position=0.02).state_space(outputs=("position", "velocity")).matrices
    at_rest = d - c @ np.linalg.solve(a, b)
    assert np.linalg.eigvals(a).real.max() < 0.0
    assert at_rest[1, 0] == pytest.approx(0.0, abs=1e-9)
    assert np.isfinite(at_rest).all()
