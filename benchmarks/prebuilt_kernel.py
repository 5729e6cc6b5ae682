"""What a kernel in C, prebuilt for each platform, would gain: the exported plant against the one that numba compiles.

Run: python benchmarks/prebuilt_kernel.py

Both advance the same plants by the same voltages, 1 and 1024 at a time, in turns. The C code is what `hydro export
plant` writes: one plant after another; numba's kernel advances 16 in turn with vector instructions.
"""

from __future__ import annotations

import ctypes
import tempfile
import time
from pathlib import Path

import numpy as np

from hydro_agents.running.text import markdown
from hydro_env import ServoHydraulicVectorEnv
from hydro_env.plant.kernel import N_PEAKS, Accuracy, Plants, integrate
from hydro_rig.export.c_files import compiled
from hydro_rig.export.plant import plant_code

PERIOD, ROUNDS = 0.005, 9
MANY = """
#include "plant.h"
void advance_all(double *state, const double *coefficients, const double *voltage, int plants, double duration)
{
    for (int n = 0; n < plants; ++n)
        plant_advance((State *)(state + n * PLANT_STATES), coefficients + n * PLANT_COEFFICIENTS, voltage[n], duration,
                      &plant_default_accuracy);
}
"""


def library(processor: str, folder: Path) -> ctypes.CDLL:
    """The plant in C, compiled for a processor."""
    sources = {**plant_code().files, "many.c": MANY}
    compiled(sources, ["-O3", f"-march={processor}", "-ffp-contract=fast", "-shared", "-fPIC"], folder=folder)
    code = ctypes.CDLL(str((folder / "out").rename(folder / f"{processor}.so")))
    array = np.ctypeslib.ndpointer(np.float64, flags="C")
    code.advance_all.argtypes = [array, array, array, ctypes.c_int, ctypes.c_double]
    return code


def compare(count: int, periods: int, codes: dict[str, ctypes.CDLL]) -> list[str]:
    """Nanoseconds of each way per plant and period, the fastest of some rounds, and the largest difference."""
    env = ServoHydraulicVectorEnv(count, info=False)
    env.reset(seed=0)
    start, constants = env.axes.state.copy(), env.axes.coefficient.copy()
    voltages = np.random.default_rng(0).uniform(-3.0, 3.0, (periods, count))
    durations, peaks, accuracy = np.full((count, 1), PERIOD), np.zeros((count, N_PEAKS)), Accuracy()
    took: dict[str, float] = {}
    for _ in range(ROUNDS):
        ours, theirs = start.copy(), {}
        begin = time.perf_counter()
        for voltage in voltages:
            integrate(Plants(ours, constants, voltage[:, None], durations, peaks), accuracy, 0, count)
        took["numba"] = min(took.get("numba", 1e9), time.perf_counter() - begin)
        for name, code in codes.items():
            theirs[name] = start.copy()
            begin = time.perf_counter()
            for voltage in voltages:
                code.advance_all(theirs[name], constants, voltage, count, PERIOD)
            took[name] = min(took.get(name, 1e9), time.perf_counter() - begin)
    spread = np.maximum(np.ptp(ours, axis=0), 1e-12) if count > 1 else np.maximum(np.abs(ours[0]), 1e-12)
    apart = max(float((np.abs(other - ours) / spread).max()) for other in theirs.values())
    return [f"{count}", *(f"{1e9 * took[name] / count / periods:,.0f}" for name in ("numba", *codes)), f"{apart:.1e}"]


def main() -> None:
    """Print the table."""
    with tempfile.TemporaryDirectory() as folder:
        codes = {name: library(name, Path(folder)) for name in ("native", "x86-64-v3", "x86-64-v2")}
        rows = [compare(1, 4000, codes), compare(1024, 20, codes)]
    names = [f"C, {name}" for name in codes]
    print(markdown(("plants", "numba, ns per plant and period", *names, "largest difference, of the spread"), rows))


if __name__ == "__main__":
    main()
