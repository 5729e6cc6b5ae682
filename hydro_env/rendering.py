"""The drawing of the axis: cylinder cut open, load, its numbers, and the position over time.

pygame is imported only when a renderer is made; ``rgb_array`` draws on plain surfaces and needs no display.
"""

import math
import os
from collections.abc import Sequence
from typing import Any

import numpy as np
from gymnasium.error import DependencyNotInstalled
from numpy.typing import NDArray

from hydro_env.axes import Axes
from hydro_env.plant.states import State

BAR = 1e5  # Pa
WIDTH, HEIGHT = 960, 540

Color = tuple[int, ...]

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
        self._font = pygame.freetype.Font(None)
        self._font.origin = True
        self._picture = pygame.Surface((WIDTH, HEIGHT))
        self._window: Any = None
        self._clock = pygame.time.Clock()
        self._closed = False

    def draw(
        self, axes: Axes, history: Sequence[tuple[float, float]], frame_time: float = 0.0
    ) -> NDArray[np.uint8] | None:
        """Draw the first axis now; a window waits until ``frame_time`` (s) after the last frame.

        ``history`` holds position and reference (m) of each sample until now. A closed window draws nothing.
        """
        if self._closed:
            return None
        record, plant, state = axes.record[0], axes.parameters(0), State(*axes.state[0])
        task, step = axes.tasks[int(record["rig"])], int(record["step"])
        self._picture.fill(PAPER)
        self._numbers(record, state, step * task.control_period, axes.external_force(0))
        per_metre = STROKE_PIXELS / plant.cylinder.stroke
        rod = BORE_HALF * plant.cylinder.rod_diameter / plant.cylinder.bore_diameter
        self._cylinder(state, per_metre * state.position, rod, record["leak_flow"])
        self._load(per_metre * state.position, per_metre * record["reference"], plant.load.spring_stiffness > 0.0)
        past = np.array([*history[:-1], (record["position"], record["reference"])])
        self._plot(past, axes.reference[0, step : task.steps + 1], step, task.control_period)
        if self._render_mode == "human":
            self._show(frame_time)
            return None
        content = self._pygame.image.tobytes(self._picture, "RGB")
        return np.frombuffer(content, np.uint8).reshape(HEIGHT, WIDTH, 3).copy()

    def close(self) -> None:
        """Close the window; calling it again does nothing."""
        self._closed = True
        if self._window:
            self._window = None
            self._pygame.display.quit()

    def _show(self, frame_time: float) -> None:
        display = self._pygame.display
        if not self._window:
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
            self._pygame.draw.lines(self._picture, color, False, np.stack(np.broadcast_arrays(x, y), axis=1), width)

    def _box(self, x: float, y: float, x_end: float, y_end: float, fill: Color, edge: Color = INK) -> None:
        area = np.rint((x, y, max(0.0, x_end - x), max(0.0, y_end - y)))
        self._pygame.draw.rect(self._picture, fill, area)
        self._pygame.draw.rect(self._picture, edge, area, 1)

    # The parts of the picture, from back to front -------------------------------------------------------------------

    def _numbers(self, record: Any, s: State, time: float, force: float) -> None:
        texts = {
            "Time": f"{time:.2f} s",
            "Position": f"{1e3 * s.position:z.1f} mm",
            "Reference": f"{1e3 * record['reference']:z.1f} mm",
            "Error": f"{1e3 * (record['reference'] - s.position):z.1f} mm",
            "Velocity": f"{1e3 * s.velocity:z.1f} mm/s",
            "External force": f"{force:z.0f} N",
            "Command": f"{100 * record['command']:z.0f} %",
            "Spool": f"{100 * s.spool_position:z.0f} %",
            "Pressure a": f"{s.pressure_a / BAR:z.1f} bar",
            "Pressure b": f"{s.pressure_b / BAR:z.1f} bar",
            "Supply": f"{s.supply_pressure / BAR:z.1f} bar",
            "Leakage at 100 bar": f"{record['leak_flow']:.2f} l/min",
        }
        colors = {"Position": POSITION, "Reference": REFERENCE}
        for index, (name, text) in enumerate(texts.items()):
            x, y = 34 + 152 * (index % 6), 19 + 228 * (index // 6)
            self._text(name, x, y)
            self._text(text, x, y + 19, colors.get(name, INK), 17)

    def _cylinder(self, s: State, moved: float, rod: float, leak: float) -> None:
        """Piston and rod ``moved`` by so many pixels, and the leak, l/min at 100 bar."""
        top, bottom, piston = AXIS_Y - BORE_HALF, AXIS_Y + BORE_HALF, PISTON_ZERO + moved
        self._text("Chamber a (bore)", BARREL_LEFT, top - WALL - 10)
        self._text("Chamber b (rod)", BARREL_RIGHT - 64, top - WALL - 10)
        self._box(BARREL_LEFT - 24, top - WALL, BARREL_RIGHT + 24, bottom + WALL, STEEL)
        oil_a, oil_b = _oil(s.pressure_a / s.supply_pressure), _oil(s.pressure_b / s.supply_pressure)
        self._box(BARREL_LEFT, top, piston, bottom, oil_a, oil_a)
        self._box(piston, top, BARREL_RIGHT, bottom, oil_b, oil_b)
        self._box(piston, AXIS_Y - rod, LOAD_ZERO + moved, AXIS_Y + rod, STEEL)
        # The square root of the gap at the seal keeps both an incipient and a severe leak visible.
        gap = min(10.0, 1 + 4 * math.sqrt(leak)) if leak > 0.0 else 0.0
        self._box(piston - PISTON_HALF, top + gap, piston + PISTON_HALF, bottom - gap, PISTON)
        towards = math.copysign(26.0, s.pressure_a - s.pressure_b)
        for y in (top + gap / 2, bottom - gap / 2) if gap > 0.0 else ():
            wing, neck = gap / 2 + 2.5, piston + 0.5 * towards
            self._line((piston - towards, neck), y, LEAK, round(gap))
            head = ((neck, y - wing), (piston + towards, y), (neck, y + wing))
            self._pygame.draw.polygon(self._picture, LEAK, head)

    def _load(self, moved: float, wanted: float, has_spring: bool) -> None:
        load, wanted = LOAD_ZERO + moved, LOAD_ZERO + wanted
        self._line((BARREL_RIGHT + 36, WALL_X), GROUND_Y)
        if has_spring:
            self._line(np.linspace(load + LOAD_HALF, WALL_X, 18), AXIS_Y + 11 * (-1.0) ** np.arange(18))
            self._box(WALL_X, AXIS_Y - 42, WALL_X + 7, GROUND_Y, STEEL)
        self._box(load - LOAD_HALF, AXIS_Y - 34, load + LOAD_HALF, GROUND_Y, STEEL)
        self._text("Load", load - 12, GROUND_Y + 18)
        self._line((load, load), (AXIS_Y - 34, GROUND_Y), POSITION)
        self._line((wanted, wanted), (AXIS_Y - 60, GROUND_Y), REFERENCE)

    def _plot(self, past: Any, coming: Any, step: int, period: float) -> None:
        """The whole episode; the scale of positions is symmetric, in whole centimetres."""
        limit = 0.01 * max(1.0, math.ceil(100.0 * max(np.abs(past).max(), np.abs(coming).max())))
        now = len(past) - 1
        xs = np.linspace(PLOT_LEFT, PLOT_RIGHT, now + len(coming))

        def height(values: Any) -> Any:
            return np.interp(values, (-limit, limit), (PLOT_BOTTOM, PLOT_TOP))

        for value in (-limit, 0.0, limit):
            self._line((PLOT_LEFT, PLOT_RIGHT), height(value), STEEL, 1)
            self._text(f"{1e3 * value:.0f}", 34, height(value) + 4)
        self._text(f"{period * (step - now):.3g}", PLOT_LEFT, PLOT_BOTTOM + 17)
        self._text(f"{period * (step + len(coming) - 1):.3g}", PLOT_RIGHT - 24, PLOT_BOTTOM + 17)
        self._line(xs[now:], height(coming), REFERENCE_COMING)
        self._line(xs[: now + 1], height(past[:, 1]), REFERENCE)
        self._line(xs[: now + 1], height(past[:, 0]), POSITION)
        self._text("Position and reference in mm over time in s", 34, PLOT_TOP - 12, INK, 13)


def _oil(share: float) -> Color:
    return tuple(round(np.interp(share, (0.0, 0.5, 1.0), channel)) for channel in zip(*OIL, strict=True))
