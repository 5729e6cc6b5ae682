"""The leakage head in use: as a detector of windows, and loaded for a task."""

from itertools import compress
from pathlib import Path

import numpy as np

from hydro_agents.detection.detector import Cause, Reading, Why, Windows, logit
from hydro_agents.detection.features import LABELS
from hydro_agents.detection.head import AT_REST, BESIDE_STUCK_SENSOR, LeakageHead
from hydro_agents.running.folders import pretrained_folder
from hydro_env import ConfigurationError, TaskConfig

HEAD_FILE = "leakage_head"

OTHER_CAUSES = tuple(cause for cause in Cause if Cause.INTERNAL_LEAK < cause < Cause.UNKNOWN)  # that the head names too

_OTHER_LABELS = [cause.word.replace(" ", "_") for cause in OTHER_CAUSES]


class HeadDetector:
    """The leakage head: its score is the logit of the probability of a leak.

    A head for any axis moves to the rig of each task. A head for one rig leaves the others to one for any axis, whose
    weights are ``elsewhere``.
    """

    def __init__(self, head: LeakageHead, elsewhere: Path | None = None) -> None:
        self.head, self._elsewhere = head, elsewhere
        self._moved: tuple[TaskConfig, LeakageHead] | None = None
        self.threshold: float | None = float(logit(head.settings.threshold))

    @classmethod
    def load(cls, path: str | Path | None = None) -> "HeadDetector":
        """A head from its weights; default: the shipped one, and the shipped one for any axis on other rigs.

        Raises:
            ConfigurationError: as :meth:`LeakageHead.load`.
        """
        if path is not None:
            return cls(LeakageHead.load(path))
        usual = pretrained_folder() / HEAD_FILE
        return cls(LeakageHead.load(usual), usual.with_name(f"{HEAD_FILE}_any_axis"))

    def on(self, task: TaskConfig) -> LeakageHead:
        """The head on the rig of a task.

        Raises:
            ConfigurationError: rig or control period differ from those of its training, or the rig lacks a sensor.
        """
        own = self.head.settings.task
        at_home = (own.plant, own.control_period) == (task.plant, task.control_period)
        if at_home and not self.head.for_any_axis:
            return self.head
        if not self._moved or self._moved[0] != task:
            general = LeakageHead.load(self._elsewhere) if self._elsewhere else self.head
            if not general.for_any_axis:
                period = f"a control period of {1e3 * own.control_period:g} ms"
                other = "another rig" if own.plant != task.plant else period
                raise ConfigurationError(f"the leakage head was trained for {other}")
            self._moved = task, general.moved_to(task)
        return self._moved[1]

    def refuses(self, task: TaskConfig, samples: int) -> str:
        """The reason if no head serves the rig, or the windows are too short."""
        try:
            window = self.on(task).settings.window
        except ConfigurationError as error:
            return str(error)
        if samples < window:
            return f"the leakage head reads windows of at least {window * task.control_period:g} s"
        return ""

    def read(self, windows: Windows, task: TaskConfig) -> Reading:
        """Read windows; one unlike the training has no answer, one at rest or with a stuck sensor no score either."""
        head = self.on(task)
        found = head.estimate_windows(windows.signals)
        outside, still = found.outside > 0.0, found.outside == AT_REST
        stuck = outside & (found.sensor_fault == BESIDE_STUCK_SENSOR["sensor_fault"])
        thresholds = logit(head.tensors["thresholds"])[[LABELS.index(name) for name in _OTHER_LABELS]]
        excess = logit(np.column_stack([getattr(found, name) for name in _OTHER_LABELS])) - thresholds
        named = np.where(excess.max(axis=1) > 0.0, np.array(OTHER_CAUSES)[excess.argmax(axis=1)], Cause.NONE)
        evidence = logit(found.probability) + logit(self.head.settings.threshold) - logit(head.settings.threshold)
        words = [cause.in_full for cause in OTHER_CAUSES]
        unknown = np.where(still, Cause.UNDETERMINED, Cause.UNKNOWN)
        return Reading.of(
            np.where(stuck | still, np.nan, evidence),
            np.where(stuck, Cause.SENSOR, np.where(outside, unknown, named)),
            probability=found.probability,
            flow_lpm=found.flow_lpm,
            low_lpm=found.low_lpm,
            high_lpm=found.high_lpm,
            fault=[" and ".join(compress(words, row)) for row in excess > 0.0],
            why=np.where(still, Why.AT_REST, np.where(outside, Why.OUTSIDE, Why.ANSWERED)),
        )
