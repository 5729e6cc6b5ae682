"""How exact the integrator is: its error against the reference solver, its order, and its error against its speed.

A case is a rig drawn over the whole randomised range with a leak of 0.001 to 4 l/min, a start in motion and under
pressure at a place that it can hold, and 0.2 s of one of three inputs: held voltages of any size, a new voltage in
every control period, or a sinusoid with noise. The reference is Radau IIA at a relative tolerance of 1e-10, which meets
limits by root finding (:mod:`hydro_env.plant.reference`).
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from hydro_env import PlantParameters, ServoHydraulicVectorEnv, simulate
from hydro_env.plant.kernel import TOLERANCE
from hydro_env.plant.probe import state_ranges

Array = NDArray[np.float64]

SAMPLE_TIME = 5e-3
"""s; each voltage is held this long."""

SAMPLES = 40
INPUTS = ("held", "noise", "sine")
SEED = 990_001
"""Not among the seeds with which the integrator was adjusted."""

BATCH = 20
"""Rigs that one run of the benchmark takes."""

SETTINGS: dict[str, dict[str, float]] = {
    **{
        f"tolerance {tolerance:g}" + (" (default)" if tolerance == TOLERANCE else ""): {"tolerance": tolerance}
        for tolerance in (1e-3, 1e-4, 1e-5, 1e-6, 1e-7, 1e-8)
    },
    **{
        f"steps of {1e3 * step:g} ms": {"tolerance": math.inf, "maximum_step": step}
        for step in (0.4e-3, 0.2e-3, 0.1e-3)
    },
}
"""Settings of the integrator that are compared, as keywords of :func:`hydro_env.simulate`."""

LIMIT = 1e-4
"""Error of any state, in parts of its range, that the default must stay within."""


@dataclass(frozen=True)
class Case:
    """One run: plant, voltages (V), initial state by name (SI), name of the input."""

    parameters: PlantParameters
    voltage: Array
    start: dict[str, float]
    signal: str

    def run(self, **options: Any) -> Array:
        """States, shape (SAMPLES + 1, N_STATES); options as in :func:`hydro_env.simulate`."""
        return simulate(self.parameters, self.voltage, SAMPLE_TIME, self.start, **options).states

    def ranges(self, exact: Array) -> Array:
        """Range of each state along a run, at least 1 % of its size."""
        return state_ranges(self.parameters, exact)


def random_cases(count: int, seed: int = SEED, **task: Any) -> list[Case]:
    """Cases drawn with a seed; ``task`` as in :class:`~hydro_env.ServoHydraulicVectorEnv`."""
    env = ServoHydraulicVectorEnv(count, **task)
    env.reset(seed=seed)
    cases = []
    for number in range(count):
        generator = np.random.default_rng([seed, number])
        signal = INPUTS[number % len(INPUTS)]
        start = {
            "position": float(env.axes.state[number, 0]),
            "velocity": float(generator.uniform(-0.1, 0.1)),
            "pressure_a": float(generator.uniform(2e5, 60e5)),
            "pressure_b": float(generator.uniform(2e5, 60e5)),
            "spool_position": float(generator.uniform(-0.5, 0.5)),
        }
        cases.append(Case(env.axes.parameters(number), _voltage(signal, generator), start, signal))
    env.close()
    return cases


def _voltage(signal: str, generator: np.random.Generator) -> Array:
    if signal == "held":
        return np.array(np.repeat(generator.uniform(-10.0, 10.0, SAMPLES // 8), 8))
    if signal == "noise":
        return generator.uniform(-10.0, 10.0, SAMPLES)
    turns = np.arange(SAMPLES) * generator.uniform(0.05, 0.6) + generator.uniform(0.0, 6.0)
    sine = generator.uniform(1.0, 5.0) * np.sin(turns) + generator.normal(0.0, 0.1, SAMPLES)
    return np.array(np.clip(sine, -10.0, 10.0))


def reference(case: Case) -> Array:
    """States of a case by the reference solver."""
    return case.run(method="radau")


def references(cases: list[Case], workers: int) -> Iterator[Array]:
    """The reference of each case, in order; a second or two each."""
    if workers == 1:
        yield from map(reference, cases)
        return
    with ProcessPoolExecutor(workers) as pool:
        yield from pool.map(reference, cases)


def errors(cases: list[Case], exact: Sequence[Any], **options: Any) -> Array:
    """Largest error of each state along each case in parts of its range, shape (cases, N_STATES)."""
    return np.array(
        [
            np.abs(case.run(**options) - states).max(axis=0) / case.ranges(states)
            for case, states in zip(cases, exact, strict=True)
        ]
    )


ORDER_STEPS = (0.4e-3, 0.2e-3, 0.1e-3)
"""s; steps of fixed length between which the order is told."""


def convergence_order(steps: tuple[float, ...] = ORDER_STEPS) -> pd.DataFrame:
    """Error of fixed steps on a smooth run of the paper's rig, and the order from one step to the next.

    Smooth: no dry friction, small voltages, so that no limit is met and nothing turns sharply. Columns: ``step_ms``,
    ``error`` (largest of any state, in parts of its range), ``order``.
    """
    plant = PlantParameters().replace(friction={"model": "none"}, valve={"underlap": 0.3})
    voltage = np.sin(np.arange(SAMPLES) * 0.2)
    case = Case(plant, voltage, {"position": 0.01}, "sine")
    exact = case.run(tolerance=1e-12, maximum_step=0.02e-3)
    found = [float(errors([case], [exact], tolerance=math.inf, maximum_step=step).max()) for step in steps]
    order = [math.nan]
    for index in range(1, len(steps)):
        order.append(math.log(found[index - 1] / found[index]) / math.log(steps[index - 1] / steps[index]))
    return pd.DataFrame({"step_ms": [1e3 * step for step in steps], "error": found, "order": order})
