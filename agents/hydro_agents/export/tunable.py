"""Controllers whose gains can be changed while they run: the gains are part of the memory."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from hydro_agents.controllers.base import ClassicalController, Floats


class TunableMemory(NamedTuple):
    """Memory of a :class:`Tunable`."""

    own: Any  # of the controller
    gains: dict[str, NDArray[np.float64]]  # each ()


class Tunable:
    """A classical controller that takes some of its gains from its memory; it starts with its own gains.

    Args:
        controller: any controller whose class makes it from gains and task by plain arithmetic.
        names: the gains that can be changed.
    """

    def __init__(self, controller: ClassicalController, names: tuple[str, ...]) -> None:
        self.controller = controller
        self.names = names

    def predict(
        self,
        observation: Floats,
        state: TunableMemory | None = None,
        episode_start: NDArray[np.bool_] | None = None,
        deterministic: bool = True,
    ) -> tuple[NDArray[np.float32], TunableMemory]:
        """Commands for the observations; see :class:`~hydro_agents.controllers.base.Controller`."""
        original = self.controller.gains
        values = dict(original)
        gains = state.gains if state is not None else {name: np.array(values[name]) for name in self.names}
        turned = type(original).model_construct(**{**values, **gains})
        controller = type(self.controller)(turned, self.controller.config)
        own = state.own if state is not None else None
        action, own = controller.predict(observation, own, episode_start, deterministic)
        return action, TunableMemory(own, gains)
