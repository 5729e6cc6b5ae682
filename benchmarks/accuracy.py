"""Error of the integrator against the reference solver, its order, and its time.

Run: python -m benchmarks.accuracy [--rigs 240] [--structure]      (ten minutes, an hour with structure)

A run is a rig drawn over the whole randomised range with a leak of 0.001 to 4 l/min, an initial state in motion and
under pressure at a position that it can hold, and 0.2 s of one of three inputs: held voltages of any size, a new
voltage in every control period, or a sine with noise. The reference is Radau IIA at a relative tolerance of 1e-10,
which locates limits by root finding (:mod:`hydro_env.plant.reference`). With ``--structure`` two of three rigs have
lines with waves, two of three a second mass, and every second one sharp edges.
"""

import contextlib
import math
import time
from collections.abc import Iterable
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np

from benchmarks import command_line
from hydro_agents.running.seeds import ACCURACY
from hydro_agents.running.text import markdown
from hydro_env import HydroError, PlantParameters, ServoHydraulicVectorEnv, simulate
from hydro_env.plant.arrays import plant_coefficients
from hydro_env.plant.equations import parts_of, weights
from hydro_env.plant.kernel import TOLERANCE
from hydro_env.plant.states import ALL_STATES, state_kind
from hydro_env.types import Floats

SAMPLE_TIME = 5e-3  # s; each voltage is held this long
SAMPLES = 40
INPUTS = ("held", "noise", "sine")
LIMIT = 1e-4  # largest allowed error of any state relative to its range, with the default settings
FIXED_STEPS = (0.4e-3, 0.2e-3, 0.1e-3)  # s; steps of fixed length, between which the order is computed
SETTINGS: dict[str, dict[str, float]] = {
    f"tolerance {tolerance:g}{' (default)' * (tolerance == TOLERANCE)}": {"tolerance": tolerance}
    for tolerance in (1e-3, 1e-4, 1e-5, 1e-6, 1e-7, 1e-8)
} | {f"steps of {1e3 * step:g} ms": {"tolerance": math.inf, "maximum_step": step} for step in FIXED_STEPS}
"""Settings of the integrator that are compared, as keywords of :func:`hydro_env.simulate`."""


@dataclass(frozen=True)
class Run:
    """One run: plant, voltages (V), initial state by name (SI), name of the input."""

    parameters: PlantParameters
    voltage: Floats
    start: dict[str, float]
    signal: str

    def states(self, **options: Any) -> Floats:
        """States, shape (SAMPLES + 1, N_STATES); options as in :func:`hydro_env.simulate`."""
        return simulate(self.parameters, self.voltage, SAMPLE_TIME, self.start, **options).states


def random_runs(count: int, structure: bool = False) -> list[Run]:
    """Random runs."""
    env = ServoHydraulicVectorEnv(count)
    env.reset(seed=ACCURACY.first)
    runs = []
    for number in range(count):
        generator, signal = np.random.default_rng([ACCURACY.first, number]), INPUTS[number % len(INPUTS)]
        start = {
            "position": float(env.axes.state[number, 0]),
            "velocity": float(generator.uniform(-0.1, 0.1)),
            "pressure_a": float(generator.uniform(2e5, 60e5)),
            "pressure_b": float(generator.uniform(2e5, 60e5)),
            "spool_position": float(generator.uniform(-0.5, 0.5)),
        }
        parameters = env.axes.parameters(number)
        if structure:
            parameters = _with_parts(parameters, number)
        runs.append(Run(parameters, _voltage(signal, generator), start, signal))
    env.close()
    return runs


def _with_parts(parameters: PlantParameters, number: int) -> PlantParameters:
    """The same rig with parts that it lacked."""
    draw = np.random.default_rng([ACCURACY.first, number, 1])
    length, area = float(draw.uniform(0.5, 6.0)), float(draw.uniform(3e-5, 2e-4))
    share, frequency = float(draw.uniform(0.2, 0.8)), float(2.0 * math.pi * draw.uniform(2.0, 30.0))
    if number % 3 != 1:
        lines = {"length_a": length, "length_b": length, "volume_a": area * length, "volume_b": area * length}
        parameters = parameters.replace(lines=lines)
    if number % 3 != 2:
        parameters = parameters.replace(load={"tip_share": share, "tip_frequency": frequency})
    if number % 2 == 1:
        parameters = parameters.replace(valve={"underlap": 0.0, "overlap": float(draw.uniform(-0.02, 0.05))})
    return parameters


def _voltage(signal: str, generator: np.random.Generator) -> Floats:
    if signal == "held":
        return np.array(np.repeat(generator.uniform(-10.0, 10.0, SAMPLES // 8), 8))
    if signal == "noise":
        return generator.uniform(-10.0, 10.0, SAMPLES)
    phase = np.arange(SAMPLES) * generator.uniform(0.05, 0.6) + generator.uniform(0.0, 6.0)
    sine = generator.uniform(1.0, 5.0) * np.sin(phase) + generator.normal(0.0, 0.1, SAMPLES)
    return np.array(np.clip(sine, -10.0, 10.0))


def reference(run: Run) -> Floats:
    """States of a run by the reference solver; takes a second or two."""
    return run.states(method="radau")


def state_ranges(parameters: PlantParameters, states: Floats) -> Floats:
    """Range of each state along a run, states (samples, N_STATES), at least 1 % of its full scale."""
    c, structure = plant_coefficients(parameters), parameters.structure
    emphasis = [ALL_STATES[name].emphasis for name in state_kind(structure)._fields]
    full_scale = np.array(emphasis) / np.array(weights(c, parts_of(structure)))
    ranges: Floats = np.maximum(np.ptp(states, axis=0), 0.01 * full_scale)
    return ranges


def errors(runs: Iterable[Run], exact: Iterable[Floats], **options: Any) -> Floats:
    """Largest error of each state along each run, as a fraction of its range, shape (runs, N_STATES)."""
    found = []
    for run, states in zip(runs, exact, strict=True):
        away = np.abs(run.states(**options) - states).max(axis=0)
        found.append(away / state_ranges(run.parameters, states))
    return np.array(found)


def convergence_orders() -> list[float]:
    """Order of the integrator from each fixed step to the next, on a smooth run of the paper's rig.

    The run is smooth: without dry friction and with small voltages the axis reaches no limit and has no sharp reversal.
    """
    plant = PlantParameters().replace(friction={"model": "none"}, valve={"underlap": 0.3})
    run = Run(plant, np.sin(np.arange(SAMPLES) * 0.2), {"position": 0.01}, "sine")
    exact = run.states(tolerance=1e-12, maximum_step=0.02e-3)
    largest = [errors([run], [exact], tolerance=math.inf, maximum_step=step).max() for step in FIXED_STEPS]
    return [float(order) for order in np.diff(np.log(largest)) / np.diff(np.log(FIXED_STEPS))]


def _begins(run: Run) -> bool:
    """Whether the axis can be held where it begins; another lap or a leak may leave it too little flow."""
    try:
        run.states()
    except HydroError:
        return False
    return True


def main() -> None:
    """Print the table: worst error and time of every setting over random runs, and the order of fixed steps."""
    given = command_line(__doc__, rigs=240, structure=False)
    runs = [run for run in random_runs(given.rigs, given.structure) if _begins(run)]
    print(f"{len(runs)} of {given.rigs} rigs hold the position at which they begin")
    with ProcessPoolExecutor() as pool:
        exact = list(pool.map(reference, runs))
    rows = []
    for name, options in SETTINGS.items():
        worst, seconds = np.full(len(runs), math.inf), 0.0  # steps that are too long may leave the valid range
        for number, run in enumerate(runs):
            with contextlib.suppress(HydroError):
                worst[number] = errors([run], [exact[number]], **options).max()
                began = time.perf_counter()
                run.states(**options)
                seconds += time.perf_counter() - began
        milliseconds = 1e3 * seconds / (np.isfinite(worst).sum() * SAMPLES * SAMPLE_TIME)
        rows.append([name, f"{worst.max():.2e}", f"{100.0 * (worst <= LIMIT).mean():.0f}", f"{milliseconds:.3g}"])
    within = f"rigs within {LIMIT:g}, %"
    print(markdown(("setting", "worst error, of a state's range", within, "ms per simulated s"), rows))
    for (coarse, fine), order in zip(pairwise(FIXED_STEPS), convergence_orders(), strict=True):
        print(f"order, steps of {1e3 * coarse:g} to {1e3 * fine:g} ms: {order:.2f}")


if __name__ == "__main__":
    main()
