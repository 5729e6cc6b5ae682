"""The drawing of the axis: cylinder cut open, load, valve command, pressures, and the position over time.

pygame is imported only when a renderer is made; ``rgb_array`` draws on plain surfaces and needs no display.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from hydro_env.canvas import HEIGHT, INK, WIDTH, Canvas, Color
from hydro_env.plant.parts.chambers import Cylinder
from hydro_env.plant.states import State
from hydro_env.types import Floats

if TYPE_CHECKING:
    import pygame

    from hydro_env.axes import Axes

MINUS = "\N{MINUS SIGN}"
BAR = 1e5  # Pa
PRESSURE_SCALES = (50.0, 100.0, 150.0, 200.0, 250.0, 300.0, 400.0)  # bar

WHITE, GREY = (255, 255, 255), (105, 114, 124)
FAINT, ROD, STEEL, PISTON = (218, 222, 226), (238, 240, 242), (203, 208, 214), (150, 158, 167)
POSITION, REFERENCE, REFERENCE_COMING, LEAK = (24, 78, 140), (205, 92, 0), (236, 184, 140), (255, 214, 60)
OIL = ((178, 208, 236), (222, 178, 196), (212, 74, 70))  # from tank blue to pressure red

# Places in pixels. Lengths along the axis are to scale; the diameters have their own scale.
AXIS_Y, BORE_HALF, WALL, CAP, PISTON_HALF, STROKE_PIXELS = 150.0, 40.0, 8.0, 24.0, 12.0, 345.0
BORE_TOP, BORE_BOTTOM = AXIS_Y - BORE_HALF, AXIS_Y + BORE_HALF
BARREL_LEFT = 56.0
BARREL_RIGHT = BARREL_LEFT + STROKE_PIXELS + 2 * PISTON_HALF
PISTON_ZERO = (BARREL_LEFT + BARREL_RIGHT) / 2
LOAD_HALF, GROUND_LEFT, GROUND_Y, WALL_X = 30.0, BARREL_RIGHT + CAP + 12, AXIS_Y + 36, 930.0
LOAD_ZERO = GROUND_LEFT + LOAD_HALF + STROKE_PIXELS / 2
PLOT_LEFT, PLOT_RIGHT, PLOT_TOP, PLOT_BOTTOM, PLOT_POINTS = 66.0, 936.0, 320.0, 500.0, 900


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


class AxisRenderer(Canvas):
    """Draws the axis as an array (``rgb_array``) or in a window in real time (``human``)."""

    _view: View

    def __init__(self, render_mode: str) -> None:
        if render_mode not in ("rgb_array", "human"):
            raise ValueError(f"render_mode must be 'rgb_array' or 'human', not {render_mode!r}")
        super().__init__()
        self._render_mode = render_mode
        self._pressure_scale = PRESSURE_SCALES[0]
        self._window: pygame.Surface | None = None
        self._clock: pygame.time.Clock | None = None
        self._closed = False

    def draw(self, view: View, frame_time: float = 0.0) -> NDArray[np.uint8] | None:
        """Draw one frame; a window waits until ``frame_time`` (s) after the last one, and does nothing once closed."""
        import pygame

        if self._render_mode == "human":
            if not self._closed:
                self._show(self._picture(view), frame_time)
            return None
        content = pygame.image.tobytes(self._picture(view), "RGB")
        return np.frombuffer(content, dtype=np.uint8).reshape(HEIGHT, WIDTH, 3).copy()

    def close(self) -> None:
        """Close the window; calling it again does nothing."""
        self._closed = True
        if self._window is not None:
            import pygame

            self._window = None
            pygame.display.quit()

    def _show(self, surface: pygame.Surface, frame_time: float) -> None:
        import pygame

        if self._window is None or self._clock is None:
            pygame.display.init()
            pygame.display.set_caption("Hydraulic servo axis")
            self._window = pygame.display.set_mode((WIDTH, HEIGHT))
            self._clock = pygame.time.Clock()
        if any(event.type == pygame.QUIT for event in pygame.event.get()):
            self.close()
            return
        self._window.blit(surface, (0, 0))
        pygame.display.flip()
        self._clock.tick(1.0 / frame_time if frame_time > 0.0 else 0.0)

    # The parts of the picture, from back to front -------------------------------------------------------------------

    def _picture(self, view: View) -> pygame.Surface:
        self._view = view
        # The scale only grows, so that colours do not flicker when the supply pressure moves around a limit.
        fitting = (scale for scale in PRESSURE_SCALES if scale >= 1.1 * view.state.supply_pressure / BAR)
        self._pressure_scale = max(self._pressure_scale, next(fitting, PRESSURE_SCALES[-1]))
        self.clear()
        self._numbers()
        self._cylinder()
        self._load()
        self._plot()
        return self.finish()

    def _pixels(self, position: float) -> float:
        """From mid-stroke along the axis."""
        return position / self._view.cylinder.stroke * STROKE_PIXELS

    def _oil(self, pressure: float) -> Color:
        share = min(1.0, max(0.0, pressure / BAR / self._pressure_scale))
        red, green, blue = (
            round(float(np.interp(share, (0.0, 0.5, 1.0), channel))) for channel in zip(*OIL, strict=True)
        )
        return red, green, blue

    def _numbers(self) -> None:
        view, s = self._view, self._view.state
        entries = (
            ("Time", view.time, 2, "s", INK),
            ("Position", 1e3 * s.position, 1, "mm", POSITION),
            ("Reference", 1e3 * view.reference, 1, "mm", REFERENCE),
            ("Error", 1e3 * (view.reference - s.position), 1, "mm", INK),
            ("Velocity", 1e3 * s.velocity, 1, "mm/s", INK),
            ("External force", view.external_force, 0, "N", INK),
            ("Command", 100 * view.command, 0, "%", INK),
            ("Spool", 100 * s.spool_position, 0, "%", INK),
            ("Pressure a", s.pressure_a / BAR, 1, "bar", INK),
            ("Pressure b", s.pressure_b / BAR, 1, "bar", INK),
            ("Supply", s.supply_pressure / BAR, 1, "bar", INK),
            ("Leakage at 100 bar", view.leakage_flow_lpm, 2, "l/min", INK),
        )
        for index, (name, value, decimals, unit, color) in enumerate(entries):
            x, y = 34 + 152 * (index % 6), 19 + 228 * (index // 6)
            number = f"{round(value, decimals) + 0.0:.{decimals}f}".replace("-", MINUS)  # adding 0 turns -0 into 0
            self.text(name, x, y, GREY, 11)
            self.text(f"{number} {unit}", x, y + 19, color, 17)

    def _cylinder(self) -> None:
        view, s = self._view, self._view.state
        piston, load = PISTON_ZERO + self._pixels(s.position), LOAD_ZERO + self._pixels(s.position)
        self.box(BARREL_LEFT, BORE_TOP - WALL, BARREL_RIGHT, BORE_BOTTOM + WALL, STEEL)
        self.box(BARREL_LEFT, BORE_TOP, piston, BORE_BOTTOM, self._oil(s.pressure_a), None)
        self.box(piston, BORE_TOP, BARREL_RIGHT, BORE_BOTTOM, self._oil(s.pressure_b), None)
        for left in (BARREL_LEFT - CAP, BARREL_RIGHT):
            self.box(left, BORE_TOP - WALL - 4, left + CAP, BORE_BOTTOM + WALL + 4, STEEL)
        rod = BORE_HALF * view.cylinder.rod_diameter / view.cylinder.bore_diameter
        self.box(piston, AXIS_Y - rod, load, AXIS_Y + rod, ROD)
        # The square root of the gap at the seal keeps both an incipient and a severe leak visible.
        flow = view.leakage_flow_lpm
        gap = min(10.0, 1 + 4 * math.sqrt(flow)) if flow > 0 else 0.0
        self.box(piston - PISTON_HALF, BORE_TOP + gap, piston + PISTON_HALF, BORE_BOTTOM - gap, PISTON)
        if gap > 0.0 and s.pressure_a != s.pressure_b:
            ends = [max(piston - 26, BARREL_LEFT), min(piston + 26, BARREL_RIGHT)]
            tail, tip = ends if s.pressure_a > s.pressure_b else reversed(ends)
            for y in (BORE_TOP + gap / 2, BORE_BOTTOM - gap / 2):
                self.arrow(tail, tip, y, gap, LEAK)
        self.text("Chamber a (bore)", BARREL_LEFT - CAP, BORE_TOP - WALL - 12, GREY)
        self.text("Chamber b (rod)", BARREL_RIGHT + CAP, BORE_TOP - WALL - 12, GREY, align=1)

    def _load(self) -> None:
        view = self._view
        load, wanted = (LOAD_ZERO + self._pixels(place) for place in (view.state.position, view.reference))
        right = load + LOAD_HALF
        self.line([(GROUND_LEFT, GROUND_Y), (WALL_X, GROUND_Y)], INK, 1.5)
        if view.has_spring:
            coils = np.linspace(right + 8, WALL_X - 8, 17)
            zigzag = [(x, AXIS_Y + (-11 if index % 2 else 11)) for index, x in enumerate(coils)]
            self.line([(right, AXIS_Y), *zigzag, (WALL_X, AXIS_Y)], INK, 1.5)
            self.box(WALL_X, AXIS_Y - 42, WALL_X + 7, GROUND_Y + 1, STEEL)
        self.box(load - LOAD_HALF, AXIS_Y - 34, right, GROUND_Y, STEEL)
        self.text("Load", load, GROUND_Y + 20, GREY, align=0.5)
        if view.external_force:
            ends = [right + 26 + 20 * min(1.0, abs(view.external_force) / 2000), right + 3]
            tail, tip = ends if view.external_force > 0 else reversed(ends)
            self.arrow(tail, tip, AXIS_Y - 26, 3)
        self.line([(load, AXIS_Y - 34), (load, GROUND_Y)], POSITION, 2)
        self.line([(wanted, AXIS_Y - 60), (wanted, GROUND_Y)], REFERENCE, 2)
        self.text("Reference", wanted, AXIS_Y - 66, REFERENCE, align=0.5)

    def _plot(self) -> None:
        view = self._view
        stride = (len(view.past) + len(view.coming)) // PLOT_POINTS + 1
        past = 1e3 * view.past[::-stride][::-1]  # keeps the last sample
        coming = 1e3 * np.append(view.reference, view.coming[::-stride][::-1])
        then = view.time - stride * view.period * np.arange(len(past))[::-1]
        # Where the coming samples end, the axis ends: it does not move from frame to frame.
        later = view.time + view.period * np.append(0, len(view.coming) - stride * np.arange(len(coming) - 1)[::-1])

        shown = np.concatenate((past.ravel(), coming))
        spare = max(0.0, 20.0 - float(np.ptp(shown))) / 2  # a still axis is not magnified to noise
        span = _ticks(then[0], max(later[-1], then[0] + 1), 40)[[0, -1]]
        values = _ticks(shown.min() - spare, shown.max() + spare, 4)
        self._axes(span, values)
        for time, value, color in (
            (later, coming, REFERENCE_COMING),
            (then, past[:, 1], REFERENCE),
            (then, past[:, 0], POSITION),
        ):
            x = np.interp(time, span, (PLOT_LEFT, PLOT_RIGHT))
            y = np.interp(value, values[[0, -1]], (PLOT_BOTTOM, PLOT_TOP))
            self.line(np.stack((x, y), axis=1), color, 1.5)
        now = float(np.interp(view.time, span, (PLOT_LEFT, PLOT_RIGHT)))
        self.line([(now, PLOT_TOP), (now, PLOT_BOTTOM)], GREY, 0.5)

    def _axes(self, span: Floats, values: Floats) -> None:
        times = _ticks(span[0], span[1], 8)
        for time in times[(times > span[0] - 1e-9) & (times < span[1] + 1e-9)]:
            x = float(np.interp(time, span, (PLOT_LEFT, PLOT_RIGHT)))
            self.line([(x, PLOT_BOTTOM), (x, PLOT_BOTTOM + 4)])
            self.text(f"{time:g}", x, PLOT_BOTTOM + 17, GREY, 11, 0.5)
        for y, value in zip(np.linspace(PLOT_BOTTOM, PLOT_TOP, len(values)), values, strict=True):
            self.line([(PLOT_LEFT, y), (PLOT_RIGHT, y)], FAINT, 0.5)
            self.text(f"{value:g}".replace("-", MINUS), PLOT_LEFT - 7, y + 4, GREY, 11, 1)
        self.line([(PLOT_LEFT, PLOT_TOP), (PLOT_LEFT, PLOT_BOTTOM), (PLOT_RIGHT, PLOT_BOTTOM)])
        self.text("Position, mm", 34, PLOT_TOP - 12, INK, 13)
        self.text("Time, s", (PLOT_LEFT + PLOT_RIGHT) / 2, PLOT_BOTTOM + 34, INK, 13, 0.5)
        for left, name, color in ((740, "Position", POSITION), (840, "Reference", REFERENCE)):
            self.line([(left, PLOT_TOP - 16), (left + 24, PLOT_TOP - 16)], color, 2)
            self.text(name, left + 30, PLOT_TOP - 12)


def _ticks(low: float, high: float, parts: int) -> Floats:
    """Multiples of 1, 2 or 5 times a power of ten that cover a range in about ``parts`` parts."""
    span = high - low
    power = 10.0 ** math.floor(math.log10(span / parts))
    step = next(factor * power for factor in (1, 2, 5, 10) if factor * power * parts >= span * (1 - 1e-9))
    first, last = math.floor(low / step + 1e-9), math.ceil(high / step - 1e-9)
    return step * np.arange(first, last + 1, dtype=np.float64)
