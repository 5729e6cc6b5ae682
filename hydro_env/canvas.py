"""A drawing surface with smooth edges and text, on pygame without a display."""

from __future__ import annotations

import math
import os
import warnings
from collections.abc import Sequence
from itertools import pairwise
from typing import TYPE_CHECKING, TypeAlias

import numpy as np
from gymnasium.error import DependencyNotInstalled
from numpy.typing import NDArray

if TYPE_CHECKING:
    import pygame

Color: TypeAlias = tuple[int, int, int]
Points: TypeAlias = Sequence[tuple[float, float]] | NDArray[np.floating]

WIDTH, HEIGHT = 960, 540
SUPERSAMPLING = 2
FONTS = "dejavusans,liberationsans,notosans,arial,helvetica,segoeui"
PAPER, INK = (250, 250, 248), (38, 46, 56)


class Canvas:
    """Draws enlarged shapes and scales them down for smooth edges; text is added at its true size."""

    def __init__(self) -> None:
        os.environ.setdefault("PYGAME_HIDE_SUPPORT_PROMPT", "1")  # suppresses pygame's greeting
        try:
            import pygame
            import pygame.freetype
        except ImportError as error:
            raise DependencyNotInstalled('pygame is not installed, run `pip install "hydro_env[render]"`') from error
        pygame.freetype.init()
        with warnings.catch_warnings():  # pygame warns if there are no system fonts, and uses its own
            warnings.simplefilter("ignore")
            self._font = pygame.freetype.SysFont(FONTS, 13)
        self._font.origin = True
        self._shapes, self._scale_down = pygame.draw, pygame.transform.smoothscale
        self._large = pygame.Surface((WIDTH * SUPERSAMPLING, HEIGHT * SUPERSAMPLING))
        self._small = pygame.Surface((WIDTH, HEIGHT))
        self._texts: list[tuple[str, float, float, Color, float]] = []

    def clear(self) -> None:
        """Begin a new picture."""
        self._large.fill(PAPER)
        self._texts.clear()

    def finish(self) -> pygame.Surface:
        """The picture at its true size."""
        self._scale_down(self._large, (WIDTH, HEIGHT), self._small)
        for text, left, baseline, color, size in self._texts:
            self._font.render_to(self._small, (round(left), round(baseline)), text, color, size=size)
        return self._small

    def text(self, text: str, x: float, y: float, color: Color = INK, size: float = 12, align: float = 0) -> None:
        """``y`` is the baseline; ``align`` is 0 left, 0.5 centred, 1 right; text after ``_`` is a subscript."""
        head, _, subscript = text.partition("_")
        width = self._font.get_rect(head, size=size).width
        self._texts.append((head, x - align * width, y, color, size))
        if subscript:
            self.text(subscript, x + width + 1, y + 3, color, size - 2)

    def line(self, points: Points, color: Color = INK, width: float = 1) -> None:
        """A line through points."""
        if len(points) > 1:
            self._shapes.lines(self._large, color, False, _enlarged(points), max(1, round(width * SUPERSAMPLING)))

    def dashed(self, points: Points, color: Color, width: float, dash: float = 6, gap: float = 4) -> None:
        """A dashed line through points."""
        corners = np.asarray(points, dtype=float)
        along = np.concatenate(([0.0], np.cumsum(np.hypot(*np.diff(corners, axis=0).T))))
        for start in np.arange(0.0, along[-1], dash + gap):
            end = min(start + dash, along[-1])
            stations = np.concatenate(([start], along[(along > start) & (along < end)], [end]))
            pieces = [np.interp(stations, along, corners[:, axis]) for axis in (0, 1)]
            self.line(np.stack(pieces, axis=1), color, width)

    def polygon(self, points: Points, fill: Color, outline: Color | None = None) -> None:
        """A filled polygon."""
        self._shapes.polygon(self._large, fill, _enlarged(points))
        if outline is not None:
            self._shapes.polygon(self._large, outline, _enlarged(points), SUPERSAMPLING)

    def box(self, x: float, y: float, x_end: float, y_end: float, fill: Color, outline: Color | None = INK) -> None:
        """A filled rectangle."""
        left, top, right, bottom = (round(SUPERSAMPLING * edge) for edge in (x, y, x_end, y_end))
        area = (left, top, max(0, right - left), max(0, bottom - top))
        self._shapes.rect(self._large, fill, area)
        if outline is not None:
            self._shapes.rect(self._large, outline, area, SUPERSAMPLING)

    def circle(self, x: float, y: float, radius: float, fill: Color) -> None:
        """A filled circle with an outline."""
        for color, size in ((INK, radius), (fill, radius - 1)):
            self._shapes.circle(self._large, color, (SUPERSAMPLING * x, SUPERSAMPLING * y), SUPERSAMPLING * size)

    def arrow(self, x: float, y: float, x_end: float, y_end: float, width: float, fill: Color = INK) -> None:
        """A filled arrow."""
        length = math.hypot(x_end - x, y_end - y)
        cosine, sine = (x_end - x) / length, (y_end - y) / length
        shaft, wing = width / 2, width / 2 + 2.5
        neck = length - min(0.7 * length, 2 * wing)
        shape = [(0, shaft), (neck, shaft), (neck, wing), (length, 0), (neck, -wing), (neck, -shaft), (0, -shaft)]
        self.polygon([(x + r * cosine - s * sine, y + r * sine + s * cosine) for r, s in shape], fill, INK)

    def pipe(self, points: Points, fill: Color) -> None:
        """A pipe of straight runs along x or y; both ends extend by 3 px, under the connected parts."""
        for color, half in ((INK, 3.0), (fill, 2.0)):
            for (x, y), (x_end, y_end) in pairwise(points):
                left, right, top, bottom = min(x, x_end), max(x, x_end), min(y, y_end), max(y, y_end)
                self.box(left - half, top - half, right + half, bottom + half, color, None)


def _enlarged(points: Points) -> list[tuple[float, float]]:
    return [(float(x) * SUPERSAMPLING, float(y) * SUPERSAMPLING) for x, y in points]
