import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from gymnasium.error import DependencyNotInstalled

from hydro_env import canvas, rendering
from hydro_env.rendering import AxisRenderer
from hydro_env.view import View

pygame = pytest.importorskip("pygame")

TIME = 0.005 * np.arange(401)
PISTON_ROW, LOAD_ROW, VALVE_ROW = 132, 104, 265


def make_view(**changes):
    view = View(
        time=2.0,
        position=0.02,
        velocity=0.05,
        reference=0.05,
        reference_preview=np.full(100, 0.05),
        pressure_a=30e5,
        pressure_b=40e5,
        supply_pressure=70e5,
        spool_position=0.2,
        command=0.3,
        leakage_flow_lpm=0.3,
        external_force=0.0,
        stroke=0.4,
        bore_diameter=0.040,
        rod_diameter=0.028,
        has_spring=True,
        history_time=TIME,
        history_position=0.02 * TIME / 2,
        history_reference=np.full(len(TIME), 0.05),
    )
    return replace(view, **changes)


def draw(**changes):
    return AxisRenderer("rgb_array").draw(make_view(**changes))


def where(picture, color):
    """The rows and columns of the pixels that have exactly this colour."""
    return np.nonzero((picture == np.array(color)).all(axis=-1))


def center(picture, row, color):
    (columns,) = where(picture[row], color)
    assert len(columns) > 0
    return columns.mean()


def test_the_first_picture_shows_the_whole_reference():
    start = {"time": 0.0, "history_time": TIME[:1], "history_position": TIME[:1], "history_reference": TIME[:1] + 0.05}
    _, columns = where(draw(**start, sample_interval=0.01), rendering.REFERENCE_COMING)
    assert np.ptp(columns) > 0.8 * (rendering.PLOT_RIGHT - rendering.PLOT_LEFT)


def test_frame_is_a_plain_array_of_its_own():
    renderer = AxisRenderer("rgb_array")
    first = renderer.draw(make_view())
    kept = first.copy()
    second = renderer.draw(make_view(position=-0.05))
    assert first.shape == (rendering.HEIGHT, rendering.WIDTH, 3)
    assert first.dtype == np.uint8
    assert first.flags.c_contiguous
    assert first.flags.writeable
    assert np.array_equal(first, kept)
    assert not np.array_equal(first, second)
    assert np.array_equal(renderer.draw(make_view()), first)


@pytest.mark.parametrize("position", [-0.2, -0.07, 0.0, 0.13, 0.2])
def test_piston_and_load_stand_at_the_true_position_on_the_scale_of_the_stroke(position):
    middle, moved = draw(position=0.0), draw(position=position)
    half = draw(position=position / 2, stroke=0.2)
    expected = position / 0.4 * rendering.STROKE_PIXELS
    for row, color in ((PISTON_ROW, rendering.PISTON), (LOAD_ROW, rendering.POSITION)):
        assert center(moved, row, color) - center(middle, row, color) == pytest.approx(expected, abs=1.0)
        assert center(half, row, color) == pytest.approx(center(moved, row, color), abs=1.0)


def test_oil_turns_from_blue_to_red_with_pressure_and_a_spring_shows_where_there_is_one():
    low, high = (draw(pressure_a=pressure)[PISTON_ROW, 100].astype(int) for pressure in (1e5, 68e5))
    assert low[2] > low[0]
    assert high[0] > high[2]
    between = [draw(has_spring=there)[115:150, 750:920] != np.array(canvas.PAPER) for there in (True, False)]
    assert between[0].any(axis=-1).sum() > 100
    assert not between[1].any()


@pytest.mark.parametrize("samples", [0, 1, 2, 20_000])
@pytest.mark.parametrize("coming", [0, 1, 20_000])
def test_any_length_of_history_and_extreme_values_can_be_drawn(samples, coming):
    past = {name: np.zeros(samples) for name in ("history_position", "history_reference")}
    extreme = {"pressure_a": -0.9e5, "pressure_b": 900e5, "supply_pressure": 600e5, "leakage_flow_lpm": 100.0}
    extreme |= {"position": 0.21, "reference": -0.5, "spool_position": -1.0, "command": 1.2}
    future = np.zeros(coming)
    picture = draw(history_time=0.001 * np.arange(samples), time=20.0, reference_preview=future, **past, **extreme)
    assert picture.std() > 0


def test_missing_pygame_and_an_unknown_mode_are_refused(monkeypatch):
    with pytest.raises(ValueError, match="ansi"):
        AxisRenderer("ansi")
    monkeypatch.setitem(sys.modules, "pygame", None)
    with pytest.raises(DependencyNotInstalled, match=r'pip install "hydro_env\[render\]"'):
        AxisRenderer("rgb_array")


@pytest.mark.parametrize("reference", [-0.12, 0.05, 0.15])
def test_reference_marker_is_on_the_scale_of_the_load(reference):
    rows = slice(100, 170)  # dashed, so that one row may fall into a gap
    marker = where(draw(reference=reference, position=reference + 0.03)[rows], rendering.REFERENCE)[1]
    load = center(draw(position=reference, reference=0.0), LOAD_ROW, rendering.POSITION)
    assert len(marker) > 0
    assert np.ptp(marker) <= 2
    assert marker.mean() == pytest.approx(load, abs=1.0)


def test_leak_arrow_grows_with_the_leak_and_points_to_the_lower_pressure():
    areas = [len(where(draw(leakage_flow_lpm=flow), rendering.LEAK)[0]) for flow in (0.0, 0.1, 0.3, 1.0, 4.0)]
    assert areas[0] == 0
    assert areas == sorted(set(areas))

    def heavy_side(picture):  # the head of the arrow holds the pixels farthest from the bore wall
        rows, columns = where(picture[:132], rendering.LEAK)
        return columns[rows == rows.max()].mean() - center(picture, PISTON_ROW, rendering.PISTON)

    assert heavy_side(draw(pressure_a=60e5, pressure_b=10e5)) > 0
    assert heavy_side(draw(pressure_a=10e5, pressure_b=60e5)) < 0
    assert len(where(draw(pressure_a=20e5, pressure_b=20e5), rendering.LEAK)[0]) == 0


def test_spool_moves_the_valve_symbol_by_a_box_at_full_stroke():
    def left_edge(spool):
        row = draw(spool_position=spool)[VALVE_ROW, :460]
        return np.nonzero((row != np.array(canvas.PAPER)).any(axis=-1))[0].min()

    assert left_edge(1.0) - left_edge(0.0) == pytest.approx(rendering.VALVE_BOX, abs=1)
    assert left_edge(0.0) - left_edge(-1.0) == pytest.approx(rendering.VALVE_BOX, abs=1)


def test_external_force_points_against_extension_when_positive():
    free, pushed, pulled = (draw(external_force=force)[100:112, 720:800] for force in (0.0, 2000.0, -2000.0))
    inks = [where(part, canvas.INK) for part in (pushed, pulled)]
    assert not np.array_equal(free, pushed)
    tall = [np.bincount(columns, minlength=80).argmax() for _, columns in inks]  # the head is the tallest part
    assert tall[0] < tall[1]


def test_plot_shows_history_and_what_is_coming():
    plot = slice(380, 505)
    usual = draw()
    later = draw(history_position=-0.03 * np.ones(len(TIME)))
    assert not np.array_equal(usual[plot], later[plot])
    assert np.array_equal(usual[:340], later[:340])
    assert len(where(usual[plot], rendering.REFERENCE_COMING)[0]) > 10
    assert len(where(draw(reference_preview=np.zeros(0))[plot], rendering.REFERENCE_COMING)[0]) == 0


def test_array_mode_opens_no_display(monkeypatch):
    pygame.display.quit()

    def refuse(*_):
        raise AssertionError("array mode must not touch the display")

    monkeypatch.setattr(pygame.display, "init", refuse)
    monkeypatch.setattr(pygame.display, "set_mode", refuse)
    renderer = AxisRenderer("rgb_array")
    assert renderer.draw(make_view()) is not None
    assert not pygame.display.get_init()
    renderer.close()
    renderer.close()
    assert not pygame.display.get_init()


def test_without_pygame_the_environment_has_no_mode_and_passes_the_checker_of_gymnasium():
    program = (
        "import sys; sys.modules['pygame'] = None\n"
        "import gymnasium as gym, hydro_env\n"
        "from gymnasium.utils.env_checker import check_env\n"
        "env = gym.make('ServoHydraulic-v0', episode_duration=0.05)\n"
        "assert env.metadata['render_modes'] == []\n"
        "check_env(env.unwrapped)\n"
    )
    result = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True)
    assert result.returncode == 0, result.stderr


def test_array_mode_needs_no_video_driver_and_no_system_fonts():
    program = (
        "import sys, hydro_env.rendering\n"
        "assert 'pygame' not in sys.modules\n"
        "from test_rendering import draw, rendering, where\n"
        "assert draw().std() > 0\n"
        "import pygame; assert not pygame.display.get_init()\n"
    )
    environment = {
        **os.environ,
        "PATH": "",
        "SDL_VIDEODRIVER": "none such",
        "PYTHONPATH": os.pathsep.join([str(Path(__file__).parent), *sys.path]),
    }
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
    assert not pygame.display.get_init()
    assert renderer.draw(make_view()) is None
    shown = np.swapaxes(pygame.surfarray.array3d(pygame.display.get_surface()), 0, 1)
    assert np.array_equal(shown, draw())
    if by_its_user:
        pygame.event.post(pygame.event.Event(pygame.QUIT))
        assert [renderer.draw(make_view()) for _ in range(2)] == [None, None]
        assert not pygame.display.get_init()
    renderer.close()
    renderer.close()
    assert not pygame.display.get_init()
