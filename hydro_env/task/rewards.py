"""The terms of the reward: each is a non-negative cost, and the reward is minus their sum.

To add a term, add a field to :class:`Costs`, its expression to :func:`costs`, and a weight to
:class:`~hydro_env.task.configuration.Reward`.
"""

from typing import NamedTuple

import numpy as np

from hydro_env.compiling import inline
from hydro_env.task.sensors import CHANNELS

_POSITION = CHANNELS.index("position")


class Costs(NamedTuple):
    """Costs of a control period, term by term."""

    tracking: float
    effort: float
    failure: float


REWARD_TERMS = Costs._fields  # names of the reward terms, as info["reward_terms"] lists them


@inline
def costs(row, change, failed, settings):
    """:class:`Costs` of the control period that has just ended, with a ``change`` of the command since the last one."""
    weights = settings.reward
    error = row.reference - row.position - settings.reward_bias_share * row.bias[_POSITION]
    scale = settings.error_scales[np.int64(row.reference_family)]
    return Costs(
        tracking=weights.tracking * min(abs(error) / scale, weights.error_limit),
        effort=weights.effort * change * change,
        failure=weights.failure if failed else 0.0,
    )
