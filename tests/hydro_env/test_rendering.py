"""The picture shows the numbers that it is given, at their place; without pygame or a display nothing else suffers."""

import os
import subprocess
import sys

import numpy as np
import pytest

from hydro_env import rendering
from hydro_env.env import ServoHydraulicEnv
from hydro_env.plant.states import State

STATE = State(0.02, 0.05, 30e5, 40e5, 0.2, 0.0, 0.5, 70e5, 1e-3, 0.0)
PISTON_ROW, LOAD_ROW = 150, 120


@pytest.fixture(scope="module")
def env():
    env = ServoHydraulicEnv(render_mode="rgb_array")
    env.reset(seed=0)
    return env


def draw(env, reference=0.05, leak_flow=0.3, **state):
    """The picture of an axis with changes of its state."""
    env.axes.state[0] = STATE._replace(**state)
    env.axes.record["reference"], env.axes.record["leak_flow"] = reference, leak_flow
    return env.render()


def where(picture, color):
    """The rows and columns of the pixels that have exactly this colour."""
    return np.nonzero((picture == np.array(color)).all(axis=-1))


def center(picture, row, color):
    (columns,) = where(picture[row], color)
    assert len(columns) > 0
    return columns.mean()


@pytest.mark.parametrize("position", [-0.2, 0.13])
def test_piston_load_and_reference_stand_on_the_scale_of_the_stroke(env, position):
    middle, moved = draw(env, position=0.0), draw(env, position=position)
    expected = position / 0.4 * rendering.STROKE_PIXELS
    for row, color in ((PISTON_ROW, rendering.PISTON), (LOAD_ROW, rendering.POSITION)):
        assert center(moved, row, color) - center(middle, row, color) == pytest.approx(expected, abs=1.5)
    wanted = center(draw(env, position=0.1, reference=position), 100, rendering.REFERENCE)
    load = center(draw(env, position=position, reference=0.1), LOAD_ROW, rendering.POSITION)
    assert wanted == pytest.approx(load, abs=1)


def test_the_leak_arrow_grows_with_the_leak_and_points_to_the_lower_pressure(env):
    flows = (0.0, 0.1, 0.3, 1.0, 4.0)
    areas = [len(where(draw(env, leak_flow=flow), rendering.LEAK)[0]) for flow in flows]
    assert areas[0] == 0
    assert areas == sorted(set(areas))
    for higher, lower, side in (("pressure_a", "pressure_b", 1), ("pressure_b", "pressure_a", -1)):
        picture = draw(env, **{higher: 60e5, lower: 10e5})
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
