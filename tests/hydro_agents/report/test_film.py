"""Films keep time, show what they say, and leave nothing half-written."""

import gymnasium as gym
import numpy as np
import pytest
from command_line import hydro
from gymnasium.wrappers import RecordVideo
from PIL import Image

import hydro_env  # noqa: F401
from hydro_agents.learning.opponents import shipped
from hydro_agents.report.film import Panel, film, film_size, panel_frames, panels, write_film
from hydro_env import TaskConfig

CONFIG = TaskConfig(episode_duration=0.2)


@pytest.fixture(scope="module")
def pid():
    return shipped("pid", CONFIG)


def test_a_panel_shows_the_episode_of_the_environment(pid):
    pictures = list(panel_frames(CONFIG, Panel("PID", pid, 2.0), 5, {"reference": "step"}, 20))
    assert len(pictures) == 3  # at 0, 0.1 and 0.2 s
    env = gym.make("ServoHydraulic-v0", config=CONFIG, render_mode="rgb_array").unwrapped
    observation, _ = env.reset(seed=5, options={"reference": "step", "leakage_flow_lpm": 2.0})
    memory = None
    for _ in range(20):
        action, memory = pid.predict(observation, memory)
        observation, *_ = env.step(action)
    assert np.array_equal(env.render(), pictures[1])


def test_a_failed_axis_stays_and_the_film_goes_on():
    class Runaway:
        def predict(self, observation, state=None, episode_start=None, deterministic=True):
            return np.ones((1,), dtype=np.float32), None

    config = TaskConfig(episode_duration=1.0, failure={"pressure_rating": 60e5})
    pictures = list(panel_frames(config, Panel("runs away", Runaway(), None), 0, {"reference": "step"}, 50))
    assert len(pictures) == 5
    assert np.array_equal(pictures[-1], pictures[-2])
    assert not np.array_equal(pictures[0], pictures[1])


def test_the_grid_has_even_sides_and_all_panels(pid):
    shown = panels({"a": pid}, [0.0, 1.0, 2.0])
    (frame, *_) = film(CONFIG, shown, 1, {}, 40, 321, 2)
    assert frame.size == film_size(3, 321, 2)
    assert all(side % 2 == 0 for side in frame.size)
    grey = np.asarray(frame.convert("L"), dtype=float)
    half_y, half_x = grey.shape[0] // 2, grey.shape[1] // 2
    for part in (grey[:half_y, :half_x], grey[:half_y, half_x:], grey[half_y:, :half_x]):
        assert part.std() > 5.0
    assert grey[half_y + 4 :, half_x + 4 :].std() < 1.0  # the fourth place is empty


def test_a_film_holds_every_frame_for_its_time_and_one_interrupted_leaves_nothing(tmp_path):
    ffmpeg = pytest.importorskip("imageio_ffmpeg", reason="the extra 'video' brings it")
    path = tmp_path / "film.mp4"
    write_film(path, (Image.new("RGB", (64, 32), (10 * k, 0, 0)) for k in range(20)), 25.0)
    about = next(ffmpeg.read_frames(str(path)))
    assert about["fps"] == 25.0
    assert about["duration"] == pytest.approx(0.8, abs=0.05)

    def frames():
        yield Image.new("RGB", (64, 32))
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        write_film(tmp_path / "other.mp4", frames(), 25.0)
    assert [file.name for file in tmp_path.iterdir()] == ["film.mp4"]


def test_the_command_writes_a_film_and_refuses_what_it_cannot(tmp_path):
    path = tmp_path / "film.mp4"
    arguments = ["render", "-o", path, "--agent", "PID=pid", "--leakage", 0.01, "--leakage", 2, "--width", 320]
    done = hydro(*arguments, "--duration", 0.2)
    assert done.returncode == 0, done.stderr
    assert "6 frames of 320 × 98 pixels, 25 per second" in done.stdout
    for options, message in (
        (arguments, "exists; --overwrite"),
        (["render", "-o", tmp_path / "film.avi"], "must end in .mp4"),
        (["render", "-o", tmp_path / "none" / "film.mp4"], "folder that exists"),
        (["render", "-o", tmp_path / "b.mp4", *["--leakage", 1] * 7], "14 panels: must be at most 6"),
        (["render", "-o", tmp_path / "b.mp4", "--family", "waltz"], "waltz"),
    ):
        refused = hydro(*options)
        assert refused.returncode == 2
        assert message in refused.stderr
    assert [file.name for file in tmp_path.iterdir()] == ["film.mp4"]


def test_gymnasiums_recorder_writes_a_video(tmp_path):
    pytest.importorskip("moviepy", reason="the extra 'video' brings it")
    env = RecordVideo(
        gym.make("ServoHydraulic-v0", episode_duration=0.05, render_mode="rgb_array"),
        str(tmp_path),
        disable_logger=True,
    )
    env.reset(seed=0)
    over = False
    while not over:
        *_, over, _ = env.step(env.action_space.sample())
    env.close()
    (video,) = tmp_path.glob("*.mp4")
    assert video.stat().st_size > 1000
