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
"""

from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from hydro_agents.detection.activity import Activity
from hydro_agents.detection.detector import Reading
from hydro_env.files import Group, read_yaml, validate
from hydro_env.types import Floats, Mask

OUTLIER = 3.0  # standard deviations; a look farther from the mean of those before it counts as this far


class Scale(Group):
    """Scores of healthy axes during one activity, and the rise that the design leak causes; set by calibration."""

    highest_baseline: float = Field(ge=-1e9, le=1e9)  # upper limit of every axis's own baseline
    learning: int = Field(60, ge=0, le=10_000)  # looks until an axis's own baseline is known; 0: none
    spread: float = Field(gt=0.0, le=1e9)  # standard deviation of a look about its axis's baseline
    shift: float = Field(ge=0.0, le=1e9)  # rise of the score by the design leak; 0: no evidence


class Scales(Group):
    """The scale of each activity."""

    standing: Scale
    slow: Scale
    moving: Scale


class AlarmSettings(Group):
    """Settings of an alarm, as in ``configs/agents/alarm.yaml``."""

    interval: float = Field(4.0, gt=0.0, le=3600.0)  # s; between looks
    clip: float = Field(2.0, gt=0.0, le=1e6)  # largest contribution of one look: an outlier raises no alarm
    scales: Scales
    threshold: float = Field(1.0, gt=0.0, le=1e9)  # of the sum

    @classmethod
    def load(cls, path: str | Path) -> "AlarmSettings":
        """Read the settings of a YAML file.

        Raises:
            ConfigurationError: missing or damaged file, unknown key, or an impossible value.
        """
        return validate(cls, read_yaml(path), path)

    def table(self, field: str) -> Floats:
        """One field of the scales, (activities,)."""
        return np.array([getattr(getattr(self.scales, activity.name.lower()), field) for activity in Activity])


class AlarmState(NamedTuple):
    """Memory of N alarms; no call changes its argument."""

    mean: Floats  # (N, activities), of the first scores in each activity
    seen: Floats  # (N, activities), how many of them
    total: Floats  # (N,), S above
    alarm: Mask  # (N,), latched


class LeakAlarm:
    """N alarms with the same settings: ``begin``, then one ``update`` per look.

    Example:
        >>> import numpy as np
        >>> from hydro_agents.detection.alarm import AlarmSettings, LeakAlarm
        >>> from hydro_agents.detection.detector import Reading
        >>> from hydro_agents.detection.activity import Activity
        >>> from hydro_env.folders import config_folder
        >>> alarm = LeakAlarm(AlarmSettings.load(config_folder() / "agents" / "alarm.yaml"))
        >>> state, moving = alarm.begin(count=2), np.full(2, Activity.MOVING)
        >>> for _ in range(20):  # looks at two axes, of which the second one leaks
        ...     state = alarm.update(Reading.of([0.01, 0.1]), moving, state)
        >>> state.alarm
        array([False,  True])
    """

    def __init__(self, settings: AlarmSettings) -> None:
        self.settings = settings
        self._highest, self._spread = settings.table("highest_baseline"), settings.table("spread")
        self._shift = settings.table("shift")
        learning = settings.table("learning")
        self._learning = np.where(learning > 0, learning, np.inf)

    def begin(self, count: int) -> AlarmState:
        """The memory of N axes before their first look."""
        return AlarmState(
            mean=np.zeros((count, len(Activity))),
            seen=np.zeros((count, len(Activity))),
            total=np.zeros(count),
            alarm=np.zeros(count, bool),
        )

    def update(self, look: Reading, activity: NDArray[np.int8], state: AlarmState) -> AlarmState:
        """Add one look at each axis; returns the next memory.

        A look without a score adds nothing, nor does one that the detector cannot explain (no answer). A named
        fault does not clear the seal: an axis may have both.
        """
        axes = np.arange(len(activity))
        counts = look.answers
        score = np.where(counts, look.score, 0.0)
        spread, shift, highest = self._spread[activity], self._shift[activity], self._highest[activity]
        mean, seen = state.mean[axes, activity], state.seen[axes, activity]
        learnt = seen >= self._learning[activity]
        baseline = np.where(learnt, np.minimum(mean, highest), highest)
        sigma = np.fmax(look.sigma, spread)
        design = shift / sigma
        evidence = design * ((score - baseline) / sigma - 0.5 * design)
        evidence = np.clip(evidence, -self.settings.clip, self.settings.clip)
        total = np.where(counts, np.maximum(state.total + evidence, 0.0), state.total)
        alarm = state.alarm | (total > self.settings.threshold)

        reach = np.where(seen > 0.0, OUTLIER * spread, np.inf)  # the first look is the mean
        learns = counts & ~learnt
        after = AlarmState(state.mean.copy(), state.seen.copy(), total, alarm)
        after.mean[axes, activity] += np.where(learns, np.clip(score - mean, -reach, reach) / (seen + 1.0), 0.0)
        after.seen[axes, activity] += learns
        return after
