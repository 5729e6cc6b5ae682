"""Rows of the bare integrator: plants × control periods per second, and its share of the machine's peak."""

from __future__ import annotations

import os
import statistics
from collections.abc import Sequence

from hydro_agents.benchmark.kernel_access import HALF_WAVE, BareKernel, counted_work
from hydro_agents.benchmark.table import Case, Row, one_row
from hydro_agents.benchmark.timing import Extent, fresh_process, rate

PEAK_SIZE = 1024  # rows and columns of the matrices
SHARE_SIZE = 4096  # plants for which the share of the peak is reported
_PEAK_CODE = f"""
import time, numpy as np
n = {PEAK_SIZE}
a, b = np.random.default_rng(0).random((2, n, n))
out, best = a @ b, 1e9
for _ in range(10):
    began = time.perf_counter()
    np.matmul(a, b, out=out)
    best = min(best, time.perf_counter() - began)
print(2e-9 * n**3 / best)
"""


def kernel_cases(extent: Extent) -> list[Case]:
    """The integrator alone."""
    kinds, evaluations = counted_work()
    operations = sum(count for kind, count in kinds.items() if kind != "comparisons")
    peaks: dict[int, float] = {}

    def peak(threads: int) -> float:
        """Rate of a matrix product (GFLOP/s), the best of ten in a fresh process."""
        variables = ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS")
        peaks[threads] = float(fresh_process(_PEAK_CODE, dict.fromkeys(variables, str(threads)))[1])
        return peaks[threads]

    def speed(count: int, threads: int) -> Case:
        name = f"{_counted(count, 'plant')}, {_counted(threads, 'thread')}"
        rows = [Row(name, "plant periods/s", f"{_counted(count, 'plant')}, 1 thread" if threads > 1 else "")]
        if count == SHARE_SIZE:
            rows.append(Row(f"{name}: share of the peak", "%", note="right-hand sides alone; a DGEMM has no division"))
        if count == SHARE_SIZE and threads == 1:
            rows.append(Row(f"{name}: inner steps of a period", "1", note="mean of all plants and 40 periods, counted"))

        def measure(run: int) -> Sequence[float]:
            bare = BareKernel(count, threads)
            periods = rate(bare.advance, extent.seconds)
            values = [periods]
            if len(rows) > 1:
                values.append(100.0 * periods * operations * evaluations / (1e9 * peaks[threads]))
            if len(rows) > 2:
                values.append(statistics.fmean(bare.steps() for _ in range(2 * HALF_WAVE) if bare.advance()))
            bare.close()
            return values

        return Case(tuple(rows), measure, extent.runs)

    thread_counts = [1, 2] if (os.cpu_count() or 1) > 1 else [1]
    note = f"NumPy's BLAS, {PEAK_SIZE} × {PEAK_SIZE}, best of 10: counts as the machine's peak"
    cases = [
        one_row(f"DGEMM, {_counted(n, 'thread')}", "GFLOP/s", lambda n=n: peak(n), extent.runs, note=note)  # type: ignore[misc]
        for n in thread_counts
    ]
    for threads in thread_counts:
        cases += [speed(count, threads) for count in extent.kernel_sizes if threads == 1 or count >= 16 * threads]
    spelled = ", ".join(f"{number} {kind}" for kind, number in sorted(kinds.items(), key=lambda item: -item[1]))
    remark = "mean of 32 drawn plants in the first 25 ms under 1 V, counted"
    rows = (
        Row("operations of a right-hand side", "1", note=spelled),
        Row("right-hand sides of a control period", "1", note=remark),
    )
    return [*cases, Case(rows, lambda run: (operations, evaluations), 1)]


def _counted(count: int, noun: str) -> str:
    return f"{count:,} {noun}{'s' if count > 1 else ''}"
