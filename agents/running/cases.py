"""Runs controllers on many axes for one episode and hands back what happened, for training and evaluation."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from agents.controllers.base import Controller
from hydro_env import ServoHydraulicVectorEnv, TaskConfig


@dataclass(frozen=True)
class Cases:
    """A list of independent episodes: what is fixed in each. All arrays (N,)."""

    seeds: NDArray[np.int64]
    leakage_flow_lpm: NDArray[np.float64] | None = None  # None: drawn
    families: NDArray[np.str_] | None = None  # None: drawn

    def __len__(self) -> int:
        return len(self.seeds)

    def part(self, first: int, last: int) -> Cases:
        """Some of the cases."""
        leak = self.leakage_flow_lpm[first:last] if self.leakage_flow_lpm is not None else None
        families = self.families[first:last] if self.families is not None else None
        return Cases(self.seeds[first:last], leak, families)


@dataclass(frozen=True)
class Rollout:
    """One episode of each case; N cases, T control periods; values at the T samples after the first.

    A case that fails (``terminated``) keeps the values of its last sample, at no further reward.
    """

    time: NDArray[np.float64]  # (T,), s
    position: NDArray[np.float32]  # (N, T), m, true
    reference: NDArray[np.float32]  # (N, T), m
    command: NDArray[np.float32]  # (N, T), −1…1
    spool: NDArray[np.float32]  # (N, T), true
    reward: NDArray[np.float32]  # (N, T)
    failed_at: NDArray[np.int64]  # (N,), step of the failure, −1 for none
    signals: NDArray[np.float16 | np.float32] | None  # (N, S, T), chosen columns of the observation
    leakage_flow_lpm: NDArray[np.float64]  # (N,), at the end
    leakage_class: NDArray[np.int64]  # (N,)


def run_cases(
    config: TaskConfig,
    controller: Controller,
    cases: Cases,
    signal_columns: Sequence[int] | NDArray[np.int64] | None = None,
    states: bool = True,
    chunk: int = 2048,
    progress: Any = None,
) -> Rollout:
    """Run one episode of every case under a controller.

    Args:
        config: the task.
        controller: what acts.
        cases: what is fixed; the rest is drawn from each case's seed.
        signal_columns: columns of the observation to keep.
        states: keep positions, commands and so on as well.
        chunk: cases that run together; does not change results.
        progress: called with the number of finished cases.
    """
    parts = []
    for first in range(0, len(cases), chunk):
        parts.append(_run_chunk(config, controller, cases.part(first, first + chunk), signal_columns, states))
        if progress is not None:
            progress(min(first + chunk, len(cases)))
    if len(parts) == 1:
        return parts[0]
    joined: dict[str, Any] = {"time": parts[0].time}
    for name in Rollout.__dataclass_fields__:
        if name != "time":
            values = [getattr(part, name) for part in parts]
            joined[name] = None if values[0] is None else np.concatenate(values)
    return Rollout(**joined)


def _run_chunk(config: TaskConfig, controller: Controller, cases: Cases, columns: Any, keep_states: bool) -> Rollout:
    count, steps = len(cases), config.steps
    # NEXT_STEP: the last sample of an episode is seen before its axis restarts.
    env = ServoHydraulicVectorEnv(count, config, autoreset_mode="NextStep", info=False)
    options: dict[str, Any] = {}
    if cases.leakage_flow_lpm is not None:
        options["leakage_flow_lpm"] = cases.leakage_flow_lpm
    if cases.families is not None:
        options["reference"] = [str(name) for name in cases.families]
    observation, _ = env.reset(seed=[int(seed) for seed in cases.seeds], options=options)
    axes, memory = env.axes, None
    kept = steps if keep_states else 0
    position, command, spool, reward = (np.zeros((count, kept), dtype=np.float32) for _ in range(4))
    reference = axes.reference[:, 1 : kept + 1].astype(np.float32)
    signals = np.zeros((steps, count, len(columns)), dtype=np.float32) if columns is not None else None
    failed_at = np.full(count, -1, dtype=np.int64)
    flow = axes.column("leak_flow").copy()
    for step in range(steps):
        alive = failed_at < 0
        if signals is not None:
            signals[step] = observation[:, columns]
            signals[step, ~alive] = signals[step - 1, ~alive]
        action, memory = controller.predict(observation, memory)
        observation, rewards, terminated, _, _ = env.step(action)
        if keep_states:
            position[:, step] = axes.column("position")
            command[:, step] = action[:, 0]
            spool[:, step] = axes.state[:, 4]
            reward[:, step] = rewards
            if not alive.all():  # a failed axis stands where it failed while its reference goes on
                for array in (position, command, spool):
                    array[~alive, step] = array[~alive, step - 1]
                reward[~alive, step] = 0.0
        flow = np.where(alive, axes.column("leak_flow"), flow)
        failed_at[alive & terminated] = step
    env.close()
    return Rollout(
        time=config.control_period * np.arange(1, steps + 1, dtype=np.float64),
        position=position,
        reference=reference,
        command=command,
        spool=spool,
        reward=reward,
        failed_at=failed_at,
        signals=None if signals is None else signals.transpose(1, 2, 0),
        leakage_flow_lpm=flow,
        leakage_class=axes.leakage_class(flow),
    )
