"""The alarm: it sums up the evidence of a detector over time and reports when an axis leaks.

A look is one reading of the detector, taken at regular times. It adds the log-likelihood ratio of two Gaussian
hypotheses, the axis as it was and the axis with the leak that the alarm is designed for:

    z = δ (x − b − δ/2) / σ²

x is the score of the look. b is the axis's own baseline: the median of its first looks, but never above the baselines
of healthy axes (``highest_baseline``). An axis that leaks from the first look on is therefore compared with healthy
axes, any other with itself. δ is the rise of the score by the design leak, and σ the spread of the score, both for the
axis's activity (standing, slow, moving). If a detector gives a larger standard deviation for a look, it replaces σ.

The evidence is summed up in one or more ways side by side, one quick and one patient (Lucas, *Combined
Shewhart-CUSUM quality control schemes*, J. Quality Technology 14, 1982): ``cusum`` sums S ← max(0, S + z) (Page,
*Continuous inspection schemes*, Biometrika 41, 1954), ``mean`` forgets exponentially, S ← S + λ (z − S) (Roberts,
Technometrics 1, 1959). The alarm latches when one of the sums exceeds its threshold.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from hydro_agents.detection.detector import Cause, Floats, Reading
from hydro_agents.detection.looks import Activity, Looks
from hydro_env import ConfigurationError
from hydro_env.files import Group, read_yaml, validate, write_yaml

Flags = NDArray[np.bool_]
CAUSE_MEMORY = 20.0  # averaging time in s of the causes that the detector names


class Scale(Group):
    """Scores of healthy axes during one activity, and the rise that the design leak causes; set by calibration."""

    highest_baseline: float = Field(ge=-1e9, le=1e9, description="upper limit of every axis's own baseline")
    spread: float = Field(gt=0.0, le=1e9, description="standard deviation of a look about its axis's baseline")
    shift: float = Field(ge=0.0, le=1e9, description="rise of the score by the design leak; 0: no evidence")


class Sum(Group):
    """One way to sum up evidence."""

    method: Literal["mean", "cusum"]
    memory: float = Field(0.0, ge=0.0, le=1e6, description="s; of a mean; 0: each look alone")
    threshold: float = Field(1.0, gt=0.0, le=1e9)


class AlarmSettings(Group):
    """Settings of an alarm; ``hydro alarms`` computes them."""

    detector: str = Field("", description="the detector of the calibration")
    interval: float = Field(0.5, gt=0.0, le=3600.0, description="s; between looks")
    learning: int = Field(60, ge=1, le=10_000, description="looks in each activity until an axis's baseline is known")
    clip: float = Field(5.0, gt=0.0, le=1e6, description="largest contribution of one look: an outlier raises no alarm")
    scales: dict[str, Scale] = Field(description="by activity: standing, slow, moving")
    sums: tuple[Sum, ...] = Field(min_length=1, max_length=8)
    false_alarms_per_100_h: float | None = Field(None, ge=0.0, description="rate that set the thresholds")

    @classmethod
    def load(cls, path: str | Path) -> AlarmSettings:
        """Read what :meth:`save` wrote.

        Raises:
            ConfigurationError: missing or damaged file, unknown key, or an impossible value.
        """
        return validate(cls, read_yaml(path), str(path))

    def save(self, path: str | Path) -> None:
        """Write the settings as YAML."""
        write_yaml(path, self.model_dump(mode="json"))

    def table(self, field: str) -> Floats:
        """One field of the scales, (activities,).

        Raises:
            ConfigurationError: an activity has no scale.
        """
        for activity in Activity:
            if activity.name.lower() not in self.scales:
                raise ConfigurationError(f"alarm: scales: hold no '{activity.name.lower()}'")
        return np.array([getattr(self.scales[activity.name.lower()], field) for activity in Activity])


class AlarmState(NamedTuple):
    """Memory of N alarms; no call changes its argument."""

    first: Floats  # (N, activities, learning), first scores in each activity, NaN where none is yet
    seen: NDArray[np.int64]  # (N, activities), how many of them
    baseline: Floats  # (N, activities), in use now
    sums: Floats  # (N, sums), S above
    alarm: Flags  # (N,), latched
    causes: Floats  # (N, causes), share of the last looks that named each


class Alarm(NamedTuple):
    """State of the alarms after a look, each (N,)."""

    alarm: Flags  # latched until ``reset``
    total: Floats  # largest of the sums, each divided by its threshold; the alarm rises above 1
    cause: NDArray[np.int8]  # :class:`~hydro_agents.detection.detector.Cause` that most of the last looks named
    learnt: Flags  # whether the axis's own baseline is known for its present activity


class LeakAlarm:
    """N alarms with the same settings: ``begin``, then one ``update`` per look; ``follow`` takes all looks at once.

    Example:
        >>> import numpy as np
        >>> from hydro_agents.detection.alarm import AlarmSettings, LeakAlarm
        >>> from hydro_agents.detection.detector import Reading
        >>> from hydro_agents.detection.looks import Activity
        >>> from hydro_env.folders import config_folder
        >>> alarm = LeakAlarm(AlarmSettings.load(config_folder() / "agents" / "alarm.yaml"))
        >>> state, moving = alarm.begin(count=2), np.full(2, Activity.MOVING)
        >>> for _ in range(20):  # looks at two axes, of which the second one leaks
        ...     now, state = alarm.update(Reading.of([-3.0, 8.0]), moving, state)
        >>> now.alarm
        array([False,  True])
    """

    def __init__(self, settings: AlarmSettings) -> None:
        self.settings = settings
        self._highest, self._spread, self._shift = (
            settings.table(field) for field in ("highest_baseline", "spread", "shift")
        )
        self._threshold = np.array([each.threshold for each in settings.sums])
        self._cusum = np.array([each.method == "cusum" for each in settings.sums])
        self._forget = np.array([min(settings.interval / max(each.memory, 1e-9), 1.0) for each in settings.sums])
        self._forget_cause = min(settings.interval / CAUSE_MEMORY, 1.0)

    def begin(self, count: int) -> AlarmState:
        """The memory of N axes before their first look."""
        return AlarmState(
            first=np.full((count, len(Activity), self.settings.learning), np.nan),
            seen=np.zeros((count, len(Activity)), dtype=np.int64),
            baseline=np.tile(self._highest, (count, 1)),
            sums=np.zeros((count, len(self.settings.sums))),
            alarm=np.zeros(count, dtype=np.bool_),
            causes=np.zeros((count, len(Cause))),
        )

    def update(self, look: Reading, activity: NDArray[np.int8], state: AlarmState) -> tuple[Alarm, AlarmState]:
        """Add one look at each axis.

        A look without a score adds nothing, nor does one that the detector cannot explain (cause ``UNKNOWN``). A named
        fault does not clear the seal: an axis may have both.

        Args:
            look: reading of the detector, each array (N,).
            activity: of each axis, (N,).
            state: memory after the previous look.
        """
        everyone = np.arange(len(state.alarm))
        counts = np.isfinite(look.score) & (look.cause != Cause.UNKNOWN)
        score = np.where(counts, look.score, 0.0)
        sigma = np.fmax(look.sigma, self._spread[activity])
        shift = self._shift[activity]
        ratio = shift * (score - state.baseline[everyone, activity] - 0.5 * shift) / (sigma * sigma)
        step = np.clip(ratio, -self.settings.clip, self.settings.clip)
        rise = np.where(self._cusum, step[:, None], self._forget * (step[:, None] - state.sums))
        sums = state.sums + np.where(counts[:, None], rise, 0.0)
        sums = np.where(self._cusum, np.maximum(sums, 0.0), sums)
        total = (sums / self._threshold).max(axis=1)
        named = (look.cause[:, None] == np.arange(len(Cause))).astype(np.float64)
        causes = state.causes + self._forget_cause * (named - state.causes)
        state = self._learn(score, activity, counts, state)
        alarm = state.alarm | (total > 1.0)
        state = state._replace(sums=sums, alarm=alarm, causes=causes)
        learnt = state.seen[everyone, activity] >= self.settings.learning
        return Alarm(alarm, total, causes.argmax(axis=1).astype(np.int8), learnt), state

    def _learn(self, score: Floats, activity: NDArray[np.int8], counts: Flags, state: AlarmState) -> AlarmState:
        """Store the scores of axes that still learn, and compute the baselines that are complete."""
        axes = np.flatnonzero(counts)
        axes = axes[state.seen[axes, activity[axes]] < self.settings.learning]
        if len(axes) == 0:
            return state
        kind = activity[axes]
        first, seen, baseline = state.first.copy(), state.seen.copy(), state.baseline.copy()
        first[axes, kind, seen[axes, kind]] = score[axes]
        seen[axes, kind] += 1
        done = seen[axes, kind] == self.settings.learning
        known, kind = axes[done], kind[done]
        baseline[known, kind] = np.minimum(np.median(first[known, kind], axis=1), self._highest[kind])
        return state._replace(first=first, seen=seen, baseline=baseline)

    def reset(self, state: AlarmState, axes: Flags, relearn: bool = False) -> AlarmState:
        """Acknowledge the alarms of some axes (N,): their evidence starts at zero again.

        ``relearn`` forgets their baselines too, as after a repair.
        """
        fresh = self.begin(len(state.alarm))
        kept = () if relearn else ("first", "seen", "baseline")
        chosen: dict[str, Any] = {
            name: np.where(axes.reshape(-1, *[1] * (old.ndim - 1)), new, old)
            for name, old, new in zip(state._fields, state, fresh, strict=True)
            if name not in kept
        }
        return state._replace(**chosen)

    def follow(self, looks: Looks, state: AlarmState | None = None) -> tuple[Alarm, AlarmState]:
        """Process all looks of a recording or of simulated axes in order; returns arrays (N, L) and the memory."""
        state = state if state is not None else self.begin(len(looks.score))
        results: list[Any] = []
        for number in range(len(looks.time)):
            result, state = self.update(looks.reading(number), looks.activity[:, number], state)
            results.append(result)
        return Alarm(*(np.stack(values, axis=1) for values in zip(*results, strict=True))), state
