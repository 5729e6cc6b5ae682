"""PID with anti-windup, derivative filter and velocity feed-forward; works on one axis or on many at once."""

from copy import copy
from typing import Any, NamedTuple

import numpy as np
from pydantic import Field

from hydro_agents.controllers.base import ClassicalController, Observation, gain, log_gain, restarted
from hydro_env import TaskConfig
from hydro_env.files import Group
from hydro_env.plant.analysis import speed_limits
from hydro_env.types import Floats, Mask

NOISES = 2.0  # half width of the ramp across the dead band of a valve, in standard deviations of the command's noise


class PIDGains(Group):
    """Gains of :class:`PID`; the command is a fraction of 10 V, lengths are in m, times in s.

    Example:
        >>> from hydro_agents.controllers import PIDGains
        >>> PIDGains(proportional=25.0).integral
        40.0
        >>> PIDGains(proportional=-1.0)
        Traceback (most recent call last):
            ...
        hydro_env.errors.ConfigurationError: PIDGains: proportional = -1.0: must be a number within 0 to 10000 ...
    """

    proportional: float = log_gain(20.0, (2.0, 2000.0), "1/m", "on the error", high=1e4)
    integral: float = log_gain(40.0, (1.0, 1e5), "1/(m s)", "on the integral of the error", high=1e5)
    derivative: float = gain(0.0, (0.0, 3.0), "s/m", "on the error of the speed", high=1e3)
    derivative_filter_time: float = log_gain(0.005, (1e-3, 0.05), "s", "first-order", high=1.0)
    feedforward_extending: float = gain(6.0, (0.0, 20.0), "s/m", "command per reference speed", high=1e3)
    feedforward_retracting: float = gain(8.0, (0.0, 20.0), "s/m", "command per reference speed", high=1e3)
    feedforward_lead: float = gain(0.008, (0.0, 0.03), "s", "lead of the reference speed", high=0.1)
    reference_lead: float = gain(0.0, (0.0, 0.03), "s", "lead of the reference position", high=0.1)
    anti_windup_time: float = log_gain(0.05, (0.005, 1.0), "s", "back-calculation while saturated", 1e-6, 10.0)
    overlap_compensation: float = gain(
        0.0, (0.0, 1.2), "1", "of the valve's overlap, added to the command", high=1.5, needs="valve.overlap"
    )
    lead_in_integral: bool = Field(
        True, description="whether the integral uses the error with the lead, as in 0.1; without it, no bias"
    )


class PIDState(NamedTuple):
    """Memory of the controller, each (N,)."""

    integral: Floats
    velocity: Floats
    position: Floats
    reference: Floats


class PID(ClassicalController):
    """u = K_p e + K_i ∫e dt + K_d (ẋ_ref − ẋ) + K_ff ẋ_ref, limited to ±1.

    The preview gives e and ẋ_ref with a lead that compensates latency and valve. Without a preview there is no lead,
    and ẋ_ref is the backward difference of the reference. The derivative acts on the filtered difference of the
    measured position. While the command saturates, back-calculation unwinds the integral. The start is bumpless, at
    rest and in motion: the axis is taken to follow its reference, and the integral takes over the rest of the last
    command.

    Example:
        >>> from hydro_agents.controllers import PID, PIDGains
        >>> from hydro_env import ServoHydraulicVectorEnv, TaskConfig
        >>> task = TaskConfig()
        >>> pid, env = PID(PIDGains(proportional=25.0), task), ServoHydraulicVectorEnv(2, task)
        >>> observation, _ = env.reset(seed=0)
        >>> command, memory = pid.predict(observation)  # memory: for the next call
        >>> command.shape
        (2, 1)
    """

    def __init__(self, gains: PIDGains, config: TaskConfig) -> None:
        super().__init__(gains, config)
        counts, self._shown = np.unique(np.array(config.preview_samples, np.int64), return_index=True)
        self._times = config.control_period * np.array([0, *counts])
        self._jump = max(speed_limits(config.plant))
        self._middles = 0.5 * (self._times[1:] + self._times[:-1])
        valve, sensor = config.plant.valve, config.sensors.position
        self._null, self._added = valve.null_shift, gains.overlap_compensation * valve.overlap
        self._limit = 1.0 - self._added
        if self._added:
            noise = gains.proportional * max(sensor.noise, sensor.resolution)
            self._ramp = max(NOISES * noise, valve.underlap, 1e-6)

    def act(self, batch: Observation, state: PIDState | None, episode_start: Mask | None) -> tuple[Floats, PIDState]:
        """See :meth:`~hydro_agents.controllers.base.ClassicalController.act`."""
        g, period = self.gains, self.layout.control_period
        names = ("tracking_error", "position", "previous_command", "reference")
        error, position, command_before, reference = (self.layout.si(batch, name) for name in names)
        if len(self._shown):
            ahead = np.concatenate([np.zeros((len(batch), 1)), self.layout.previews(batch)[:, self._shown]], axis=1)
            speeds = np.diff(ahead, axis=1) / np.diff(self._times)
            reference_speed = _interpolate(g.feedforward_lead, self._middles, speeds)
            leading = error + _interpolate(g.reference_lead, self._times, ahead)
        if state is None or (episode_start is not None and np.any(episode_start)):
            following = speeds[:, 0] if len(self._shown) else np.zeros(len(batch))
            following = np.where(np.abs(following) > self._jump, 0.0, following)
            integral = self._before_compensation(command_before) - self._feedforward(following)
            state = restarted(state, PIDState(integral, following, position, reference), episode_start)
        if not len(self._shown):
            reference_speed, leading = (reference - state.reference) / period, error
        blend = period / (period + g.derivative_filter_time)
        velocity = state.velocity + blend * ((position - state.position) / period - state.velocity)
        integral = state.integral + g.integral * period * (leading if g.lead_in_integral else error)
        feedback = g.proportional * leading + integral - g.derivative * velocity
        wanted = feedback + g.derivative * reference_speed + self._feedforward(reference_speed)
        # A jump of the reference saturates the command for a period, but is no wind-up.
        smooth = np.clip(reference_speed, -self._jump, self._jump)
        lasting = feedback + g.derivative * smooth + self._feedforward(smooth)
        bounded = np.clip(lasting, -self._limit, self._limit)
        integral = integral + (bounded - lasting) * np.minimum(period / g.anti_windup_time, 1.0)
        return self._compensated(wanted), PIDState(integral, velocity, position, reference)

    def limited(self, largest: Any) -> "PID":
        """The same controller where the valve receives no command beyond ``largest``, (): no integral winds up."""
        changed = copy(self)
        changed._limit = np.minimum(self._limit, largest)
        return changed

    def _compensated(self, command: Floats) -> Floats:
        """The command with the part of the overlap that the valve needs before it opens, (N,)."""
        if not self._added:
            return command
        added = self._added * np.clip((command - self._null) / self._ramp, -1.0, 1.0)
        return command + added

    def _before_compensation(self, command: Floats) -> Floats:
        if not self._added:
            return command
        opening = command - self._null
        on_ramp = opening * (self._ramp / (self._ramp + self._added))
        beyond = opening - np.copysign(self._added, opening)
        return self._null + np.where(np.abs(on_ramp) < self._ramp, on_ramp, beyond)

    def _feedforward(self, speed: Floats) -> Floats:
        """Command for a speed of the reference in m/s, (N,)."""
        per_speed = np.where(speed > 0.0, self.gains.feedforward_extending, self.gains.feedforward_retracting)
        return per_speed * speed


def _interpolate(time: float, times: Floats, values: Floats) -> Floats:
    """Each row of ``values`` (N, times) at ``time``, interpolated; constant beyond the ends."""
    if len(times) == 1:
        return values[:, 0]
    at = min(max(time, times[0]), times[-1])
    column = min(max(np.searchsorted(times, at), 1), len(times) - 1)
    weight = (at - times[column - 1]) / (times[column] - times[column - 1])
    return values[:, column - 1] * (1.0 - weight) + values[:, column] * weight
