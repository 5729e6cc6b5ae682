"""Films of the same episode under several controllers and leaks, one panel each, as MP4."""

from __future__ import annotations

import math
import os
from collections.abc import Iterator, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass
from importlib.util import find_spec
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from hydro_agents.controllers.base import Controller
from hydro_env import ConfigurationError, ServoHydraulicEnv, TaskConfig
from hydro_env.canvas import HEIGHT, INK, PAPER, WIDTH

Pixels = NDArray[np.uint8]

TITLE, TITLE_SIZE = 44, 24
"""Height of the strip above each panel and size of its text, in pixels of a full panel."""


@dataclass(frozen=True)
class Panel:
    """One axis of the film."""

    title: str
    controller: Controller
    leakage_flow_lpm: float | None  # l/min at 100 bar; None: drawn


def panels(controllers: Mapping[str, Controller], leaks: Sequence[float]) -> list[Panel]:
    """Every controller with every leak; without ``leaks``, with the leak that the episode draws."""
    return [
        Panel(name if leak is None else f"{name}, leak of {leak:g} l/min", controller, leak)
        for name, controller in controllers.items()
        for leak in (leaks or (None,))
    ]


def panel_frames(
    config: TaskConfig, panel: Panel, seed: int, options: Mapping[str, Any], periods_per_frame: int
) -> Iterator[Pixels]:
    """Pictures (540, 960, 3) of an episode, the first at its start; a failed axis keeps its last picture.

    Args:
        config: the task.
        panel: controller and leak.
        seed: of plant, reference and noise.
        options: of ``reset``, except the leak.
        periods_per_frame: control periods from one picture to the next.
    """
    leak = {} if panel.leakage_flow_lpm is None else {"leakage_flow_lpm": panel.leakage_flow_lpm}
    with ServoHydraulicEnv(config, render_mode="rgb_array") as env:
        observation, _ = env.reset(seed=seed, options={**options, **leak})
        memory, over = None, False
        for step in range(config.steps + 1):
            if step % periods_per_frame == 0:
                picture = env.render()
                assert picture is not None
                yield picture
            if not over:
                action, memory = panel.controller.predict(observation, memory)
                observation, _, failed, ended, _ = env.step(action)
                over = failed or ended


def film(
    config: TaskConfig,
    shown: Sequence[Panel],
    seed: int,
    options: Mapping[str, Any],
    periods_per_frame: int,
    width: int,
    columns: int,
) -> Iterator[Image.Image]:
    """Frames of the film: the panels in a grid, row by row; see :func:`panel_frames`.

    Args:
        config: the task.
        shown: the panels.
        seed: of plant, reference and noise, the same for all panels.
        options: of ``reset``, except the leak.
        periods_per_frame: control periods from one frame to the next.
        width: of the film in pixels.
        columns: number of panels side by side.
    """
    size = film_size(len(shown), width, columns)
    letters = ImageFont.load_default(size=TITLE_SIZE)
    whole = Image.new("RGB", (columns * WIDTH, math.ceil(len(shown) / columns) * (TITLE + HEIGHT)), PAPER)
    episodes = [panel_frames(config, panel, seed, options, periods_per_frame) for panel in shown]
    places = [(count % columns * WIDTH, count // columns * (TITLE + HEIGHT)) for count in range(len(shown))]
    for panel, (x, y) in zip(shown, places, strict=True):
        ImageDraw.Draw(whole).text((x + 34, y + TITLE / 2), panel.title, INK, letters, anchor="lm")
    for pictures in zip(*episodes, strict=True):
        for picture, (x, y) in zip(pictures, places, strict=True):
            whole.paste(Image.fromarray(picture), (x, y + TITLE))
        yield whole.resize(size, Image.Resampling.LANCZOS)


def film_size(panel_count: int, width: int, columns: int) -> tuple[int, int]:
    """Width and height in pixels, both even, as codecs require."""
    height = width * math.ceil(panel_count / columns) * (HEIGHT + TITLE) / (columns * WIDTH)
    return width // 2 * 2, round(height / 2) * 2


def write_film(path: Path, frames: Iterator[Image.Image], frames_per_second: float) -> None:
    """Write a film as MP4; the file appears when it is complete.

    Args:
        path: the file.
        frames: all of the same size.
        frames_per_second: their rate.

    Raises:
        ConfigurationError: the file cannot be written.
    """
    import imageio_ffmpeg

    unfinished = path.with_name(f".unfinished-{path.name}")
    options = {"codec": "libx264", "quality": 7, "macro_block_size": 2, "ffmpeg_log_level": "error"}
    try:
        first = next(frames)
        film = imageio_ffmpeg.write_frames(str(unfinished), first.size, fps=frames_per_second, **options)
        film.send(None)  # starts the encoder
        with closing(film):
            for frame in chain([first], frames):
                film.send(np.ascontiguousarray(frame))
        os.replace(unfinished, path)
    except OSError as error:
        raise ConfigurationError(f"{path}: cannot be written: {error.strerror or error}") from error
    finally:
        unfinished.unlink(missing_ok=True)


def check_encoder() -> None:
    """Check that a film can be written, before any work.

    Raises:
        ConfigurationError: the package that brings ffmpeg is missing.
    """
    if find_spec("imageio_ffmpeg") is None:
        raise ConfigurationError('a film needs ffmpeg: pip install "hydro_env[video]"')
