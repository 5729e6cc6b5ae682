"""The picture shows the numbers that it is given, at their place; without pygame or a display nothing else suffers."""

import os
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest

from hydro_env import PlantParameters, rendering
from hydro_env.plant.states import State
from hydro_env.rendering import AxisRenderer, View

TIME = 0.005 * np.arange(401)
VIEW = View(
    time=2.0,
    state=State(0.02, 0.05, 30e5, 40e5, 0.2, 0.0, 0.5, 70e5, 1e-3, 0.0),
    reference=0.05,
    command=0.3,
    leakage_flow_lpm=0.3,
    external_force=0.0,
    cylinder=PlantParameters().cylinder,
    has_spring=True,
    period=0.005,
    past=np.stack([0.01 * TIME, np.full(401, 0.05)], axis=1),
    coming=np.full(100, 0.05),
)
PISTON_ROW, LOAD_ROW, PLOT = 150, 120, slice(310, 505)


@pytest.fixture(scope="module")
def renderer():
    return AxisRenderer("rgb_array")


def draw(renderer, **changes):
    """The picture with changes of the view or of its state."""
    state = {name: changes.pop(name) for name in State._fields if name in changes}
    return renderer.draw(replace(VIEW, state=VIEW.state._replace(**state), **changes))


def where(picture, color):
    """The rows and columns of the pixels that have exactly this colour."""
    return np.nonzero((picture == np.array(color)).all(axis=-1))


def center(picture, row, color):
    (columns,) = where(picture[row], color)
    assert len(columns) > 0
    return columns.mean()


@pytest.mark.parametrize("position", [-0.2, 0.13])
def test_piston_load_and_reference_stand_on_the_scale_of_the_stroke(renderer, position):
    middle, moved = draw(renderer, position=0.0), draw(renderer, position=position)
    expected = position / 0.4 * rendering.STROKE_PIXELS
    for row, color in ((PISTON_ROW, rendering.PISTON), (LOAD_ROW, rendering.POSITION)):
        assert center(moved, row, color) - center(middle, row, color) == pytest.approx(expected, abs=1.5)
    wanted = center(draw(renderer, position=0.1, reference=position), 100, rendering.REFERENCE)
    load = center(draw(renderer, position=position, reference=0.1), LOAD_ROW, rendering.POSITION)
    assert wanted == pytest.approx(load, abs=1)


def test_the_leak_arrow_grows_with_the_leak_and_points_to_the_lower_pressure(renderer):
    flows = (0.0, 0.1, 0.3, 1.0, 4.0)
    areas = [len(where(draw(renderer, leakage_flow_lpm=flow), rendering.LEAK)[0]) for flow in flows]
    assert areas[0] == 0
    assert areas == sorted(set(areas))
    for higher, lower, side in (("pressure_a", "pressure_b", 1), ("pressure_b", "pressure_a", -1)):
        picture = draw(renderer, **{higher: 60e5, lower: 10e5})
        rows, columns = where(picture[:150], rendering.LEAK)
        head = columns[rows == rows.max()].mean()  # it holds the pixels farthest from the bore wall
        assert side * (head - center(picture, PISTON_ROW, rendering.PISTON)) > 0


WITHOUT = """
import sys
import gymnasium as gym, hydro_env.rendering
env = gym.make('ServoHydraulic-v0', render_mode='rgb_array')
assert 'pygame' not in sys.modules
env.reset(seed=0)
assert env.render().std() > 0
import pygame; assert not pygame.display.get_init()
del sys.modules['hydro_env.env']; sys.modules['pygame'] = None
from hydro_env.env import ServoHydraulicEnv
assert ServoHydraulicEnv().metadata['render_modes'] == []
"""


def test_neither_pygame_nor_a_display_nor_fonts_are_needed():
    environment = {**os.environ, "PATH": "", "SDL_VIDEODRIVER": "none such", "PYTHONPATH": os.pathsep.join(sys.path)}
    result = subprocess.run([sys.executable, "-c", WITHOUT], env=environment, capture_output=True, text=True)
    assert result.returncode == 0, result.stderr
    assert "font" not in result.stderr.lower()
