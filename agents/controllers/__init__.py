"""Controllers: PID and others, through one interface."""

from agents.controllers.base import Controller, ObservationLayout
from agents.controllers.pid import PID, PIDGains

__all__ = ["PID", "Controller", "ObservationLayout", "PIDGains"]
