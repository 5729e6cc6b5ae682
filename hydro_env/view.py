"""The numbers that the drawing of an axis shows."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from hydro_env.plant.states import State

if TYPE_CHECKING:
    from hydro_env.axes import Axes


@dataclass(frozen=True)
class View:
    """One picture as numbers; SI units."""

    time: float
    position: float
    velocity: float
    reference: float
    reference_preview: NDArray[np.floating]  # (n,) coming samples in m, spaced as the history is; may be empty
    pressure_a: float  # Pa gauge, as the other pressures
    pressure_b: float
    supply_pressure: float
    spool_position: float  # -1 to 1
    command: float  # -1 to 1
    leakage_flow_lpm: float  # l/min at 100 bar
    external_force: float  # N; positive pushes against extension
    stroke: float
    bore_diameter: float
    rod_diameter: float
    has_spring: bool
    history_time: NDArray[np.floating]  # (m,) past samples of the episode, as the two below
    history_position: NDArray[np.floating]
    history_reference: NDArray[np.floating]
    sample_interval: float = 0.0  # s; 0: that of the history

    @classmethod
    def of(cls, axes: Axes, history: Sequence[tuple[float, float]]) -> View:
        """The first axis now; ``history`` holds position and reference (m) of each sample that is drawn."""
        record = axes.record[0]
        config = axes.tasks[int(record["rig"])]
        state, step, cylinder = State(*axes.state[0]), int(record["step"]), config.plant.cylinder
        past = np.array(history).reshape(-1, 2)
        return cls(
            time=step * config.control_period,
            position=state.position,
            velocity=state.velocity,
            reference=record["reference"],
            reference_preview=axes.reference[0, step + 1 : config.steps + 1].copy(),
            pressure_a=state.pressure_a,
            pressure_b=state.pressure_b,
            supply_pressure=state.supply_pressure,
            spool_position=state.spool_position,
            command=record["command"],
            leakage_flow_lpm=record["leak_flow"],
            external_force=axes.external_force(0),
            stroke=cylinder.stroke,
            bore_diameter=cylinder.bore_diameter,
            rod_diameter=cylinder.rod_diameter,
            has_spring=axes.parameters(0).load.spring_stiffness > 0.0,
            history_time=config.control_period * np.arange(step + 1 - len(past), step + 1),
            history_position=past[:, 0],
            history_reference=past[:, 1],
            sample_interval=config.control_period,
        )
