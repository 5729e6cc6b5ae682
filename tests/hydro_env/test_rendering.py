"""The picture shows the numbers that it is given, at their place; without pygame or a display nothing else suffers."""

import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.error import DependencyNotInstalled

from hydro_env import PlantParameters, rendering
from hydro_env.plant.states import State
from hydro_env.rendering import AxisRenderer, View

pygame = pytest.importorskip("pygame")

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
PISTON_ROW, LOAD_ROW = 150, 120


def draw(renderer=None, **changes):
    """The picture with changes of the view or of its state."""
    state = {name: changes.pop(name) for name in State._fields if name in changes}
    view = replace(VIEW, state=VIEW.state._replace(**state), **changes)
    return (renderer or AxisRenderer("rgb_array")).draw(view)


def where(picture, color):
    """The rows and columns of the pixels that have exactly this colour."""
    return np.nonzero((picture == np.array(color)).all(axis=-1))


def center(picture, row, color):
    (columns,) = where(picture[row], color)
    assert len(columns) > 0
    return columns.mean()


def test_a_frame_is_an_array_of_its_own():
    renderer = AxisRenderer("rgb_array")
    first = draw(renderer)
    kept = first.copy()
    second = draw(renderer, position=-0.05)
    assert first.shape == (rendering.HEIGHT, rendering.WIDTH, 3)
    assert first.dtype == np.uint8
    assert first.flags.writeable
    assert np.array_equal(first, kept)
    assert not np.array_equal(first, second)
    assert np.array_equal(draw(renderer), first)


@pytest.mark.parametrize("position", [-0.2, 0.13])
def test_piston_load_and_reference_stand_on_the_scale_of_the_stroke(position):
    middle, moved = draw(position=0.0), draw(position=position)
    expected = position / 0.4 * rendering.STROKE_PIXELS
    for row, color in ((PISTON_ROW, rendering.PISTON), (LOAD_ROW, rendering.POSITION)):
        assert center(moved, row, color) - center(middle, row, color) == pytest.approx(expected, abs=1.0)
    wanted = center(draw(position=0.1, reference=position), 100, rendering.REFERENCE)
    assert wanted == pytest.approx(center(draw(position=position, reference=0.1), LOAD_ROW, rendering.POSITION), abs=1)


@pytest.mark.parametrize(("samples", "coming"), [(1, 20_000), (2, 1), (20_000, 0)])
def test_any_length_of_history_and_extreme_values_can_be_drawn(samples, coming):
    extreme = {"pressure_a": -0.9e5, "pressure_b": 900e5, "supply_pressure": 600e5, "leakage_flow_lpm": 100.0}
    extreme |= {"position": 0.21, "reference": -0.5, "spool_position": -1.0, "command": 1.2}
    assert draw(past=np.zeros((samples, 2)), coming=np.zeros(coming), time=20.0, **extreme).std() > 0


def test_the_leak_arrow_grows_with_the_leak_and_points_to_the_lower_pressure():
    areas = [len(where(draw(leakage_flow_lpm=flow), rendering.LEAK)[0]) for flow in (0.0, 0.1, 0.3, 1.0, 4.0)]
    assert areas[0] == 0
    assert areas == sorted(set(areas))

    def heavy_side(picture):  # the head of the arrow holds the pixels farthest from the bore wall
        rows, columns = where(picture[:150], rendering.LEAK)
        return columns[rows == rows.max()].mean() - center(picture, PISTON_ROW, rendering.PISTON)

    assert heavy_side(draw(pressure_a=60e5, pressure_b=10e5)) > 0
    assert heavy_side(draw(pressure_a=10e5, pressure_b=60e5)) < 0


def test_the_plot_shows_history_and_what_is_coming():
    plot = slice(310, 505)
    usual, later = draw(), draw(past=np.full((401, 2), -0.03))
    assert not np.array_equal(usual[plot], later[plot])
    assert np.array_equal(usual[:290], later[:290])
    assert len(where(usual[plot], rendering.REFERENCE_COMING)[0]) > 10
    assert len(where(draw(coming=np.zeros(0))[plot], rendering.REFERENCE_COMING)[0]) == 0


def test_missing_pygame_and_an_unknown_mode_are_refused(monkeypatch):
    with pytest.raises(ValueError, match="ansi"):
        AxisRenderer("ansi")
    monkeypatch.setitem(sys.modules, "pygame", None)
    with pytest.raises(DependencyNotInstalled, match=r'pip install "hydro_env\[render\]"'):
        AxisRenderer("rgb_array")


WITHOUT_PYGAME = """
import sys; sys.modules['pygame'] = None
import gymnasium as gym, hydro_env
from gymnasium.utils.env_checker import check_env
env = gym.make('ServoHydraulic-v0', episode_duration=0.05)
assert env.metadata['render_modes'] == []
check_env(env.unwrapped)
"""
WITHOUT_DISPLAY = """
import sys, hydro_env.rendering
assert 'pygame' not in sys.modules
from test_rendering import draw
assert draw().std() > 0
import pygame; assert not pygame.display.get_init()
"""


@pytest.mark.parametrize("program", [WITHOUT_PYGAME, WITHOUT_DISPLAY])
def test_neither_pygame_nor_a_display_nor_fonts_are_needed(program):
    paths = os.pathsep.join([str(Path(__file__).parent), *sys.path])
    environment = {**os.environ, "PATH": "", "SDL_VIDEODRIVER": "none such", "PYTHONPATH": paths}
    result = subprocess.run([sys.executable, "-c", program], env=environment, capture_output=True, text=True)
    assert result.returncode == 0, result.stderr
    assert "font" not in result.stderr.lower()


@pytest.fixture
def dummy_video(monkeypatch):
    pygame.display.quit()
    monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")
    yield
    pygame.display.quit()


@pytest.mark.usefixtures("dummy_video")
@pytest.mark.parametrize("by_its_user", [True, False])
def test_a_window_shows_the_same_picture_and_stays_closed(by_its_user):
    renderer = AxisRenderer("human")
    assert draw(renderer) is None
    shown = np.swapaxes(pygame.surfarray.array3d(pygame.display.get_surface()), 0, 1)
    assert np.array_equal(shown, draw())
    if by_its_user:
        pygame.event.post(pygame.event.Event(pygame.QUIT))
        assert [draw(renderer) for _ in range(2)] == [None, None]
    renderer.close()
    renderer.close()
    assert not pygame.display.get_init()


@pytest.mark.usefixtures("dummy_video")
def test_a_window_follows_simulated_time(monkeypatch):
    waited = []
    monkeypatch.setattr(AxisRenderer, "_show", lambda self, surface, frame_time: waited.append(frame_time))
    with gym.make("ServoHydraulic-v0", control_period=0.01, render_mode="human") as env:
        assert env.metadata["render_fps"] == 100  # what recorders of each step need
        env.reset(seed=0)
        for _ in range(20):
            env.step(np.zeros(1))
    assert waited == pytest.approx([0.02] * 11)
