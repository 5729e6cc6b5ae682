"""The leakage head in motion, the estimator at rest or in doubt: one detector for an alarm that watches for weeks.

The head reads a window within a millisecond, but not at rest, where a shifted valve looks like a leak. The estimator
tells them apart and names faults surely, but one window takes half a second: it is asked at most once a minute per
axis, which takes about one percent of a core.
"""

import numpy as np

from hydro_agents.detection.activity import Activity, activity_of
from hydro_agents.detection.detector import HALF_WIDTH, Cause, Reading, Why, Windows
from hydro_agents.detection.monitor import HeadDetector
from hydro_env import TaskConfig
from hydro_rig.estimation.estimator import EstimatorDetector

RATION = 60.0  # s; the estimator reads no window of an axis before this time has passed since the last one


class TwoStageDetector:
    """Its score is the size of the leak, l/min at 100 bar.

    The head answers while the axis moves. The estimator is asked if the axis creeps or stands, and if the head gives no
    answer, names a cause, or sees a leak. A cause that it names is that of the axis until it may be asked again; where
    it names none, the head's counts: some faults only the head knows.

    The rows of successive windows are the same axes; windows without times are all read. The detector remembers when
    each axis was asked: use a ``deepcopy`` for another run.
    """

    threshold: float | None = None

    def __init__(self, head: HeadDetector, estimator: EstimatorDetector | None = None) -> None:
        self.head, self.estimator = head, estimator or EstimatorDetector()
        self._asked = np.empty(0)  # s, end of the last window of each axis that the estimator read
        self._named = np.empty(0, np.int8)  # the cause that it then named

    def refuses(self, task: TaskConfig, samples: int) -> str:
        """The reason if the head cannot read such windows."""
        return self.head.refuses(task, samples)

    def read(self, windows: Windows, task: TaskConfig) -> Reading:
        """Read windows; one that only the estimator could answer has no answer while it may not be asked."""
        count = len(windows)
        if len(self._asked) != count or (windows.end < self._asked).any():  # other axes
            self._asked, self._named = np.full(count, -np.inf), np.zeros(count, np.int8)
        free = ~(windows.end - self._asked < RATION)  # NaN: unknown times
        self._named[free] = Cause.NONE
        first = self.head.read(windows, task)
        moving = activity_of(windows.signals, task.control_period) == Activity.MOVING
        seen = first.probability >= self.head.on(task).settings.threshold
        doubtful = ~(moving & first.answers) | (first.cause != Cause.NONE) | seen
        first = first._replace(score=np.where(first.answers, first.flow_lpm, np.nan))
        rows, still = np.flatnonzero(free & doubtful), np.flatnonzero(~moving)
        result = first.replaced(still, Reading.of(np.full(len(still), np.nan), why=Why.NOT_ASKED))
        if len(rows):
            second = self.estimator.read(windows.part(rows), task)
            self._asked[rows] = windows.end[rows]
            self._named[rows] = np.where(second.answers, second.cause, Cause.NONE)
            # A wide answer says little, but says it: its standard deviation weighs it.
            cause = np.where(second.cause == Cause.UNDETERMINED, Cause.NONE, second.cause).astype(np.int8)
            deviation = 0.5 * (second.high_lpm - second.low_lpm) / HALF_WIDTH
            second = second._replace(score=second.flow_lpm, sigma=deviation, cause=cause)
            better = np.flatnonzero(second.answers | ~moving[rows])
            result = result.replaced(rows[better], second.part(better))
        known = (self._named != Cause.NONE) & result.answers
        return result._replace(cause=np.where(known, self._named, result.cause).astype(np.int8))
