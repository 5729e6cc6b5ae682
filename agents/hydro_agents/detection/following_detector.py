"""The estimator as a detector for successive windows of the same axes, such as those of an alarm."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hydro_agents.detection.detector import Floats, Windows
from hydro_agents.detection.estimator import EstimatorDetector, Progress, wear_priors
from hydro_agents.estimation.following import Follower
from hydro_agents.estimation.result import Estimate
from hydro_env import TaskConfig


class FollowingDetector(EstimatorDetector):
    """The estimator for successive windows of the same axes: its score is the leak itself, in l/min at 100 bar.

    If a window begins with the last sample of the previous one, the search starts from the previous estimate, which is
    faster; otherwise it starts afresh. The detector remembers the windows: use a ``deepcopy`` for another run.
    """

    window = 401
    """Control periods; the windows of an alarm touch."""

    def __init__(
        self, changes: Mapping[str, Any] | None = None, unknowns: tuple[str, ...] = (), threads: int | None = None
    ) -> None:
        super().__init__(changes, unknowns, threads)
        self._followers: dict[tuple[bool, str, int], Follower] = {}

    def _fit(self, windows: Windows, task: TaskConfig, worn: bool, progress: Progress | None = None) -> Estimate:
        del progress
        key = worn, task.model_dump_json(), windows.samples
        if key not in self._followers:
            self._followers[key] = Follower(
                task,
                self.names(task, worn),
                window=windows.samples,
                priors=wear_priors(task) if worn else None,
                threads=self.threads,
            )
        return self._followers[key].window_of(windows.signals)

    def _with_moving_supply(self, windows: Windows, task: TaskConfig, worn: Estimate) -> NDArray[np.bool_]:
        del task, worn  # a follower hands on one state of the supply
        return np.zeros(len(windows), dtype=np.bool_)

    def _fit_again(
        self,
        windows: Windows,
        simple: NDArray[np.int64],
        task: TaskConfig,
        worn: Estimate,
        progress: Progress | None,
    ) -> tuple[Estimate, NDArray[np.int64]]:
        return self._fit(windows, task, False), simple  # a follower needs all axes

    def _at_rest(self, windows: Windows, task: TaskConfig) -> NDArray[np.bool_]:
        del task  # the alarm compares the readings of an axis at rest with one another
        return np.zeros(len(windows), dtype=np.bool_)

    def _score(self, value: Floats, deviation: Floats, task: TaskConfig) -> tuple[Floats, Floats]:
        return value, deviation
