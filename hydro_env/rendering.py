"""The drawing of the axis: cylinder cut open, load, its numbers, and the position over time.

pygame is imported only when a renderer is made; ``rgb_array`` draws on plain surfaces and needs no display.
"""

from __future__ import annotations

import math
import os
import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from gymnasium.error import DependencyNotInstalled
from numpy.typing import NDArray

from hydro_env.plant.parts.chambers import Cylinder
from hydro_env.plant.states import State
from hydro_env.types import Floats

if TYPE_CHECKING:
    from hydro_env.axes import Axes

BAR = 1e5  # Pa
WIDTH, HEIGHT = 960, 540
FONTS = "dejavusans,liberationsans,notosans,arial,helvetica,segoeui"

PAPER, INK, GREY, STEEL, PISTON = (250, 250, 248), (38, 46, 56), (105, 114, 124), (203, 208, 214), (150, 158, 167)
POSITION, REFERENCE, REFERENCE_COMING, LEAK = (24, 78, 140), (205, 92, 0), (236, 184, 140), (255, 214, 60)
OIL = ((178, 208, 236), (222, 178, 196), (212, 74, 70))  # from tank blue to pressure red

# Places in pixels. Lengths along the axis are to scale; the diameters have their own scale.
AXIS_Y, BORE_HALF, WALL, PISTON_HALF, STROKE_PIXELS = 150.0, 40.0, 8.0, 12.0, 345.0
BARREL_LEFT, BARREL_RIGHT = 56.0, 56.0 + STROKE_PIXELS + 2 * PISTON_HALF
PISTON_ZERO = (BARREL_LEFT + BARREL_RIGHT) / 2
LOAD_HALF, GROUND_Y, WALL_X = 30.0, AXIS_Y + 36, 930.0
LOAD_ZERO = BARREL_RIGHT + 36 + LOAD_HALF + STROKE_PIXELS / 2
PLOT_LEFT, PLOT_RIGHT, PLOT_TOP, PLOT_BOTTOM = 66.0, 936.0, 320.0, 500.0

Color = tuple[int, int, int]


@dataclass(frozen=True)
class View:
    """One picture as numbers; SI units."""

    time: float
    state: State
    reference: float
    command: float  # -1 to 1
    leakage_flow_lpm: float  # l/min at 100 bar
    external_force: float  # N; positive pushes against extension
    cylinder: Cylinder
    has_spring: bool
    period: float  # between two samples
    past: Floats  # (m, 2), position and reference of the samples of the episode until now
    coming: Floats  # (n,), reference of those that follow

    @classmethod
    def of(cls, axes: Axes, history: Sequence[tuple[float, float]]) -> View:
        """The first axis now; ``history`` holds position and reference (m) of each sample that is drawn."""
        record, plant = axes.record[0], axes.parameters(0)
        config = axes.tasks[int(record["rig"])]
        step = int(record["step"])
        return cls(
            time=step * config.control_period,
            state=State(*axes.state[0]),
            reference=record["reference"],
            command=record["command"],
            leakage_flow_lpm=record["leak_flow"],
            external_force=axes.external_force(0),
            cylinder=plant.cylinder,
            has_spring=plant.load.spring_stiffness > 0.0,
            period=config.control_period,
            past=np.array([*history[:-1], (record["position"], record["reference"])]),
            coming=axes.reference[0, step + 1 : config.steps + 1].copy(),
        )


class AxisRenderer:
    """Draws the axis as an array (``rgb_array``) or in a window in real time (``human``)."""

    def __init__(self, render_mode: str) -> None:
        os.environ.setdefault("PYGAME_HIDE_SUPPORT_PROMPT", "1")  # suppresses pygame's greeting
        try:
            import pygame
            import pygame.freetype
        except ImportError as error:
            raise DependencyNotInstalled('pygame is not installed, run `pip install "hydro_env[render]"`') from error
        self._pygame, self._render_mode = pygame, render_mode
        pygame.freetype.init()
        with warnings.catch_warnings():  # pygame warns if there are no system fonts, and uses its own
            warnings.simplefilter("ignore")
            self._font = pygame.freetype.SysFont(FONTS, 13)
        self._font.origin = True
        self._picture = pygame.Surface((WIDTH, HEIGHT))
        self._window: Any = None
        self._clock = pygame.time.Clock()
        self._closed = False

    def draw(self, view: View, frame_time: float = 0.0) -> NDArray[np.uint8] | None:
        """Draw one frame; a window waits until ``frame_time`` (s) after the last one, and does nothing once closed."""
        if self._closed:
            return None
        self._picture.fill(PAPER)
        self._numbers(view)
        self._cylinder(view)
        self._load(view)
        self._plot(view)
        if self._render_mode == "human":
            self._show(frame_time)
            return None
        content = self._pygame.image.tobytes(self._picture, "RGB")
        return np.frombuffer(content, dtype=np.uint8).reshape(HEIGHT, WIDTH, 3).copy()

    def close(self) -> None:
        """Close the window; calling it again does nothing."""
        self._closed = True
        if self._window is not None:
            self._window = None
            self._pygame.display.quit()

    def _show(self, frame_time: float) -> None:
        display = self._pygame.display
        if self._window is None:
            display.init()
            display.set_caption("Hydraulic servo axis")
            self._window = display.set_mode((WIDTH, HEIGHT))
        if any(event.type == self._pygame.QUIT for event in self._pygame.event.get()):
            self.close()
            return
        self._window.blit(self._picture, (0, 0))
        display.flip()
        self._clock.tick(1.0 / frame_time if frame_time > 0.0 else 0.0)

    def _text(self, text: str, x: float, y: float, color: Color = GREY, size: float = 11) -> None:
        """A text from ``x`` on, with its baseline at ``y``."""
        self._font.render_to(self._picture, (round(x), round(y)), text.replace("-", "−"), color, size=size)

    def _line(self, x: Any, y: Any, color: Color = INK, width: int = 2) -> None:
        if len(x) > 1:
            self._pygame.draw.lines(self._picture, color, False, np.rint(np.stack((x, y), axis=1)), width)

    def _box(self, x: float, y: float, x_end: float, y_end: float, fill: Color, outlined: bool = True) -> None:
        left, top, right, bottom = (round(edge) for edge in (x, y, x_end, y_end))
        area = (left, top, max(0, right - left), max(0, bottom - top))
        self._pygame.draw.rect(self._picture, fill, area)
        if outlined:
            self._pygame.draw.rect(self._picture, INK, area, 1)

    # The parts of the picture, from back to front -------------------------------------------------------------------

    def _numbers(self, view: View) -> None:
        s = view.state
        entries = (
            ("Time", view.time, 2, "s"),
            ("Position", 1e3 * s.position, 1, "mm"),
            ("Reference", 1e3 * view.reference, 1, "mm"),
            ("Error", 1e3 * (view.reference - s.position), 1, "mm"),
            ("Velocity", 1e3 * s.velocity, 1, "mm/s"),
            ("External force", view.external_force, 0, "N"),
            ("Command", 100 * view.command, 0, "%"),
            ("Spool", 100 * s.spool_position, 0, "%"),
            ("Pressure a", s.pressure_a / BAR, 1, "bar"),
            ("Pressure b", s.pressure_b / BAR, 1, "bar"),
            ("Supply", s.supply_pressure / BAR, 1, "bar"),
            ("Leakage at 100 bar", view.leakage_flow_lpm, 2, "l/min"),
        )
        for index, (name, value, decimals, unit) in enumerate(entries):
            x, y = 34 + 152 * (index % 6), 19 + 228 * (index // 6)
            self._text(name, x, y)
            color = {"Position": POSITION, "Reference": REFERENCE}.get(name, INK)
            self._text(f"{round(value, decimals) + 0.0:.{decimals}f} {unit}", x, y + 19, color, 17)  # no -0

    def _cylinder(self, view: View) -> None:
        s, top, bottom = view.state, AXIS_Y - BORE_HALF, AXIS_Y + BORE_HALF
        self._text("Chamber a (bore)", BARREL_LEFT, top - WALL - 10)
        self._text("Chamber b (rod)", BARREL_RIGHT - 64, top - WALL - 10)
        moved = s.position / view.cylinder.stroke * STROKE_PIXELS
        piston = PISTON_ZERO + moved
        self._box(BARREL_LEFT - 24, top - WALL, BARREL_RIGHT + 24, bottom + WALL, STEEL)
        self._box(BARREL_LEFT, top, piston, bottom, _oil(s.pressure_a / s.supply_pressure), False)
        self._box(piston, top, BARREL_RIGHT, bottom, _oil(s.pressure_b / s.supply_pressure), False)
        rod = BORE_HALF * view.cylinder.rod_diameter / view.cylinder.bore_diameter
        self._box(piston, AXIS_Y - rod, LOAD_ZERO + moved, AXIS_Y + rod, STEEL)
        # The square root of the gap at the seal keeps both an incipient and a severe leak visible.
        flow = view.leakage_flow_lpm
        gap = min(10.0, 1 + 4 * math.sqrt(flow)) if flow > 0 else 0.0
        self._box(piston - PISTON_HALF, top + gap, piston + PISTON_HALF, bottom - gap, PISTON)
        if gap > 0.0 and s.pressure_a != s.pressure_b:
            towards = math.copysign(26.0, s.pressure_a - s.pressure_b)
            for y in (top + gap / 2, bottom - gap / 2):
                wing, neck = gap / 2 + 2.5, piston + 0.5 * towards
                self._line((piston - towards, neck), (y, y), LEAK, round(gap))
                head = ((neck, y - wing), (piston + towards, y), (neck, y + wing))
                self._pygame.draw.polygon(self._picture, LEAK, head)

    def _load(self, view: View) -> None:
        per_metre = STROKE_PIXELS / view.cylinder.stroke
        load, wanted = LOAD_ZERO + per_metre * view.state.position, LOAD_ZERO + per_metre * view.reference
        self._line((BARREL_RIGHT + 36, WALL_X), (GROUND_Y, GROUND_Y))
        if view.has_spring:
            self._line(np.linspace(load + LOAD_HALF, WALL_X, 18), AXIS_Y + 11 * (-1.0) ** np.arange(18))
            self._box(WALL_X, AXIS_Y - 42, WALL_X + 7, GROUND_Y + 1, STEEL)
        self._box(load - LOAD_HALF, AXIS_Y - 34, load + LOAD_HALF, GROUND_Y, STEEL)
        self._text("Load", load - 12, GROUND_Y + 18)
        self._line((load, load), (AXIS_Y - 34, GROUND_Y), POSITION)
        self._line((wanted, wanted), (AXIS_Y - 60, GROUND_Y), REFERENCE)

    def _plot(self, view: View) -> None:
        """The whole episode; the scale of positions is symmetric, in whole centimetres."""
        count, coming = len(view.past), np.append(view.reference, view.coming)
        limit = 0.01 * max(1.0, math.ceil(100.0 * max(np.abs(view.past).max(), np.abs(coming).max())))
        begin, end = view.time - view.period * (count - 1), view.time + view.period * len(view.coming)
        xs = np.linspace(PLOT_LEFT, PLOT_RIGHT, count + len(view.coming))

        def height(values: Any) -> Any:
            return np.interp(values, (-limit, limit), (PLOT_BOTTOM, PLOT_TOP))

        for value in (-limit, 0.0, limit):
            self._line((PLOT_LEFT, PLOT_RIGHT), (height(value), height(value)), STEEL, 1)
            self._text(f"{1e3 * value:.0f}", 34, height(value) + 4)
        for time, x in ((begin, PLOT_LEFT), (end, PLOT_RIGHT - 24)):
            self._text(f"{time:.3g}", x, PLOT_BOTTOM + 17)
        self._line(xs[count - 1 :], height(coming), REFERENCE_COMING)
        self._line(xs[:count], height(view.past[:, 1]), REFERENCE)
        self._line(xs[:count], height(view.past[:, 0]), POSITION)
        self._text("Position and reference in mm over time in s", 34, PLOT_TOP - 12, INK, 13)


def _oil(share: float) -> Color:
    red, green, blue = (round(float(np.interp(share, (0.0, 0.5, 1.0), channel))) for channel in zip(*OIL, strict=True))
    return red, green, blue
