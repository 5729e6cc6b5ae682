"""A drawing surface with smooth edges and text, on pygame without a display."""

from __future__ import annotations

import math
import os
import warnings
from collections.abc import Sequence
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
        self._texts: list[tuple[str, float, float, Color, float]] = []

    def clear(self) -> None:
        """Begin a new picture."""
        self._large.fill(PAPER)
        self._texts.clear()

    def finish(self) -> pygame.Surface:
        """The picture at its true size."""
        small = self._scale_down(self._large, (WIDTH, HEIGHT))
        for text, left, baseline, color, size in self._texts:
            self._font.render_to(small, (round(left), round(baseline)), text, color, size=size)
        return small

    def text(self, text: str, x: float, y: float, color: Color = INK, size: float = 12, align: float = 0) -> None:
        """``y`` is the baseline; ``align`` is 0 left, 0.5 centred, 1 right."""
        width = self._font.get_rect(text, size=size).width
        self._texts.append((text, x - align * width, y, color, size))

    def line(self, points: Points, color: Color = INK, width: float = 1) -> None:
        """A line through points."""
        if len(points) > 1:
            self._shapes.lines(self._large, color, False, _enlarged(points), max(1, round(width * SUPERSAMPLING)))

    def box(self, x: float, y: float, x_end: float, y_end: float, fill: Color, outline: Color | None = INK) -> None:
        """A filled rectangle."""
        left, top, right, bottom = (round(SUPERSAMPLING * edge) for edge in (x, y, x_end, y_end))
        area = (left, top, max(0, right - left), max(0, bottom - top))
        self._shapes.rect(self._large, fill, area)
        if outline is not None:
            self._shapes.rect(self._large, outline, area, SUPERSAMPLING)

    def arrow(self, x: float, x_end: float, y: float, width: float, fill: Color = INK) -> None:
        """A filled arrow along x, from ``x`` to ``x_end``."""
        shaft, wing = width / 2, width / 2 + 2.5
        neck = x_end - math.copysign(min(0.7 * abs(x_end - x), 2 * wing), x_end - x)
        upper = [(x, y - shaft), (neck, y - shaft), (neck, y - wing), (x_end, y)]
        lower = [(along, 2 * y - height) for along, height in reversed(upper[:-1])]
        self._shapes.polygon(self._large, fill, _enlarged([*upper, *lower]))
        self._shapes.polygon(self._large, INK, _enlarged([*upper, *lower]), SUPERSAMPLING)


def _enlarged(points: Points) -> list[tuple[float, float]]:
    return [(float(x) * SUPERSAMPLING, float(y) * SUPERSAMPLING) for x, y in points]
