"""What the leak costs: power drawn from the supply while holding, energy of a start–stop cycle."""

from __future__ import annotations

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from agents.reproduction.drawing import COLOURS, ReproducedFigure, legend, millimetres, panel_title
from agents.reproduction.rig import LAWS, Law, Rig, with_leak
from hydro_env import PlantParameters, equilibrium, simulate

LEAKS = (0.01, 0.03, 0.1, 0.3, 1.0, 2.0, 4.0)
MOVES = ((0.25, 1.0), (0.25, None), (0.25, -1.0), (0.25, None))
"""s (times Rig.stretch) and parts of Rig.voltage; None holds the start."""


def held_places(rig: Rig) -> dict[str, float]:
    """Two places to hold, m: mid-stroke on the paper's rig and the start elsewhere, and the rig's place to hold."""
    return {"first": 0.0 if rig.is_paper else rig.start, "second": rig.hold}


def energy_table(rig: Rig) -> pd.DataFrame:
    """Power (W) drawn at port P while holding two places, energy (J) of one start–stop cycle, by law and leak."""
    rows = []
    for law in LAWS:
        for leak in LEAKS:
            plant = with_leak(rig.parameters, leak, law)
            row: dict[str, float | str] = {"law": law, "leak_lpm": leak}
            for name, position in held_places(rig).items():
                _, voltage = equilibrium(plant, position)
                run = simulate(plant, [voltage], rig.sample_time, {"position": position})
                row[f"{name}_place_mm"] = 1e3 * position
                row[f"holding_{name}_w"] = float(run.supply_pressure[0] * run.supply_flow[0])
            row["cycle_j"] = cycle_energy(plant, rig)
            rows.append(row)
    return pd.DataFrame(rows)


def cycle_energy(plant: PlantParameters, rig: Rig) -> float:
    """Energy in J drawn at port P in one start–stop cycle."""
    _, holding = equilibrium(plant, rig.start)
    voltage = np.concatenate(
        [
            np.full(rig.count(rig.stretch * time), holding if share is None else share * rig.voltage)
            for time, share in MOVES
        ]
    )
    run = simulate(plant, voltage, rig.sample_time, {"position": rig.start})
    return float(np.trapezoid(run.supply_pressure * run.supply_flow, run.time))


def paint_energy(figure: Figure, table: pd.DataFrame) -> None:
    """Power while holding; energy of a cycle."""
    left, right = figure.subplots(1, 2)
    styles: dict[Law, str] = {"laminar": "-", "throttle": "--"}
    for law, style in styles.items():
        part = table[table["law"] == law]
        for colour, name in zip(COLOURS, ("first", "second"), strict=False):
            words = millimetres(part[f"{name}_place_mm"].iloc[0])
            left.plot(
                part["leak_lpm"],
                part[f"holding_{name}_w"],
                color=colour,
                linestyle=style,
                label=f"{words}, {law}",
                marker="o",
                markersize=3,
                linewidth=2.8 if name == "first" else 1.2,  # where both are the same, both are seen
            )
        right.plot(
            part["leak_lpm"], part["cycle_j"], color=COLOURS[2], linestyle=style, label=law, marker="o", markersize=3
        )
    for axes in (left, right):
        axes.set(xscale="log", xlabel="leak, l/min at 100 bar", ylim=(0.0, 1.6 * _largest(table, axes is left)))
        axes.set_xticks(LEAKS, [f"{leak:g}" for leak in LEAKS])
        axes.minorticks_off()
        legend(axes, loc="upper left", handlelength=3.5)
    left.set_ylabel("power from the supply, W")
    right.set_ylabel("energy from the supply, J")
    panel_title(left, "While holding")
    panel_title(right, "One start–stop cycle")


def _largest(table: pd.DataFrame, holding: bool) -> float:
    return float(table[["holding_first_w", "holding_second_w"] if holding else ["cycle_j"]].max().max())


def energy_figure(rig: Rig) -> ReproducedFigure:
    """The cost of a leak with its words."""
    table = energy_table(rig)
    part = table[table["law"] == "throttle"].set_index("leak_lpm")
    first, last, places = part.iloc[0], part.iloc[-1], held_places(rig)
    hides = last["cycle_j"] / first["cycle_j"] < last["holding_second_w"] / first["holding_second_w"]
    return ReproducedFigure(
        table=table,
        paint=paint_energy,
        height=3.6,
        paper="The paper looks at motion only. A leak is also oil that the pump delivers for nothing.",
        how=f"Supply pressure times the flow at port P; the rig as assumed. The cycle: {rig.voltage:g} V for "
        f"{0.25 * rig.stretch:.2f} s from {1e3 * rig.start:+.0f} mm, stop, {-rig.voltage:g} V as long, stop; at a stop "
        f"the command that holds the start.",
        found=[
            f"Holding {1e3 * places['second']:+.0f} mm takes {first['holding_second_w']:.1f} W with the tight seal "
            f"(the "
            f"valve's null leakage) and {last['holding_second_w']:.1f} W at {LEAKS[-1]:g} l/min through a throttle; "
            f"holding {1e3 * places['first']:.0f} mm {first['holding_first_w']:.1f} W and "
            f"{last['holding_first_w']:.1f} W.",
            f"One start–stop cycle draws {first['cycle_j']:.0f} J and {last['cycle_j']:.0f} J at {LEAKS[-1]:g} l/min, "
            f"{_times(last['cycle_j'] / first['cycle_j'])}; holding takes "
            f"{_times(last['holding_second_w'] / first['holding_second_w'])}"
            f"{': moving hides the leak, holding shows it' if hides else ''}.",
        ],
    )


def _times(ratio: float) -> str:
    return f"{ratio:.1f} times as much" if abs(ratio - 1.0) > 0.05 else "as much as without the leak"
