"""Writes films: GIF and WebP by Pillow, MP4 by the ffmpeg that ``imageio-ffmpeg`` brings."""

from __future__ import annotations

import os
from collections.abc import Iterator
from itertools import chain
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from PIL import Image

from hydro_env import ConfigurationError

FORMATS = (".mp4", ".gif", ".webp")

GIF_COLOURS = 96
GIF_TICK = 10  # ms; durations in a GIF are multiples of it


class Rate(NamedTuple):
    """Frames of a film."""

    periods_per_frame: int
    milliseconds: float  # duration of a frame


def frame_rate(path: Path, control_period: float, frames_per_second: float, speed: float) -> Rate:
    """The rate nearest to the desired one with exact durations in the file's format and frames at samples.

    Args:
        path: of the film; its ending sets the format.
        control_period: s
        frames_per_second: desired rate.
        speed: simulated seconds per second of film.

    Raises:
        ConfigurationError: the format has no such rate.
    """
    ideal = speed / (frames_per_second * control_period)
    tick = {".gif": GIF_TICK, ".webp": 1}.get(path.suffix.lower(), 0)
    for periods in sorted(range(1, int(4 * ideal) + 40), key=lambda count: abs(count - ideal)):
        shown = 1e3 * periods * control_period / speed
        if not tick or (shown >= tick and abs(shown / tick - round(shown / tick)) < 1e-6):
            return Rate(periods, shown)
    raise ConfigurationError(
        f"{path.name}: a frame in this format lasts a whole multiple of {tick} ms, but no multiple of the control "
        f"period ({1e3 * control_period:g} ms at {speed:g} times the speed) does; write MP4"
    )


def write_film(path: Path, frames: Iterator[Image.Image], milliseconds: float) -> None:
    """Write a film; the file appears when it is complete.

    Args:
        path: the file; its ending sets the format.
        frames: all of the same size.
        milliseconds: duration of each frame.

    Raises:
        ConfigurationError: MP4 needs ``imageio-ffmpeg``, or the file cannot be written.
    """
    unfinished = path.with_name(f".unfinished-{path.name}")
    try:
        if path.suffix.lower() == ".mp4":
            _write_mp4(unfinished, frames, milliseconds)
        else:
            _write_loop(unfinished, frames, milliseconds)
        os.replace(unfinished, path)
    except OSError as error:
        raise ConfigurationError(f"{path}: cannot be written: {error.strerror or error}") from error
    finally:
        unfinished.unlink(missing_ok=True)


def _write_loop(path: Path, frames: Iterator[Image.Image], milliseconds: float) -> None:
    first = next(frames)
    options: dict[str, Any] = {"save_all": True, "duration": round(milliseconds), "loop": 0}
    if path.suffix.lower() == ".gif":
        octree = Image.Quantize.FASTOCTREE  # keeps the colours of small things, such as the arrows of the leak
        later = (frame.quantize(GIF_COLOURS, octree) for frame in frames)
        first.quantize(GIF_COLOURS, octree).save(path, append_images=later, optimize=True, **options)
    else:
        first.save(path, append_images=frames, quality=70, method=4, **options)


def check_mp4() -> None:
    """Check that MP4 can be written, before any work.

    Raises:
        ConfigurationError: the package that brings ffmpeg is missing.
    """
    try:
        import imageio_ffmpeg  # noqa: F401
    except ImportError:
        raise ConfigurationError('MP4 needs ffmpeg: pip install "hydro_env[video]"; GIF and WebP do not') from None


def _write_mp4(path: Path, frames: Iterator[Image.Image], milliseconds: float) -> None:
    import imageio_ffmpeg

    first = next(frames)
    film = imageio_ffmpeg.write_frames(
        str(path),
        first.size,
        fps=1e3 / milliseconds,
        codec="libx264",
        quality=7,
        macro_block_size=2,
        ffmpeg_log_level="error",
    )
    film.send(None)  # starts the encoder
    try:
        for frame in chain([first], frames):
            film.send(np.ascontiguousarray(frame))
    finally:
        film.close()
