"""Rows of accuracy: error of the integrator against the reference solver, batch of drawn rigs by batch; its order."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Sequence
from itertools import pairwise

from agents.benchmark.accuracy import (
    BATCH,
    LIMIT,
    ORDER_STEPS,
    SAMPLE_TIME,
    SAMPLES,
    SETTINGS,
    convergence_order,
    errors,
    random_cases,
    references,
)
from agents.benchmark.accuracy import (
    Case as Run,
)
from agents.benchmark.table import Case, Row
from agents.benchmark.timing import Extent

REFERENCE_ROW = "Radau, relative tolerance 1e-10"


def accuracy_cases(extent: Extent) -> list[Case]:
    """A batch of rigs per run: the reference first, then every setting of the integrator on the same rigs."""
    runs = random_cases(extent.accuracy_rigs)
    batches = [runs[first : first + BATCH] for first in range(0, len(runs), BATCH)]
    exact: dict[int, list[object]] = {}
    simulated = BATCH * SAMPLES * SAMPLE_TIME

    def reference(batch: int) -> Sequence[float]:
        workers = os.cpu_count() or 1
        began = time.perf_counter()
        exact[batch] = list(references(batches[batch], workers))
        return (1e3 * (time.perf_counter() - began) * workers / simulated,)

    note = f"{BATCH} drawn rigs per run, {SAMPLES * SAMPLE_TIME:g} s each; all processes together"
    cases = [Case((Row(REFERENCE_ROW, "ms per simulated s", note=note),), reference, len(batches))]
    for name, options in SETTINGS.items():
        rows = (
            Row(f"{name}: worst error", "of a state's range", note="largest of any state of the rigs of a run"),
            Row(f"{name}: rigs within {LIMIT:g}", "%", note="every state, along the whole run"),
            Row(f"{name}: time", "ms per simulated s", REFERENCE_ROW),
        )
        cases.append(Case(rows, _setting(batches, exact, options, simulated), len(batches)))
    orders = tuple(
        Row(f"order, steps of {1e3 * coarse:g} to {1e3 * fine:g} ms", "1", note="fixed steps on a smooth run")
        for coarse, fine in pairwise(ORDER_STEPS)
    )
    cases.append(Case(orders, lambda run: list(convergence_order()["order"][1:]), 1))
    return cases


def _setting(
    batches: list[list[Run]], exact: dict[int, list[object]], options: dict[str, float], simulated: float
) -> Callable[[int], Sequence[float]]:
    def measure(batch: int) -> Sequence[float]:
        worst = errors(batches[batch], exact[batch], **options).max(axis=1)
        began = time.perf_counter()
        for case in batches[batch]:
            case.run(**options)
        seconds = time.perf_counter() - began
        return worst.max(), 100.0 * (worst <= LIMIT).mean(), 1e3 * seconds / simulated

    return measure
