"""Rows of the bare integrator: plants × control periods per second, and its share of what the machine can do."""

from __future__ import annotations

import os
from collections.abc import Sequence

from agents.benchmark.kernel_access import HALF_WAVE, BareKernel, counted_work, total
from agents.benchmark.table import Case, Row
from agents.benchmark.timing import Extent, fresh_process, rate

PEAK_SIZE = 1024
SHARE_SIZE = 4096  # plants for which the share of the peak is told
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


def peak(threads: int) -> float:
    """Floating-point rate in GFLOP/s of a matrix product (DGEMM) in a fresh process, the best of ten."""
    variables = ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS")
    _, text = fresh_process(_PEAK_CODE, {name: str(threads) for name in variables})
    return float(text)


def kernel_cases(extent: Extent) -> list[Case]:
    """The integrator alone."""
    work = counted_work()
    operations = total(work.kinds)
    peaks: dict[int, float] = {}
    cases = []
    thread_counts = [1, 2] if (os.cpu_count() or 1) > 1 else [1]
    for threads in thread_counts:
        cases.append(_peak_case(threads, peaks, extent))
    for threads in thread_counts:
        for count in extent.kernel_sizes:
            if count >= 16 * threads or threads == 1:
                cases.append(_kernel_case(count, threads, operations * work.evaluations, peaks, extent))
    remark = "mean of 32 drawn plants in the first 25 ms under 1 V, counted"
    rows = (
        Row("operations of a right-hand side", "1", note=_spelled(work.kinds)),
        Row("right-hand sides of a control period", "1", note=remark),
    )
    cases.append(Case(rows, lambda run: (operations, work.evaluations), 1))
    return cases


def _spelled(counts: dict[str, int]) -> str:
    return ", ".join(f"{number} {kind}" for kind, number in sorted(counts.items(), key=lambda item: -item[1]))


def _peak_case(threads: int, peaks: dict[int, float], extent: Extent) -> Case:
    def measure(run: int) -> Sequence[float]:
        peaks[threads] = peak(threads)
        return (peaks[threads],)

    name = f"DGEMM, {threads} thread{'s' if threads > 1 else ''}"
    note = f"NumPy's BLAS, {PEAK_SIZE} × {PEAK_SIZE}, best of 10: what counts as the machine's peak"
    return Case((Row(name, "GFLOP/s", note=note),), measure, extent.runs)


def _kernel_case(count: int, threads: int, per_period: float, peaks: dict[int, float], extent: Extent) -> Case:
    name = f"{count:,} plant{'s' if count > 1 else ''}, {threads} thread{'s' if threads > 1 else ''}"
    against = f"{count:,} plants, 1 thread" if threads > 1 else ""
    rows = [Row(name, "plant periods/s", against)]
    if count == SHARE_SIZE:
        rows.append(Row(f"{name}: share of the peak", "%", note="right-hand sides alone; a DGEMM has no division"))
        if threads == 1:
            rows.append(Row(f"{name}: inner steps of a period", "1", note="mean of all plants and 40 periods, counted"))

    def measure(run: int) -> Sequence[float]:
        kernel = BareKernel(count, threads)
        periods = rate(kernel.advance, extent.seconds)
        values = [periods]
        if len(rows) > 1:
            values.append(100.0 * periods * per_period / (1e9 * peaks[threads]))
        if len(rows) > 2:
            values.append(kernel.mean_steps(2 * HALF_WAVE))
        kernel.close()
        return values

    return Case(tuple(rows), measure, extent.runs)
