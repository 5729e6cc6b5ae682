"""What the leak costs: power drawn from the supply while holding, energy of a start–stop cycle."""

from __future__ import annotations

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from agents.reproduction.drawing import COLOURS, ReproducedFigure, legend, panel_title
from agents.reproduction.rig import LAWS, SAMPLE_TIME, Law, with_leak
from hydro_env import PlantParameters, equilibrium, simulate

LEAKS = (0.01, 0.03, 0.1, 0.3, 1.0, 2.0, 4.0)
HELD = {"0 mm": 0.0, "+40 mm": 0.04}
MOVES = ((0.25, 4.0), (0.25, None), (0.25, -4.0), (0.25, None))
START = 0.005


def energy_table(base: PlantParameters) -> pd.DataFrame:
    """Power (W) drawn at port P while holding two places, energy (J) of one start–stop cycle, by law and leak."""
    rows = []
    for law in LAWS:
        for leak in LEAKS:
            plant = with_leak(base, leak, law)
            row: dict[str, float | str] = {"law": law, "leak_lpm": leak}
            for words, position in HELD.items():
                _, voltage = equilibrium(plant, position)
                run = simulate(plant, [voltage], SAMPLE_TIME, {"position": position})
                row[f"holding_{words.replace('+', '').replace(' ', '_')}_w"] = float(
                    run.supply_pressure[0] * run.supply_flow[0]
                )
            row["cycle_j"] = _cycle_energy(plant)
            rows.append(row)
    return pd.DataFrame(rows)


def _cycle_energy(plant: PlantParameters) -> float:
    _, holding = equilibrium(plant, START)
    voltage = np.concatenate(
        [np.full(round(time / SAMPLE_TIME), holding if volts is None else volts) for time, volts in MOVES]
    )
    run = simulate(plant, voltage, SAMPLE_TIME, {"position": START})
    return float(np.trapezoid(run.supply_pressure * run.supply_flow, run.time))


def paint_energy(figure: Figure, table: pd.DataFrame) -> None:
    """Power while holding; energy of a cycle."""
    left, right = figure.subplots(1, 2)
    styles: dict[Law, str] = {"laminar": "-", "throttle": "--"}
    for law, style in styles.items():
        part = table[table["law"] == law]
        for colour, words, column in zip(COLOURS, HELD, ("holding_0_mm_w", "holding_40_mm_w"), strict=False):
            left.plot(
                part["leak_lpm"],
                part[column],
                color=colour,
                linestyle=style,
                label=f"{words}, {law}",
                marker="o",
                markersize=3,
            )
        right.plot(
            part["leak_lpm"], part["cycle_j"], color=COLOURS[2], linestyle=style, label=law, marker="o", markersize=3
        )
    for axes in (left, right):
        axes.set(xscale="log", xlabel="leak, l/min at 100 bar", ylim=(0.0, None))
        axes.set_xticks(LEAKS, [f"{leak:g}" for leak in LEAKS])
        axes.minorticks_off()
        legend(axes, loc="upper left")
    left.set_ylabel("power from the supply, W")
    right.set_ylabel("energy from the supply, J")
    panel_title(left, "While holding")
    panel_title(right, "One start–stop cycle of 1 s")


def energy_figure(base: PlantParameters) -> ReproducedFigure:
    """The cost of a leak with its words."""
    table = energy_table(base)
    part = table[table["law"] == "throttle"].set_index("leak_lpm")
    first, last = part.iloc[0], part.iloc[-1]
    return ReproducedFigure(
        key="supply_energy",
        title="Further: what the leak costs",
        table=table,
        paint=paint_energy,
        height=3.6,
        paper="The paper looks at motion only. A leak is also oil that the pump delivers for nothing.",
        how="Supply pressure times the flow at port P; the rig as assumed. The cycle: 4 V for 0.25 s from +5 mm, stop, "
        "−4 V for 0.25 s, stop; at a stop the command that holds the start.",
        found=[
            f"Holding +40 mm takes {first['holding_40_mm_w']:.1f} W with the tight seal (the valve's null leakage) and "
            f"{last['holding_40_mm_w']:.1f} W at {LEAKS[-1]:g} l/min through a throttle; holding 0 mm "
            f"{first['holding_0_mm_w']:.1f} W and {last['holding_0_mm_w']:.1f} W.",
            f"One start–stop cycle draws {first['cycle_j']:.0f} J and {last['cycle_j']:.0f} J: moving hides the leak, "
            f"holding shows it.",
        ],
    )
