"""Fig. 12: the displacement that the rig records in start–stop moves, at several leaks."""

from __future__ import annotations

from typing import Any

import numpy as np
import pandas as pd
from matplotlib.figure import Figure
from numpy.typing import NDArray

from agents.reproduction.drawing import LEAK_COLOURS, ReproducedFigure, legend, panel_title
from agents.reproduction.rig import Rig, simplified, with_leak
from agents.reproduction.signals import recorded
from hydro_env import equilibrium, simulate

LEAKS = (0.01, 0.3, 1.0, 2.0, 4.0)
"""l/min at 100 bar."""

MOVES = ((0.25, 1.0), (0.45, 0.0), (0.25, 1.0), (0.45, 0.0), (0.5, -1.0), (0.5, 0.0))
"""s (times Rig.stretch) and parts of Rig.voltage, after the start is held: two moves out, one
back, a stop after each."""

HELD = 0.1
"""s; so long the start is held first. Times Rig.stretch, like all times here."""

ENLARGED = (0.01, 1.0, 4.0)
"""Leaks of which the stop is drawn enlarged."""

FIRST_STOP = 0.35
"""s; the first command to stop."""

SEED = 12


def start_stop_voltage(rig: Rig, holding: float) -> NDArray[np.float64]:
    """The commands, one per sample, V; first the one that holds the start."""
    commands = ((HELD, holding), *((duration, share * rig.voltage) for duration, share in MOVES))
    return np.concatenate([np.full(rig.count(rig.stretch * duration), volts) for duration, volts in commands])


def displacement_table(rig: Rig) -> pd.DataFrame:
    """Recorded and true displacement over time for each leak; throttle in parallel, open loop.

    ``friction``: whether the seals rub; without friction alone where the rig has none. Every run sees the same noise
    and bias, as one transducer would give.
    """
    base, parts = rig.parameters, []
    for friction in (True, False) if rig.has_friction else (False,):
        for leak in LEAKS:
            plant = with_leak(simplified(base, base.friction.model if friction else "none", True), leak, "throttle")
            _, holding = equilibrium(plant, rig.start)
            run = simulate(plant, start_stop_voltage(rig, holding), rig.sample_time, {"position": rig.start})
            signal = recorded(run.position, rig.transducer, np.random.default_rng(SEED))
            parts.append(
                pd.DataFrame(
                    {
                        "friction": friction,
                        "leak_lpm": leak,
                        "time_s": run.time,
                        "command_v": run.voltage,
                        "recorded_position_mm": 1e3 * signal,
                        "true_position_mm": 1e3 * run.position,
                    }
                )
            )
    return pd.concat(parts, ignore_index=True)


def summary(table: pd.DataFrame, stretch: float = 1.0) -> pd.DataFrame:
    """Per friction and leak: length of the first move, drift in the 0.4 s after it, swing of the true position, mm."""
    rows = []
    for (friction, leak), part in table.groupby(["friction", "leak_lpm"]):
        time, true, seen = (part[name].to_numpy() for name in ("time_s", "true_position_mm", "recorded_position_mm"))
        time = time / stretch
        moved = np.interp(FIRST_STOP + 0.03, time, true) - true[0]
        late = (time > FIRST_STOP + 0.40) & (time < FIRST_STOP + 0.44)
        early = (time > FIRST_STOP + 0.04) & (time < FIRST_STOP + 0.09)
        straight = np.polyval(np.polyfit(time[early], true[early], 2), time[early])
        rows.append(
            {
                "friction": friction,
                "leak_lpm": leak,
                "move_mm": moved,
                "drift_mm": float(true[late].mean() - np.interp(FIRST_STOP + 0.03, time, true)),
                "swing_mm": float(np.ptp(true[early] - straight)),
                "noise_mm": float(np.std((seen - true)[time < HELD])),
            }
        )
    return pd.DataFrame(rows)


def paint_displacement(figure: Figure, table: pd.DataFrame) -> None:
    """The whole move, and what follows the first stop, enlarged, with and without friction."""
    parts: Any = figure.subfigures(2, 1, height_ratios=[1.25, 1.0])
    frictions = [bool(friction) for friction in table["friction"].unique()]
    whole, panels = parts[0].subplots(), parts[1].subplots(1, len(frictions), sharey=True, squeeze=False)[0]
    stretch = float(table["time_s"].max()) / (HELD + sum(duration for duration, _ in MOVES))
    stop, low, high = stretch * FIRST_STOP, 0.0, 0.0
    for colour, leak in zip(LEAK_COLOURS, LEAKS, strict=True):
        for friction, axes in zip(frictions, panels, strict=True):
            part = table[(table["leak_lpm"] == leak) & (table["friction"] == friction)]
            time, seen = part["time_s"].to_numpy(), part["recorded_position_mm"].to_numpy()
            if friction == frictions[0]:
                whole.plot(time, seen, color=colour, linewidth=1.2, label=f"{leak:g} l/min")
            if leak not in ENLARGED:
                continue
            window = (time >= stop - 0.01 * stretch) & (time <= stop + 0.15 * stretch)
            at_stop = seen[(time > stop + 0.02 * stretch) & (time < stop + 0.05 * stretch)].mean()
            axes.plot(1e3 * (time[window] - stop), seen[window] - at_stop, color=colour, linewidth=1.0)
            later = seen[window & (time > stop + 0.005 * stretch)] - at_stop
            low, high = min(low, float(later.min())), max(high, float(later.max()))
    command = table[(table["leak_lpm"] == LEAKS[0]) & (table["friction"] == frictions[0])]
    volts = command["command_v"].to_numpy()
    moving = np.abs(volts) > 0.9 * np.abs(volts).max()
    bottom, top = whole.get_ylim()
    whole.fill_between(command["time_s"], bottom, top, where=moving.tolist(), color="#000000", alpha=0.05, linewidth=0)
    whole.set(xlabel="time, s", ylabel="recorded position, mm", ylim=(bottom, top), xlim=(0.0, command["time_s"].max()))
    volt = float(volts.max())
    panel_title(whole, f"Start–stop moves (grey: valve commanded open, +{volt:g} V twice, then −{volt:g} V)")
    legend(whole, title="leak at 100 bar", loc="upper right")
    for axes, friction in zip(panels, frictions, strict=True):
        axes.set(xlabel="time after the first stop command, ms", xlim=(-10 * stretch, 150 * stretch))
        axes.set_ylim(1.5 * low, 1.15 * high)
        panel_title(axes, f"After the first stop, {'with' if friction else 'no'} friction")
    panels[0].set_ylabel("recorded position, mm\n(from the place of the stop)")


def displacement_figure(rig: Rig) -> ReproducedFigure:
    """Fig. 12 with its words."""
    table = displacement_table(rig)
    told = summary(table, rig.stretch)
    without = told[~told["friction"]]
    rubbing = told[told["friction"]] if rig.has_friction else without
    tight, worst = rubbing.iloc[0], rubbing.iloc[-1]
    noise = float(told["noise_mm"].mean())
    less = worst["move_mm"] < tight["move_mm"]
    swing = [float(without.iloc[row]["swing_mm"]) for row in (0, -1)]
    sensor, late = rig.transducer, rig.stretch
    differs = []
    if not less:
        differs.append(
            "The axis does not get slower with the leak here: an external force or the direction of the pressure "
            "difference lets the leak help the first move."
        )
    elif worst["move_mm"] > 0.95 * tight["move_mm"]:
        differs.append(
            f"The slowing is small: {100 * (1 - worst['move_mm'] / tight['move_mm']):.1f} % of the way at "
            f"{worst['leak_lpm']:g} l/min."
        )
    if rig.has_friction and max(float(row["swing_mm"]) for row in (tight, worst)) < noise:
        differs.append(
            f"With the friction of the rig no swing above the noise is left {40 * late:.0f} ms after the stop, "
            f"whatever "
            f"the leak ({float(tight['swing_mm']):.3f} mm with the tight seal, {float(worst['swing_mm']):.3f} mm at "
            f"{worst['leak_lpm']:g} l/min): friction, not leakage, stops it. What the leak changes is the length of "
            f"the move and the creep."
        )
    if swing[1] > swing[0]:
        differs.append("Without friction the swing after the stop does not fall with the leak.")
    return ReproducedFigure(
        table=table,
        paint=paint_displacement,
        height=6.4,
        equations="(1)–(3), (8)–(14), (17)",
        paper="Fig. 12 shows recorded displacements at start–stop; the text reads from it that more leakage slows the "
        "axis and damps it.",
        how=f"Valve commands of ±{rig.voltage:g} V without feedback, a throttle between the chambers as on the paper's "
        f"rig. The position goes through the transducer as the environment models it"
        f"{'' if rig.is_paper else ', stretched to this stroke'}: noise {1e3 * sensor.noise:.3f} mm, a constant error "
        f"of at most {1e3 * sensor.bias:.3f} mm, 16-bit steps of {1e3 * sensor.resolution:.3f} mm."
        f"{'' if rig.has_friction else ' This rig has no dry friction, so that there is no panel with friction.'}",
        found=[
            f"More leakage makes the same command move {'less' if less else 'more'}: {tight['move_mm']:.1f} mm at "
            f"{tight['leak_lpm']:g} l/min, {worst['move_mm']:.1f} mm at {worst['leak_lpm']:g} l/min.",
            f"After the first stop the axis creeps on by {tight['drift_mm']:+.2f} mm in {0.4 * late:.1f} s with the "
            f"tight seal and by {worst['drift_mm']:+.2f} mm at {worst['leak_lpm']:g} l/min.",
            f"Without friction the oscillation {40 * late:.0f} to {90 * late:.0f} ms after the stop is "
            f"{swing[0]:.2f} mm "
            f"from peak to peak with the tight seal and {swing[1]:.2f} mm at {worst['leak_lpm']:g} l/min; the recorded "
            f"noise has a standard deviation of {noise:.3f} mm. An accelerometer sees it better, as the paper says.",
        ],
        differs=differs,
    )
