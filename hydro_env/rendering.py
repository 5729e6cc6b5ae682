"""The drawing of the axis: cylinder cut open, load, valve, pressures, and the position over time.

pygame is imported only when a renderer is made; ``rgb_array`` draws on plain surfaces and needs no display.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from hydro_env.canvas import HEIGHT, INK, WIDTH, Canvas, Color
from hydro_env.view import View

if TYPE_CHECKING:
    import pygame

MINUS = "\N{MINUS SIGN}"
BAR = 1e5  # Pa
PRESSURE_SCALES = (50.0, 100.0, 150.0, 200.0, 250.0, 300.0, 400.0)  # bar

WHITE, GREY = (255, 255, 255), (105, 114, 124)
FAINT, ROD, STEEL, PISTON = (218, 222, 226), (238, 240, 242), (203, 208, 214), (150, 158, 167)
POSITION, REFERENCE, REFERENCE_COMING, LEAK = (24, 78, 140), (205, 92, 0), (236, 184, 140), (255, 214, 60)
OIL = ((178, 208, 236), (222, 178, 196), (212, 74, 70))  # from tank blue to pressure red

# Places in pixels. Lengths along the axis are to scale; the diameters have their own scale.
AXIS_Y, BORE_HALF, WALL, CAP, PISTON_HALF, STROKE_PIXELS = 132.0, 40.0, 8.0, 24.0, 12.0, 345.0
BORE_TOP, BORE_BOTTOM = AXIS_Y - BORE_HALF, AXIS_Y + BORE_HALF
BARREL_LEFT = 56.0
BARREL_RIGHT = BARREL_LEFT + STROKE_PIXELS + 2 * PISTON_HALF
PISTON_ZERO = (BARREL_LEFT + BARREL_RIGHT) / 2
LOAD_HALF, GROUND_LEFT, GROUND_Y, WALL_X, SCALE_Y = 30.0, BARREL_RIGHT + CAP + 12, AXIS_Y + 46, 930.0, 72.0
LOAD_ZERO = GROUND_LEFT + LOAD_HALF + STROKE_PIXELS / 2
PIPE_Y, VALVE_X, VALVE_TOP, VALVE_BOX, PORT = 220.0, PISTON_ZERO, 242.0, 46.0, 12.0
VALVE_BOTTOM = VALVE_TOP + VALVE_BOX
PANEL_Y, ROW = 246.0, 24.0
PLOT_LEFT, PLOT_RIGHT, PLOT_TOP, PLOT_BOTTOM, PLOT_POINTS = 66.0, 936.0, 384.0, 500.0, 900


class AxisRenderer:
    """Draws the axis as an array (``rgb_array``) or in a window (``human``)."""

    def __init__(self, render_mode: str) -> None:
        if render_mode not in ("rgb_array", "human"):
            raise ValueError(f"render_mode must be 'rgb_array' or 'human', not {render_mode!r}")
        self._render_mode = render_mode
        self._picture = _Picture()
        self._window: pygame.Surface | None = None
        self._closed = False

    def draw(self, view: View) -> NDArray[np.uint8] | None:
        """Draw one frame; after the window has been closed this does nothing."""
        import pygame

        if self._render_mode == "human":
            if not self._closed:
                self._show(self._picture.draw_view(view))
            return None
        content = pygame.image.tobytes(self._picture.draw_view(view), "RGB")
        return np.frombuffer(content, dtype=np.uint8).reshape(HEIGHT, WIDTH, 3).copy()

    def close(self) -> None:
        """Close the window; calling it again does nothing."""
        self._closed = True
        if self._window is not None:
            import pygame

            self._window = None
            pygame.display.quit()

    def _show(self, surface: pygame.Surface) -> None:
        import pygame

        if self._window is None:
            pygame.display.init()
            pygame.display.set_caption("Hydraulic servo axis")
            self._window = pygame.display.set_mode((WIDTH, HEIGHT))
        if any(event.type == pygame.QUIT for event in pygame.event.get()):
            self.close()
            return
        self._window.blit(surface, (0, 0))
        pygame.display.flip()


class _Picture(Canvas):
    """The parts of the picture, drawn from back to front."""

    _view: View

    def __init__(self) -> None:
        super().__init__()
        self._pressure_scale = PRESSURE_SCALES[0]

    def draw_view(self, view: View) -> pygame.Surface:
        self._view = view
        # The scale only grows, so that colours do not flicker when the supply pressure moves around a limit.
        fitting = (scale for scale in PRESSURE_SCALES if scale >= 1.1 * view.supply_pressure / BAR)
        self._pressure_scale = max(self._pressure_scale, next(fitting, PRESSURE_SCALES[-1]))
        self.clear()
        self._numbers()
        self._pipes()
        self._cylinder()
        self._leakage()
        self._load()
        self._position_scale()
        self._valve()
        self._bars()
        self._history()
        return self.finish()

    def _pixels(self, position: float) -> float:
        """From mid-stroke along the axis."""
        return position / self._view.stroke * STROKE_PIXELS

    def _oil(self, pressure: float) -> Color:
        return _oil_color(pressure / BAR / self._pressure_scale)

    def _numbers(self) -> None:
        view = self._view
        entries = (
            ("Time", f"{view.time:.2f} s", INK),
            ("Position", f"{_number(view.position * 1e3)} mm", POSITION),
            ("Reference", f"{_number(view.reference * 1e3)} mm", REFERENCE),
            ("Error", f"{_number((view.reference - view.position) * 1e3)} mm", INK),
            ("Velocity", f"{_number(view.velocity * 1e3)} mm/s", INK),
            ("External force", f"{_number(view.external_force, 0)} N", INK),
        )
        for index, (name, value, color) in enumerate(entries):
            self.text(name, 34 + 152 * index, 19, GREY, 11)
            self.text(value, 34 + 152 * index, 38, color, 17)

    def _pipes(self) -> None:
        chambers = ((-1, BARREL_LEFT, self._view.pressure_a), (1, BARREL_RIGHT, self._view.pressure_b))
        for side, barrel, pressure in chambers:
            cap, port = barrel + side * CAP / 2, VALVE_X + side * PORT
            self.pipe([(cap, BORE_BOTTOM), (cap, PIPE_Y), (port, PIPE_Y), (port, VALVE_TOP)], self._oil(pressure))
        for side, pressure, length in ((-1, self._view.supply_pressure, 16), (1, 0.0, 20)):
            port = VALVE_X + side * PORT
            self.pipe([(port, VALVE_BOTTOM), (port, VALVE_BOTTOM + length)], self._oil(pressure))

    def _cylinder(self) -> None:
        view, piston = self._view, PISTON_ZERO + self._pixels(self._view.position)
        oil_a, oil_b = self._oil(view.pressure_a), self._oil(view.pressure_b)
        self.box(BARREL_LEFT - 1, BORE_TOP - WALL, BARREL_RIGHT + 1, BORE_BOTTOM + WALL, STEEL)
        self.box(BARREL_LEFT, BORE_TOP, piston, BORE_BOTTOM, oil_a, None)
        self.box(piston, BORE_TOP, BARREL_RIGHT, BORE_BOTTOM, oil_b, None)
        for edge in (BORE_TOP, BORE_BOTTOM):
            self.line([(BARREL_LEFT, edge), (BARREL_RIGHT, edge)])
        for left, oil, side in ((BARREL_LEFT - CAP, oil_a, 1), (BARREL_RIGHT, oil_b, -1)):
            middle, bottom = left + CAP / 2, BORE_BOTTOM + WALL + 4
            self.box(left, BORE_TOP - WALL - 4, left + CAP, bottom, STEEL)
            level, mouth = BORE_BOTTOM - 7, middle + side * CAP / 2
            self.pipe([(middle, bottom - 2), (middle, level), (mouth - 3 * side, level)], oil)
            for x, y in ((middle, bottom), (mouth, level)):  # opens the pipe at both ends
                self.box(x - 2, y - 2, x + 2, y + 2, oil, None)
        rod, load = BORE_HALF * view.rod_diameter / view.bore_diameter, LOAD_ZERO + self._pixels(view.position)
        self.box(piston, AXIS_Y - rod, load, AXIS_Y + rod, ROD)
        gap = self._leak_width()
        self.box(piston - PISTON_HALF, BORE_TOP + gap, piston + PISTON_HALF, BORE_BOTTOM - gap, PISTON)
        self.text("Chamber a (bore)", BARREL_LEFT - CAP, BORE_TOP - WALL - 12, GREY)
        self.text("Chamber b (rod)", BARREL_RIGHT + CAP, BORE_TOP - WALL - 12, GREY, align=1)

    def _leak_width(self) -> float:
        """Draw the gap at the seal; the square root keeps both an incipient and a severe leak visible."""
        flow = self._view.leakage_flow_lpm
        return min(10.0, 1 + 4 * math.sqrt(flow)) if flow > 0 else 0.0

    def _leakage(self) -> None:
        view, width = self._view, self._leak_width()
        piston = PISTON_ZERO + self._pixels(view.position)
        label = f"Leakage {view.leakage_flow_lpm:.2f} l/min at 100 bar"
        self.text(label, min(max(piston, 150), 330), BORE_BOTTOM + WALL + 20, align=0.5)
        if width == 0 or view.pressure_a == view.pressure_b:
            return
        ends = [max(piston - 26, BARREL_LEFT), min(piston + 26, BARREL_RIGHT)]
        tail, tip = ends if view.pressure_a > view.pressure_b else reversed(ends)
        for y in (BORE_TOP + width / 2, BORE_BOTTOM - width / 2):
            self.arrow(tail, y, tip, y, width, LEAK)

    def _load(self) -> None:
        view, load = self._view, LOAD_ZERO + self._pixels(self._view.position)
        top, right = AXIS_Y - 34, load + LOAD_HALF
        self.line([(GROUND_LEFT, GROUND_Y), (WALL_X, GROUND_Y)], INK, 1.5)
        for x in np.arange(GROUND_LEFT + 6, WALL_X, 12):
            self.line([(x, GROUND_Y), (x - 6, GROUND_Y + 6)], GREY)
        if view.has_spring:
            coils = np.linspace(right + 8, WALL_X - 8, 17)[1:-1]
            zigzag = [(x, AXIS_Y + (-11 if index % 2 else 11)) for index, x in enumerate(coils)]
            start, end = [(right, AXIS_Y), (right + 8, AXIS_Y)], [(WALL_X - 8, AXIS_Y), (WALL_X, AXIS_Y)]
            self.line([*start, *zigzag, *end], INK, 1.5)
            self.box(WALL_X, top - 8, WALL_X + 7, GROUND_Y + 1, STEEL)
        for x in (load - 17, load + 17):
            self.circle(x, GROUND_Y - 6, 6, WHITE)
        self.box(load - LOAD_HALF, top, right, AXIS_Y + 34, STEEL)
        self.text("Load", load, GROUND_Y + 20, GREY, align=0.5)
        if view.external_force:
            ends = [right + 26 + 20 * min(1.0, abs(view.external_force) / 2000), right + 3]
            tail, tip = ends if view.external_force > 0 else reversed(ends)
            self.arrow(tail, top + 8, tip, top + 8, 3)

    def _position_scale(self) -> None:
        half = 1e3 * self._view.stroke / 2
        step = _nice_step(2 * half, 8) / 5
        self.line([(LOAD_ZERO - STROKE_PIXELS / 2, SCALE_Y), (LOAD_ZERO + STROKE_PIXELS / 2, SCALE_Y)], GREY)
        for index in range(-math.floor(half / step + 1e-9), math.floor(half / step + 1e-9) + 1):
            x = LOAD_ZERO + self._pixels(index * step / 1e3)
            self.line([(x, SCALE_Y), (x, SCALE_Y + (3 if index % 5 else 7))], GREY)
            if index % 5 == 0:
                self.text(_number(index * step, 0), x, SCALE_Y - 13, GREY, 11, 0.5)
        self.text("mm", LOAD_ZERO + STROKE_PIXELS / 2 + 20, SCALE_Y - 13, GREY, 11)
        actual, wanted = (LOAD_ZERO + self._pixels(place) for place in (self._view.position, self._view.reference))
        self.line([(actual, SCALE_Y), (actual, AXIS_Y + 34)], POSITION, 1.5)
        self.dashed([(wanted, SCALE_Y), (wanted, GROUND_Y)], REFERENCE, 1.5)
        for x, y, color in ((actual, SCALE_Y + 9, POSITION), (wanted, SCALE_Y - 9, REFERENCE)):
            self.polygon([(x, SCALE_Y), (x - 5, y), (x + 5, y)], color)

    def _valve(self) -> None:
        """Draw the valve; a positive spool position moves the left box, P to A and B to T, over the ports."""
        middle, top, bottom = VALVE_X + self._view.spool_position * VALVE_BOX, VALVE_TOP, VALVE_BOTTOM
        for left in (middle + offset * VALVE_BOX for offset in (-1.5, -0.5, 0.5)):
            self.box(left, top, left + VALVE_BOX, bottom, WHITE)
        for y in (top - 4, bottom + 4):  # the two lines are the symbol of a continuous valve
            self.line([(middle - 1.5 * VALVE_BOX, y), (middle + 1.5 * VALVE_BOX, y)])
        for side in (-1, 1):
            port, edge = middle + side * PORT, middle + side * 1.5 * VALVE_BOX
            for end, inner in ((top, top + 12), (bottom, bottom - 12)):
                self.line([(port, end), (port, inner)])
                self.line([(port - 5, inner), (port + 5, inner)])
            self.box(min(edge, edge + side * 16), top + 12, max(edge, edge + side * 16), bottom - 12, WHITE)
            self.line([(edge, bottom - 12), (edge + side * 16, top + 12)])
        for box, start, end, upward in ((-1, -1, -1, True), (-1, 1, 1, False), (1, -1, 1, True), (1, -1, 1, False)):
            x, ends = middle + box * VALVE_BOX, (bottom - 3, top + 3) if upward else (top + 3, bottom - 3)
            self.arrow(x + start * PORT, ends[0], x + end * PORT, ends[1], 0.5)
        supply, tank = VALVE_X - PORT, VALVE_X + PORT
        self.polygon([(supply, bottom + 14), (supply - 7, bottom + 26), (supply + 7, bottom + 26)], INK)
        edges = ((tank - 9, bottom + 16), (tank - 9, bottom + 26), (tank + 9, bottom + 26), (tank + 9, bottom + 16))
        self.line(edges, INK, 1.5)
        for names, y, away in (("AB", top - 8, 8), ("PT", bottom + 18, 12)):
            self.text(names[0], supply - away, y, align=1)
            self.text(names[1], tank + away, y)

    def _bars(self) -> None:
        view = self._view
        self.text("Servo valve, % of full stroke", 488, PANEL_Y - 16, INK, 13)
        for row, (name, signal) in enumerate((("Command", view.command), ("Spool", view.spool_position))):
            share = 0.5 + 0.5 * min(1.0, max(-1.0, signal))
            texts, color = (name, _number(100 * signal, 0)), GREY if row else PISTON
            self._bar(row, texts, (488, 560, 672), (0.5, share), color)
            self.line([(616, PANEL_Y + ROW * row - 3), (616, PANEL_Y + ROW * row + 18)])
        for x, label in ((560, MINUS + "100"), (616, "0"), (672, "100")):
            self.text(label, x, PANEL_Y + 57, GREY, 11, 0.5)
        self.text("Pressure, bar", 734, PANEL_Y - 16, INK, 13)
        pressures = (("P_a", view.pressure_a), ("P_b", view.pressure_b), ("P_s", view.supply_pressure))
        for row, (name, pressure) in enumerate(pressures):
            share = min(1.0, max(0.0, pressure / BAR / self._pressure_scale))
            self._bar(row, (name, _number(pressure / BAR)), (734, 762, 890), (0.0, share), self._oil(pressure))
        for x in range(762, 890, 2):
            self.box(x, PANEL_Y + 75, x + 2, PANEL_Y + 81, _oil_color((x - 762) / 126), None)
        for part in (0.0, 0.5, 1.0):
            self.text(_number(part * self._pressure_scale, 0), 762 + 128 * part, PANEL_Y + 94, GREY, 11, 0.5)

    def _bar(self, row: int, texts: Sequence[str], places: Sequence[float], part: Sequence[float], fill: Color) -> None:
        """``texts`` are name and value, ``places`` the left edges of the name and the bar and the bar's right edge."""
        label, left, right = places
        y = PANEL_Y + ROW * row
        start, end = (left + share * (right - left) for share in sorted(part))
        self.text(texts[0], label, y + 12)
        self.box(left, y, right, y + 15, WHITE, FAINT)
        if end > start:
            self.box(start, y, end, y + 15, fill)
        self.text(texts[1], right + 42, y + 12, INK, 13, 1)

    def _history(self) -> None:
        view = self._view
        past = np.asarray(view.history_time, dtype=float)
        interval = view.sample_interval or (float(past[-1] - past[-2]) if len(past) > 1 else 0.0)
        preview = np.asarray(view.reference_preview if interval > 0 else (), dtype=float)
        stride = (len(past) + len(preview)) // PLOT_POINTS + 1
        preview = preview[::-stride][::-1]  # keeps the last sample, so that the axis does not move from frame to frame
        ahead = len(view.reference_preview) - stride * np.arange(len(preview))[::-1]
        coming = view.time + interval * np.append(0, ahead)
        until_now = np.append(past[::stride], view.time)
        position = 1e3 * np.append(view.history_position[::stride], view.position)
        reference = 1e3 * np.append(view.history_reference[::stride], view.reference)
        wanted = 1e3 * np.append(view.reference, preview)

        shown = np.concatenate((position, reference, wanted))
        spare = max(0.0, 20.0 - float(np.ptp(shown))) / 2  # a still axis is not magnified to noise
        span = _ticks(until_now[0], max(coming[-1], until_now[0] + 1), 40)[[0, -1]]
        values = _ticks(shown.min() - spare, shown.max() + spare, 4)
        self._axes(span, values)

        def curve(time: NDArray[np.floating], value: NDArray[np.floating]) -> NDArray[np.floating]:
            x = np.interp(time, span, (PLOT_LEFT, PLOT_RIGHT))
            return np.stack((x, np.interp(value, values[[0, -1]], (PLOT_BOTTOM, PLOT_TOP))), axis=1)

        self.dashed(curve(coming, wanted), REFERENCE_COMING, 1.5)
        self.dashed(curve(until_now, reference), REFERENCE, 1.5)
        self.line(curve(until_now, position), POSITION, 1.5)
        ((now, place),) = curve(until_now[-1:], position[-1:])
        self.line([(now, PLOT_TOP), (now, PLOT_BOTTOM)], GREY, 0.5)
        self.circle(now, place, 3.5, POSITION)

    def _axes(self, span: NDArray[np.floating], values: NDArray[np.floating]) -> None:
        self.box(PLOT_LEFT, PLOT_TOP, PLOT_RIGHT, PLOT_BOTTOM, WHITE, None)
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
        legend = PLOT_TOP - 16
        self.line([(710, legend), (740, legend)], POSITION, 2)
        self.text("Position", 746, legend + 4)
        self.dashed([(832, legend), (862, legend)], REFERENCE, 2)
        self.text("Reference", 868, legend + 4)


def _oil_color(share: float) -> Color:
    at, stops = min(1.0, max(0.0, share)), (0.0, 0.5, 1.0)
    red, green, blue = (round(float(np.interp(at, stops, channel))) for channel in zip(*OIL, strict=True))
    return red, green, blue


def _number(value: float, decimals: int = 1) -> str:
    return f"{round(value, decimals) + 0.0:.{decimals}f}".replace("-", MINUS)  # adding 0 turns -0 into 0


def _nice_step(span: float, parts: int) -> float:
    """The smallest 1, 2 or 5 times a power of ten that covers the span in at most ``parts`` parts."""
    power = 10.0 ** math.floor(math.log10(span / parts))
    return next(factor * power for factor in (1, 2, 5, 10) if factor * power * parts >= span * (1 - 1e-9))


def _ticks(low: float, high: float, parts: int) -> NDArray[np.floating]:
    step = _nice_step(high - low, parts)
    return step * np.arange(math.floor(low / step + 1e-9), math.ceil(high / step - 1e-9) + 1)
