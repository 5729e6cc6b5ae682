"""The alarm: it sums up the evidence of a detector over time and reports when an axis leaks.

A look is one reading of the detector, taken at regular times. Its z-score is the distance of its score x from the
axis's own baseline b in standard deviations σ, z = (x − b) / σ. The look adds the log-likelihood ratio of two Gaussian
hypotheses, the axis as it was (z = 0) and the axis with the leak that the alarm is designed for (z = d):

    S ← max(0, S + d (z − d/2))

This sum is a CUSUM (Page, *Continuous inspection schemes*, Biometrika 41, 1954); the alarm rises when it exceeds a
threshold, and latches. d and σ belong to the axis's activity (standing, slow, moving). If the detector gives a larger
standard deviation for a look, it replaces σ.

The baseline is the mean of the axis's first looks, without outliers, but never above the baselines of healthy axes
(``highest_baseline``). An axis that leaks from the first look on is therefore compared with healthy axes, any other
with itself. In an activity without ``learning`` every axis is compared with healthy axes.

The C code of ``hydro export alarm`` is traced from :meth:`LeakAlarm.update`: both give the same numbers.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from hydro_agents.detection.detector import Cause, Reading
from hydro_agents.detection.looks import Activity, Looks
from hydro_env.files import Group, read_yaml, validate, write_yaml
from hydro_env.types import Floats

Flags = NDArray[np.bool_]

OUTLIER = 3.0  # standard deviations; a look farther from the mean of those before it counts as this far

CAUSE_LOOKS = 30.0  # looks that count for the cause: their weights fall exponentially
LEAST_SHARE = 0.15
"""Share of them by which a cause is named, if none has a larger share. Detectors name a fault that is not there in
about one look of a hundred, and miss one that is there far more often."""

LEAST_WEIGHT = 0.25  # of the last looks, at which a share counts: of few looks, two must agree

VOTED = tuple(cause for cause in Cause if cause != Cause.UNDETERMINED)
NAMED = tuple(cause for cause in VOTED if cause > Cause.INTERNAL_LEAK)


class Scale(Group):
    """Scores of healthy axes during one activity, and the rise that the design leak causes; set by calibration."""

    highest_baseline: float = Field(ge=-1e9, le=1e9, description="upper limit of every axis's own baseline")
    learning: int = Field(60, ge=0, le=10_000, description="looks until an axis's own baseline is known; 0: none")
    spread: float = Field(gt=0.0, le=1e9, description="standard deviation of a look about its axis's baseline")
    shift: float = Field(ge=0.0, le=1e9, description="rise of the score by the design leak; 0: no evidence")


class Scales(Group):
    """The scale of each activity."""

    standing: Scale
    slow: Scale
    moving: Scale


class AlarmSettings(Group):
    """Settings of an alarm; ``hydro alarms`` computes them."""

    detector: str = Field("", description="the detector of the calibration")
    interval: float = Field(4.0, gt=0.0, le=3600.0, description="s; between looks")
    clip: float = Field(2.0, gt=0.0, le=1e6, description="largest contribution of one look: an outlier raises no alarm")
    scales: Scales
    threshold: float = Field(1.0, gt=0.0, le=1e9, description="of the sum")
    false_alarms_per_100_h: float | None = Field(None, ge=0.0, le=1e9, description="rate that set the threshold")

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
        """One field of the scales, (activities,)."""
        return np.array([getattr(getattr(self.scales, activity.name.lower()), field) for activity in Activity])


class AlarmState(NamedTuple):
    """Memory of N alarms; no call changes its argument."""

    mean: Floats  # (N, activities), of the first scores in each activity
    seen: Floats  # (N, activities), how many of them
    total: Floats  # (N,), S above
    alarm: Flags  # (N,), latched
    causes: Floats  # (N, VOTED), weight of the last looks that named each


class Alarm(NamedTuple):
    """State of the alarms after a look, each (N,)."""

    alarm: Flags  # latched until ``reset``
    total: Floats  # the sum divided by its threshold; the alarm rises above 1
    cause: NDArray[np.int64]  # the :class:`~hydro_agents.detection.detector.Cause` that the last looks name; else NONE
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
        ...     now, state = alarm.update(Reading.of([0.01, 0.1]), moving, state)
        >>> now.alarm
        array([False,  True])
    """

    def __init__(self, settings: AlarmSettings) -> None:
        self.settings = settings
        self._highest, self._spread, self._shift = (
            settings.table(field) for field in ("highest_baseline", "spread", "shift")
        )
        learning = settings.table("learning")
        self._learning = np.where(learning > 0, learning, np.inf)

    def begin(self, count: int) -> AlarmState:
        """The memory of N axes before their first look."""
        return AlarmState(
            mean=np.zeros((count, len(Activity))),
            seen=np.zeros((count, len(Activity))),
            total=np.zeros(count),
            alarm=np.zeros(count, dtype=np.bool_),
            causes=np.zeros((count, len(VOTED))),
        )

    def update(self, look: Reading, activity: NDArray[np.int8], state: AlarmState) -> tuple[Alarm, AlarmState]:
        """Add one look at each axis.

        A look without a score adds nothing, nor does one that the detector cannot explain (no answer). A named
        fault does not clear the seal: an axis may have both.

        Args:
            look: reading of the detector, each array (N,).
            activity: of each axis, (N,).
            state: memory after the previous look.
        """
        return self.step(look.score, look.sigma, look.cause, activity, state)

    def step(self, score: Any, sigma: Any, cause: Any, activity: Any, state: AlarmState) -> tuple[Alarm, AlarmState]:
        """The same from the fields of a reading; only with operations that :mod:`hydro_rig.export.tracing` knows."""
        counts = (np.absolute(score) < np.inf) & (cause < int(Cause.UNKNOWN))
        here = activity.reshape(-1, 1) == np.arange(len(Activity))
        score = np.where(counts, score, 0.0)
        spread = (here * self._spread).sum(axis=1)
        shift = (here * self._shift).sum(axis=1)
        highest = (here * self._highest).sum(axis=1)
        mean = (here * state.mean).sum(axis=1)
        seen = (here * state.seen).sum(axis=1)
        learning = np.where(here, self._learning, 0.0).sum(axis=1)
        learnt = seen >= learning
        baseline = np.where(learnt, np.minimum(mean, highest), highest)
        sigma = np.where(sigma > spread, sigma, spread)
        design = shift / sigma
        evidence = design * ((score - baseline) / sigma - 0.5 * design)
        evidence = np.minimum(np.maximum(evidence, -self.settings.clip), self.settings.clip)
        total = np.where(counts, np.maximum(state.total + evidence, 0.0), state.total)
        alarm = state.alarm | (total > self.settings.threshold)

        reach = np.where(seen > 0.0, OUTLIER * spread, np.inf)  # the first look is the mean
        change = np.minimum(np.maximum(score - mean, -reach), reach) / (seen + 1.0)
        learns = here & (counts & np.logical_not(learnt)).reshape(-1, 1)
        votes = (cause != int(Cause.UNDETERMINED)).reshape(-1, 1)
        named = cause.reshape(-1, 1) == np.array(VOTED, dtype=np.int64)
        causes = np.where(votes, state.causes + (named - state.causes) / CAUSE_LOOKS, state.causes)
        largest, which = np.full(alarm.shape, LEAST_SHARE), np.zeros(alarm.shape, dtype=np.int64)
        share = causes / np.maximum(causes.sum(axis=1), LEAST_WEIGHT).reshape(-1, 1)
        for each in NAMED:
            more = share[:, VOTED.index(each)] > largest
            which = np.where(more, int(each), which)
            largest = np.where(more, share[:, VOTED.index(each)], largest)
        memory = AlarmState(
            mean=np.where(learns, state.mean + change.reshape(-1, 1), state.mean),
            seen=state.seen + learns,
            total=total,
            alarm=alarm,
            causes=causes,
        )
        known = (here * memory.seen).sum(axis=1) >= learning
        return Alarm(alarm, total / self.settings.threshold, which, known), memory

    def reset(self, state: AlarmState, axes: Flags, relearn: bool = False) -> AlarmState:
        """Acknowledge the alarms of some axes (N,): their evidence starts at zero again.

        ``relearn`` forgets their baselines too, as after a repair.
        """
        fresh = self.begin(len(state.alarm))
        kept = () if relearn else ("mean", "seen")
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
