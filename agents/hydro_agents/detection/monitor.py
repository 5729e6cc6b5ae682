"""A controller with the leakage head attached."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hydro_agents.controllers.base import Controller, Floats, as_batch
from hydro_agents.detection.head import HeadState, LeakageEstimate, LeakageHead


@dataclass
class MonitorState:
    """Memory of a monitored controller: the controller's own, and the head's."""

    controller: Any
    head: HeadState


class MonitoredController:
    """Any controller with the leakage head attached; its commands are those of the controller.

    ``estimate(state)`` reads the last window of observations of each axis.
    """

    def __init__(self, controller: Controller, head: LeakageHead) -> None:
        self.controller = controller
        self.head = head

    def predict(
        self,
        observation: Floats,
        state: MonitorState | None = None,
        episode_start: NDArray[np.bool_] | None = None,
        deterministic: bool = True,
    ) -> tuple[NDArray[np.float32], MonitorState]:
        """The controller's commands; the state also stores the observations for the head."""
        batch, single = as_batch(observation)
        inner, watching = (state.controller, state.head) if state is not None else (None, None)
        action, inner = self.controller.predict(batch, inner, episode_start, deterministic)
        watching = self.head.remember(batch, watching, episode_start)
        return (action[0] if single else action), MonitorState(inner, watching)

    def estimate(self, state: MonitorState) -> LeakageEstimate:
        """Estimate on each axis (N,); NaN until a whole window is known."""
        return self.head.estimate_remembered(state.head)
