"""The reference ahead, sample by sample, rebuilt from the present and the earlier observations.

An observation shows a few samples of the future reference. In each period they come nearer by one sample. A controller
that remembers them soon knows every sample up to the farthest; until then it interpolates. No axis can follow a jump of
the reference: it sets off before the jump, and brakes towards its end.
"""

import numpy as np

from hydro_agents.controllers.base import Observation, ObservationLayout, surely_zero
from hydro_agents.controllers.flow_model import FlowModel
from hydro_env import TaskConfig
from hydro_env.types import Floats


class Preview:
    """Rebuilds the reference from one period ago to the farthest preview, for N axes.

    Its memory is one array (N, horizon + 2): the reference one period ago, now, and 1 to ``horizon`` periods ahead.
    Any control period and any preview times work, including none. An observation names the nominal times; its samples
    lie at whole numbers of periods (``TaskConfig.preview_samples``).
    """

    def __init__(self, config: TaskConfig) -> None:
        counts, self._columns = np.unique(np.array(config.preview_samples, np.int64), return_index=True)
        self._layout = ObservationLayout.of(config)
        self.horizon = int(counts[-1]) if len(counts) else 0
        self.counts = tuple(counts.tolist())
        """Periods ahead of the samples that an observation shows, rising."""
        self.times = config.control_period * np.arange(1.0, self.horizon + 1)
        """s from now to each future sample of the memory, (horizon,)."""
        known = np.array([0, *self.counts])
        ahead = np.arange(1, self.horizon + 1)
        self._right = np.searchsorted(known, ahead)
        before = known[self._right - 1]
        self._share = (ahead - before) / (known[self._right] - before)

    def start(self, batch: Observation) -> Floats:
        """The memory at the start of an episode, (N, horizon + 2).

        The axis has been at rest; samples between those of the observation are interpolated.
        """
        now, ahead = self._shown(batch)
        known = np.concatenate([now[:, None], ahead], axis=1)
        between = known[:, self._right - 1] * (1.0 - self._share) + known[:, self._right] * self._share
        return np.concatenate([now[:, None], now[:, None], between], axis=1)

    def advanced(self, samples: Floats, batch: Observation) -> Floats:
        """The memory one period later, (N, horizon + 2), from the memory and the observations (N, n)."""
        now, ahead = self._shown(batch)
        later = np.empty_like(samples)
        later[:, 0] = samples[:, 1]
        later[:, 1] = now
        later[:, 2:-1] = samples[:, 3:]
        for column, count in enumerate(self.counts):
            later[:, 1 + count] = ahead[:, column]
        return later

    def _shown(self, batch: Observation) -> tuple[Floats, Floats]:
        """The reference now, (N,), and the future samples shown, (N, counts), m."""
        now = self._layout.si(batch, "reference")
        return now, now[:, None] + self._layout.previews(batch)[:, self._columns]


def path_weights(time: float, horizon: int, period: float) -> Floats:
    """Weights (horizon + 1,) of the reference's steps that give its travel from now to ``time`` (s) ahead.

    ``steps = np.diff(samples, axis=1)``: the step before now comes first. Outside the samples the reference is
    extrapolated at the speed of its last or first step.
    """
    weights = np.clip(time / period - np.arange(-1.0, horizon), 0.0, 1.0)
    weights[0] = min(time / period, 0.0)
    weights[-1] += max(time / period - horizon, 0.0)
    return weights


class Jumps:
    """Removes jumps from the reference, and decides for which of them the axis must already move; for N axes.

    An axis sets off ``delay`` before a jump, and earlier by ``share`` of half the time that the jump takes at full
    speed: with ``share = 1`` it is half-way when the reference jumps. A change of the reference by more than
    ``largest`` (m) in a period is a jump; ``times`` are those of :class:`Preview`.
    """

    def __init__(self, model: FlowModel, largest: float, delay: float, share: float, times: Floats) -> None:
        self._model, self._largest = model, largest
        self._delay, self._half_share, self._times = delay, 0.5 * share, times

    def split(self, reference: Floats) -> tuple[Floats, Floats]:
        """Steps without jumps, and the jumps alone, of a reference (N, horizon + 2) in m, each (N, horizon + 1)."""
        steps = np.diff(reference, axis=1)
        jumps = np.where(np.abs(steps) > self._largest, steps, 0.0)
        return steps - jumps, jumps

    def begun(self, jumps: Floats, force: Floats, supply: Floats) -> Floats:
        """Sum of the jumps of :meth:`split` for which the axis moves already, m, (N,), at a force of the oil (N)."""
        if surely_zero(jumps):
            return np.zeros(len(jumps))
        ahead = jumps[:, 1:]
        out, back = self._model.full_speeds(force, supply)
        full = np.where(ahead > 0.0, out[:, None], back[:, None])
        early = self._half_share * np.abs(ahead) / full + self._delay
        return np.where(early >= self._times, ahead, 0.0).sum(axis=1)


def braked(error: Floats, near: float) -> Floats:
    """The error if it is small; beyond ``near`` its square root, because an axis brakes at constant deceleration.

    The reduced error and its slope are continuous at ``near`` (m).
    """
    size = np.abs(error)
    root = np.sqrt(near * np.maximum(2.0 * size - near, near))
    return np.where(size > near, np.copysign(root, error), error)
