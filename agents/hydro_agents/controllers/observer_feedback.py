"""State feedback on a speed command: the common base of controllers with an observer.

The flow law of the valve turns openings into speeds; observer and feedback work on these speeds, which makes the axis
nearly linear. The observer reads the command that the axis received (a part of the observation), limited to full
opening. Saturation therefore causes no wind-up, and the correction of a policy is no disturbance.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from hydro_agents.controllers.base import ClassicalController, Observation, gain, restarted
from hydro_agents.controllers.flow_model import Flow, FlowModel
from hydro_agents.controllers.preview import Jumps, Preview, braked
from hydro_agents.controllers.sampled_loop import held_inputs
from hydro_env import TaskConfig, linearise
from hydro_env.files import Group
from hydro_env.plant.analysis import reachable_range, speed_limits
from hydro_env.plant.arrays import plant_coefficients
from hydro_env.plant.states import STATE_NAMES
from hydro_env.task.paces import within_a_period
from hydro_env.types import Floats
from hydro_env.units import FULL_VOLTAGE

JUMP = 1.2
"""Reference speed, as a fraction of full speed, above which a change counts as a jump: no axis can follow."""

LEAST_ADAPTED, MOST_ADAPTED = (0.6, 0.6, 0.0), (1.6, 1.6, 0.5)
"""Range of the adapted parameters, as in :class:`ObserverState`."""

_LINEARISED = ("velocity", "pressure_a", "pressure_b", "spool_position", "spool_velocity", "coil_current")


class ObserverFeedbackGains(Group):
    """Gains of every controller with an observer, relative to the rig.

    The lag of the rig is the lag of its valve plus the inverse of its hydraulic frequency. The delay is the time from a
    sample to the effect of its command: latency, half a period, lag of the valve.
    """

    flow_gain_extending: float = gain(1.0, (0.5, 2.0), "1", "of the nominal flow gain", low=0.01, logarithmic=True)
    flow_gain_retracting: float = gain(1.0, (0.5, 2.0), "1", "of the nominal flow gain", low=0.01, logarithmic=True)
    gain_adaptation: float = gain(60.0, (0.0, 150.0), "1/s", "rate at which a flow gain adapts at full speed", high=1e3)
    leak_adaptation: float = gain(60.0, (0.0, 150.0), "1/s", "rate at which the leak adapts at full pressure", high=1e3)
    set_off_delay: float = gain(1.4, (0.0, 4.0), "1", "set-off before a jump of the reference, in delays", high=100.0)
    set_off_share: float = gain(
        0.9, (0.0, 2.0), "1", "earlier set-off, in halves of its time at full speed", high=100.0
    )
    braking: float = gain(
        1.4, (0.1, 10.0), "1", "error, per travel at full speed in a delay, beyond which the feedback grows as a root",
        low=1e-3, logarithmic=True,
    )  # fmt: skip


class ObserverState(NamedTuple):
    """Memory of the controller."""

    estimate: Floats  # (N, states), of the observer
    command_before: Floats  # (N,), m/s, speed command before the last one
    supply: Floats  # (N,), Pa, at the start or the take-over
    adapted: Floats  # (N, 3), relative flow gains extending and retracting; leak at full pressure over full speed
    reference: Floats  # (N, horizon + 2), m; see Preview


class SampledModel(NamedTuple):
    """x[n+1] = transition x[n] + input_old u[n−1] + input_new u[n], measured signals: outputs x[n]."""

    transition: Floats  # (n, n)
    input_old: Floats  # (n,)
    input_new: Floats  # (n,)
    outputs: Floats  # (m, n)


def sampled(a: Floats, b: Floats, outputs: Floats, config: TaskConfig) -> SampledModel:
    """Sample dx/dt = a x + b u exactly; the command changes one latency after the sample, within a control period.

    Åström & Wittenmark, *Computer-Controlled Systems* (1997), section 2.3.

    Args:
        a: (n, n), 1/s.
        b: (n,).
        outputs: (m, n).
        config: gives control period and latency.
    """
    return SampledModel(*held_inputs(a, b, config.control_period, config.command_latency), outputs)


class ObserverFeedback(ClassicalController):
    """Base of the controllers with an observer.

    A subclass sets ``model`` and ``correction`` (n, m), the gain of its observer on the innovations of the measured
    signals: position (m), force of the oil (N), speed at the measured opening (m/s), or the first m of them. The state
    ``disturbance`` of the model is the part of the speed (m/s) that the command does not explain. The subclass defines
    :meth:`following` and :meth:`speed`.

    The flow gain of each direction and the leak adapt along their gradients (Åström & Wittenmark, *Adaptive Control*
    (1995), chapter 5): a disturbance that grows with the speed is an error of the flow gain, one that grows with the
    pressure across the piston is a leak. The explained part is removed from the disturbance.

    Args:
        gains: the gains.
        config: the task; its plant is the nominal rig.
    """

    model: SampledModel
    correction: Floats
    disturbance: int

    memory = ObserverState

    def __init__(self, gains: Any, config: TaskConfig) -> None:
        super().__init__(gains, config)
        within_a_period(config.command_latency, config, type(self).__name__)
        self.layout.needs(("pressure_a", "pressure_b", "spool_position"), type(self).__name__)
        plant, period, c = config.plant, config.control_period, plant_coefficients(config.plant)
        self.flow = FlowModel(plant)
        # Dry friction blocks a resting axis and hardly damps a moving one.
        rig = linearise(plant.rigid.replace(friction={"model": "none"}), position=0.5 * sum(reachable_range(plant)))
        velocity, pressure_a, pressure_b, *valve = (STATE_NAMES.index(name) for name in _LINEARISED)
        stiffness = c.area_b * rig.a[pressure_b, velocity] - c.area_a * rig.a[pressure_a, velocity]
        self.frequency = float(np.sqrt(stiffness * c.inverse_mass))  # of mass and oil, rad/s
        self.valve, self.drive = rig.a[np.ix_(valve, valve)], FULL_VOLTAGE * rig.b[valve]
        self.valve_lag = float(np.linalg.solve(self.valve, np.linalg.solve(self.valve, self.drive))[0])
        self.lag = self.valve_lag + 1.0 / self.frequency
        self.delay = config.command_latency + 0.5 * period + self.valve_lag
        self.full_speed = max(speed_limits(plant))
        self._supply = plant.supply.pressure
        self._rest = np.array([gains.flow_gain_extending, gains.flow_gain_retracting, 0.0])
        rates = np.array([gains.gain_adaptation, gains.gain_adaptation, gains.leak_adaptation])
        self._rates = rates * period / self.full_speed**2
        self.preview = Preview(config)
        self._near = gains.braking * self.full_speed * self.delay
        jump, early = JUMP * self.full_speed * period, gains.set_off_delay * self.delay
        self._jumps = Jumps(self.flow, jump, early, gains.set_off_share, self.preview.times)

    def following(self, measured: Floats, command: Floats, speed: Floats) -> Floats:
        """Estimate (N, n) of an axis at a known speed from its measured signals and its speed command.

        Args:
            measured: position (m), force of the oil (N), speed at the measured opening (m/s), (N, 3).
            command: m/s, (N,).
            speed: of the axis, m/s, (N,).
        """
        raise NotImplementedError

    def speed(self, estimate: Floats, error: Floats, command: Floats, steps: Floats) -> Floats:
        """The next speed command, m/s, (N,).

        Args:
            estimate: (N, n).
            error: position minus reference, m, (N,), reduced by the braking law
                (:func:`~hydro_agents.controllers.preview.braked`).
            command: speed command of the last period, m/s, (N,).
            steps: changes of the reference from one period to the next, m, (N, horizon + 1), without jumps; the first
                one ends now.
        """
        raise NotImplementedError

    def act(
        self, batch: Observation, state: ObserverState | None, episode_start: NDArray[np.bool_] | None
    ) -> tuple[Floats, ObserverState]:
        """See :meth:`~hydro_agents.controllers.base.ClassicalController.act`."""
        si = self.layout.si
        position, pressures = si(batch, "position"), np.stack([si(batch, "pressure_a"), si(batch, "pressure_b")])
        openings = np.stack([si(batch, "spool_position"), si(batch, "previous_command")])
        difference = (pressures[1] - pressures[0]) / self._supply

        now = None if state is None else state._replace(reference=self.preview.advanced(state.reference, batch))
        if now is None or (episode_start is not None and np.any(episode_start)):
            reference, adapted = self.preview.start(batch), np.tile(self._rest, (len(batch), 1))
            speed = self.layout.speed_at_start(batch, self.full_speed)
            supply = self.flow.supply(pressures, speed)
            flow = self.flow.at(position, pressures, supply)
            spool, command = self._speeds(openings, flow, adapted, difference)
            start = self.following(np.stack([position, flow.force, spool], axis=1), command, speed)
            now = restarted(now, ObserverState(start, command, supply, adapted, reference), episode_start)

        flow = self.flow.at(position, pressures, now.supply)
        spool, command = self._speeds(openings, flow, now.adapted, difference)
        measured, m = np.stack([position, flow.force, spool], axis=1)[:, : len(self.model.outputs)], self.model
        estimate = (
            now.estimate @ m.transition.T + np.outer(now.command_before, m.input_old) + np.outer(command, m.input_new)
        )
        estimate += (measured - estimate @ m.outputs.T) @ self.correction.T

        growth = np.stack([np.maximum(command, 0.0), np.minimum(command, 0.0), self.full_speed * difference], axis=1)
        change = self._rates * estimate[:, [self.disturbance]] * growth
        adapted = np.clip(now.adapted + change, LEAST_ADAPTED, MOST_ADAPTED)
        unadapted, command = command, self._speeds(openings, flow, adapted, difference)[1]
        estimate[:, self.disturbance] -= command - unadapted

        new = ObserverState(estimate, command, now.supply, adapted, now.reference)
        scaled, leak = _scaled(flow, adapted), self._leak(adapted, difference)
        steps, jumps = self._jumps.split(now.reference)
        begun = self._jumps.begun(jumps, flow.force, now.supply)
        error = braked(estimate[:, 0] - now.reference[:, 1] - begun, self._near)
        wanted = self.speed(estimate, error, command, steps)
        return self.flow.opening(wanted - leak, scaled), new

    def _speeds(self, openings: Floats, flow: Flow, adapted: Floats, difference: Floats) -> Floats:
        """Speeds in m/s, (M, N), of openings (M, N) with the adapted flow gains and leak."""
        return self.flow.speed(openings, _scaled(flow, adapted)) + self._leak(adapted, difference)

    def _leak(self, adapted: Floats, difference: Floats) -> Floats:
        leak: Floats = self.full_speed * adapted[:, 2] * difference
        return leak


def _scaled(flow: Flow, adapted: Floats) -> Flow:
    """The flow model with the adapted flow gains."""
    return flow._replace(extending=adapted[:, 0] * flow.extending, retracting=adapted[:, 1] * flow.retracting)
