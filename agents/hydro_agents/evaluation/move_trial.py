"""A test move on axes outside the design: the bound for the leak, and the errors of its estimates."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from hydro_agents.controllers.base import Controller
from hydro_agents.estimation.estimate import estimate
from hydro_agents.estimation.information import WORN_VALVE, information, ratios_to_bound, sigma, unknown_sets
from hydro_agents.estimation.known_windows import MOTIONS, KnownWindows, known_windows, leak_cases
from hydro_agents.estimation.move_design import Design, Move, moved
from hydro_agents.estimation.unknowns import LEAKAGE
from hydro_agents.running.seeds import EVALUATION
from hydro_agents.running.text import frame_markdown, number, setting
from hydro_env import TaskConfig

Array = NDArray[np.float64]

TEST_MOVE = "test move"

BEGIN = 1.0
"""s; windows of other motions begin this long after the start of their episode."""


def trial(
    config: TaskConfig,
    controller: Controller,
    move: Move,
    leaks: tuple[float, ...],
    plants: int,
    progress: Callable[[str, int, int], None] | None = None,
) -> tuple[pd.DataFrame, KnownWindows]:
    """Estimate leaks from the move and from other motions of the same duration, on plants of the test seeds.

    The unknowns are plant, start, biases and wear of the valve. Columns: ``motion``, ``leakage_flow_lpm``, ``seed``,
    ``sigma_lpm`` (bound), ``estimate_lpm``, ``deviation_lpm`` (the estimate's own), ``holds`` (whether the model
    explains the readings).

    Args:
        config: the task.
        controller: moves the axes.
        move: the test move.
        leaks: l/min at 100 bar.
        plants: number of plants.
        progress: called with the phase, the number of combinations of motion and leak done, and their total.

    Returns:
        The table, and the windows of the move with the last leak.

    Raises:
        ConfigurationError: no axis can make the move.
    """
    unknowns, seeds = unknown_sets(config), EVALUATION.take(plants)
    worn = unknowns.sets[WORN_VALVE]
    priors = {name: unknowns.priors[name] for name in worn.unknowns}
    jobs = [(motion, leak) for motion in (*MOTIONS, TEST_MOVE) for leak in leaks]
    frames = []
    for done, (motion, leak) in enumerate(jobs):
        if progress is not None:
            progress("trial", done, len(jobs))
        if motion == TEST_MOVE:
            windows = moved(config, controller, move, seeds, plants, leak)
        else:
            cases = leak_cases(seeds, plants, leak)
            windows = known_windows(MOTIONS[motion](config), controller, cases, BEGIN, move.duration)
        found = estimate(windows.signals, config, worn.unknowns, priors=priors)
        frames.append(
            pd.DataFrame(
                {
                    "motion": motion,
                    "leakage_flow_lpm": leak,
                    "seed": windows.case + seeds.start,
                    "sigma_lpm": sigma(information(config, windows, priors))[:, -1],
                    "estimate_lpm": found.value(LEAKAGE),
                    "deviation_lpm": found.deviation(LEAKAGE),
                    "holds": found.holds,
                }
            )
        )
    if progress is not None:
        progress("trial", len(jobs), len(jobs))
    return pd.concat(frames, ignore_index=True), windows


def trial_table(table: pd.DataFrame) -> pd.DataFrame:
    """Bound and errors of the estimate by motion and leak; cells are text, l/min at 100 bar."""
    rows = []
    for (motion, leak), part in table.groupby(["motion", "leakage_flow_lpm"], sort=False):
        kept = part[part["holds"]]
        within = (kept["estimate_lpm"] - leak).abs() <= 1.645 * kept["deviation_lpm"]
        median = float((kept["estimate_lpm"] - leak).abs().median()) if len(kept) else np.nan
        ratio = ratios_to_bound(*(kept[name].to_numpy() for name in ("leakage_flow_lpm", "estimate_lpm", "sigma_lpm")))
        rows.append(
            {
                "motion": motion,
                "leak, l/min": setting(float(leak)),
                "bound, median": number(float(part["sigma_lpm"].median()), digits=2),
                "largest": number(float(part["sigma_lpm"].max()), digits=2),
                "error, median": number(median, digits=2),
                "error over bound": number(ratio[0].ratio if ratio else np.nan, digits=2),
                "within 90 %": f"{within.sum()} of {len(kept)}",
                "model holds": f"{len(kept)} of {len(part)}",
            }
        )
    return pd.DataFrame(rows).set_index("motion")


def move_table(move: Move) -> str:
    """The move as Markdown, one row per stroke."""
    rows = [
        (f"{1e3 * one.start:.1f}", f"{one.hold:.2f}", f"{1e3 * one.end:.1f}", f"{one.duration:.2f}")
        for one in move.strokes
    ]
    last = (f"{1e3 * move.strokes[-1].end:.1f}", f"{move.last_hold:.2f}", "–", "–")
    frame = pd.DataFrame([*rows, last], columns=["hold at, mm", "for, s", "then move to, mm", "in, s"])
    frame.index = pd.Index(range(1, len(frame) + 1), name="")
    return frame_markdown(frame)


def gain(best: Design) -> str:
    """Gain of the search on the plants of the design, as a sentence."""
    first = f"{number(best.first_bound, digits=2)} l/min" if np.isfinite(best.first_bound) else "not possible"
    return (
        f"Bound on the plants of the design: {number(best.bound, digits=2)} l/min; of one stroke there and back at "
        f"mid-range: {first}."
    )


def trial_markdown(table: pd.DataFrame) -> str:
    """The table of :func:`trial_table` as Markdown."""
    return frame_markdown(trial_table(table))
