"""Controllers: PID and others, through one interface."""

from hydro_agents.controllers.base import Controller, ObservationLayout
from hydro_agents.controllers.pid import PID, PIDGains

__all__ = ["PID", "Controller", "ObservationLayout", "PIDGains"]
