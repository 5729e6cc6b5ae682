"""Tools that all experiments share: runs at several leaks and plants, their tables, fits of sines."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from hydro_agents.controllers.base import Controller, Floats
from hydro_agents.running.cases import Cases, Rollout, run_cases
from hydro_env import TaskConfig
from hydro_env.plant.analysis import force_limits, reachable_range, speed_limits
from hydro_env.plant.parameters import PlantParameters
from hydro_env.task.signals import observation_layout

Array = NDArray[np.float64]

LEAKS = (0.01, 1.0, 4.0)
"""l/min at 100 bar: a tight seal, the bound between moderate and severe, a severe leak."""

PLACE = 0.3
"""Working position: share of the range that the supply of the nominal rig can hold, outwards from mid-stroke.

There a spring pushes against the piston; its pressure difference drives the leak.
"""


@dataclass(frozen=True)
class Sweep:
    """Runs of one controller on the same plants at several leaks; N = leaks x plants."""

    leakage_flow_lpm: Array  # (N,)
    seeds: NDArray[np.int64]  # (N,)
    rollout: Rollout

    def table(self, controller: str, **columns: Any) -> pd.DataFrame:
        """One row per run: controller, leakage_flow_lpm, seed, and further columns, each (N,) or one value."""
        runs = {"leakage_flow_lpm": self.leakage_flow_lpm, "seed": self.seeds}
        return pd.DataFrame({"controller": controller, **runs, **columns})


def run_sweep(
    config: TaskConfig,
    controller: Controller,
    leaks: Sequence[float],
    plants: int,
    first_seed: int,
    signal_columns: Sequence[int] | None = None,
) -> Sweep:
    """Run a controller on the same plants at every leak.

    Raises:
        ControllerError: the controller raises an exception or returns no finite commands.
    """
    flow = np.repeat(np.asarray(leaks, dtype=np.float64), plants)
    seeds = np.tile(np.arange(first_seed, first_seed + plants), len(leaks))
    return Sweep(flow, seeds, run_cases(config, controller, Cases(seeds, flow), signal_columns))


def working_place(plant: PlantParameters, share: float = PLACE) -> float:
    """Position in m at a share (−1 to 1) of the range that the supply of the nominal rig can hold."""
    low, high = reachable_range(plant)
    return share * high if share > 0.0 else -share * low


def full_force(plant: PlantParameters) -> float:
    """The smaller of the two largest steady forces of the nominal rig, N."""
    return min(force_limits(plant))


def full_speed(plant: PlantParameters, position: float) -> float:
    """The smaller of the two steady speeds of the nominal rig at full command at a position (m), m/s."""
    return min(speed_limits(plant, plant.load.spring_stiffness * position + plant.load.external_force))


def sine_fit(values: Floats, time: Array, frequency: float) -> tuple[NDArray[np.complex128], Array]:
    """Least-squares fit of offset + drift · t + Re(amplitude · exp(j 2π f t)) to rows of samples.

    Args:
        values: (N, T).
        time: (T,), s.
        frequency: Hz.

    Returns:
        Complex amplitudes (N,), and the root mean square of the residual (N,).
    """
    angle = 2.0 * np.pi * frequency * time
    basis = np.stack([np.cos(angle), np.sin(angle), np.ones_like(time), time - time.mean()], axis=1)
    rows = np.asarray(values, dtype=np.float64)
    fit, *_ = np.linalg.lstsq(basis, rows.T, rcond=None)
    rest: Array = np.sqrt(np.mean((rows - (basis @ fit).T) ** 2, axis=1))
    return fit[0] - 1j * fit[1], rest


class HiddenPreview:
    """A controller without preview: each previewed value equals the present reference."""

    def __init__(self, controller: Controller, config: TaskConfig) -> None:
        self.controller = controller
        names = observation_layout(config)[0]
        self.columns = [column for column, name in enumerate(names) if name.startswith("reference_preview_")]

    def predict(
        self, observation: Floats, state: Any = None, episode_start: Any = None, deterministic: bool = True
    ) -> tuple[NDArray[np.float32], Any]:
        """Commands of the controller; see :class:`~hydro_agents.controllers.base.Controller`."""
        shown = np.array(observation)
        shown[..., self.columns] = 0.0
        return self.controller.predict(shown, state, episode_start, deterministic)
