"""Test vectors of an exported controller: measured signals of several episodes, and the correct voltages."""

from __future__ import annotations

import csv
import io
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hydro_agents.export.measured import MeasuredController, MeasuredMemory
from hydro_agents.running.seeds import CONTROLLER_VECTORS
from hydro_env import HydroError, ServoHydraulicVectorEnv
from hydro_env.units import FULL_VOLTAGE

FAMILIES = ("step", "multi_sine", "start_stop")
"""References of the closed-loop episodes, if the task has them."""

LONGEST = 250
"""Control periods per episode of the vectors."""


@dataclass(frozen=True)
class Vectors:
    """Consecutive samples; a 1 in ``start`` begins an episode."""

    names: tuple[str, ...]
    start: NDArray[np.bool_]  # (samples,)
    signals: NDArray[np.float64]  # (samples, signals), SI
    voltage: NDArray[np.float64]  # (samples,), V

    def text(self) -> str:
        """As CSV; every number reads back exactly."""
        file = io.StringIO()
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(["start", *self.names, "voltage"])
        for start, signals, voltage in zip(self.start, self.signals, self.voltage, strict=True):
            writer.writerow([int(start), *(repr(float(value)) for value in (*signals, voltage))])
        return file.getvalue()


def make_vectors(measured: MeasuredController) -> Vectors:
    """Closed-loop episodes under the controller, and one with lost samples and values out of range.

    The voltages of the closed-loop episodes come from ``predict`` with the observations of the environment: they also
    check that the signals in SI units give the same observations.
    """
    config, signals = measured.signals.config, measured.signals
    families: list[str | None] = [name for name in FAMILIES if config.references.weights.get(name, 0.0) > 0.0]
    length = min(LONGEST, config.steps)
    env = ServoHydraulicVectorEnv(1, config, info=False)
    episodes: list[tuple[NDArray[np.float64], list[float]]] = []
    families = families or [None]
    for seed, family in zip(CONTROLLER_VECTORS.take(len(families)), families, strict=True):
        options = {"reference": [family]} if family is not None else None
        observation, _ = env.reset(seed=[seed], options=options)
        samples, voltages, memory = [], [], None
        for _ in range(length):
            samples.append(signals.of_axes(env.axes)[0])
            action, memory = measured.controller.predict(observation, memory)
            voltages.append(FULL_VOLTAGE * float(np.clip(np.float64(action[0, 0]), -1.0, 1.0)))
            observation, _, terminated, truncated, _ = env.step(action)
            if terminated[0] or truncated[0]:
                break
        episodes.append((np.array(samples), voltages))
    env.close()
    disturbed = _disturbed(np.resize(episodes[0][0], (120, len(signals.signals))))
    state: MeasuredMemory | None = None
    voltages = []
    for row in disturbed:
        voltage, state = measured(row, state)
        voltages.append(voltage)
    episodes.append((disturbed, voltages))
    if not all(np.isfinite(voltages).all() for _, voltages in episodes):
        raise HydroError(f"{type(measured.controller).__name__}: its voltage is not finite: cannot be exported")
    starts: Sequence[NDArray[np.bool_]] = [np.arange(len(voltages)) == 0 for _, voltages in episodes]
    return Vectors(
        tuple(signal.name for signal in signals.signals),
        np.concatenate(starts),
        np.concatenate([rows for rows, _ in episodes]),
        np.concatenate([np.array(voltages) for _, voltages in episodes]),
    )


def _disturbed(samples: NDArray[np.float64]) -> NDArray[np.float64]:
    """Samples with lost ones at the start, of each signal in turn and of all at once, and values out of range."""
    rows, count = samples.copy(), samples.shape[1]
    rows[:2, -2] = np.nan  # the controller waits
    for signal in range(count):
        rows[10 + 4 * signal : 12 + 4 * signal, signal] = (np.nan, np.inf)
    rows[60:63] = np.nan
    for place, factor in enumerate((1e3, -1e3, 1e6, -1e6)):
        rows[70 + 10 * place : 73 + 10 * place] *= factor
    return rows
