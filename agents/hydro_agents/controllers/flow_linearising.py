"""Flow linearisation: the command is the valve opening that gives the desired speed at the measured pressures.

Sources: Jelali & Kroll, *Hydraulic Servo-systems* (2003), chapters 5 and 6: inverse valve characteristic, exact
linearisation, dynamic pressure feedback. Merritt, *Hydraulic Control Systems* (1967), chapters 5 and 6.
"""

from typing import NamedTuple

import numpy as np

from hydro_agents.controllers.base import ClassicalController, Observation, gain, log_gain, restarted
from hydro_agents.controllers.flow_model import Flow, FlowModel
from hydro_agents.controllers.motion_filter import FLOW_GAIN, LEAK, OFFSET, POSITION, MotionFilter
from hydro_agents.controllers.preview import Jumps, Preview, braked, path_weights
from hydro_env import TaskConfig
from hydro_env.files import Group
from hydro_env.plant.analysis import closed_port_natural_frequency, speed_limits
from hydro_env.task.paces import delay, full_speed, pace
from hydro_env.types import Floats, Mask, Singles
from hydro_env.units import LEAKAGE_TEST_PRESSURE, LITRE_PER_MINUTE

_REVERSAL = 0.3  # reference speed, as a fraction of the Stribeck speed, around which the friction changes its sign
_LEAST_GAIN = 0.3  # lower limit of the estimated flow gain, as a fraction of the data sheet's


class FlowLinearisingGains(Group):
    """Gains of :class:`FlowLinearising`: factors on values from the data sheet of the rig, and uncertainties.

    A *delay* is the time from a sample to the resulting motion: latency, half a control period, and valve. A *pace* is
    the delay or half a period of the hydraulic oscillation, whichever is longer. The damped oscillation delays a motion
    by 2ζ/ω more; its damping 2ζ is that of the gain ``damping`` and of the load's viscous friction.

    The defaults are for any rig: ``benchmarks/no_tuning.py`` tuned them over drawn rigs.
    """

    position_gain: float = log_gain(0.758, (0.1, 1.5), "1", "speed per error, times a pace", high=100.0)
    braking: float = log_gain(
        1.14,
        (0.3, 20.0),
        "1",
        "error beyond which the speed grows with its root, per travel at full speed in a pace",
        1e-3,
        1e4,
    )
    lead: float = gain(0.925, (0.5, 2.0), "1", "of the reference speed, in delays of the damped axis", high=10.0)
    smoothing: float = gain(0.737, (0.1, 2.0), "1", "half width of its mean, in delays", 0.01, 10.0)
    prediction: float = gain(0.188, (0.0, 1.5), "1", "of the position, in delays", high=10.0)
    force_rate: float = gain(0.529, (0.0, 2.0), "1", "of the rate of the accelerating force, fed forward", high=10.0)
    set_off_share: float = gain(
        1.47, (0.5, 2.0), "1", "set-off before a jump, per half its time at full speed", 0.0, 10.0
    )
    set_off_delay: float = gain(1.11, (0.0, 3.0), "1", "earlier set-off before a jump, in delays", high=10.0)
    damping: float = gain(0.422, (-0.5, 1.0), "1", "dynamic pressure feedback; adds half of it", -10.0, 10.0)
    damping_filter: float = log_gain(1.56, (0.1, 4.0), "1", "time of its high-pass, in paces", 1e-3, 1e3)
    friction: float = gain(1.1, (0.0, 2.0), "1", "of the data sheet's friction, fed forward at reversals", high=10.0)
    flow_gain_spread: float = log_gain(
        0.0306, (0.01, 0.5), "1", "uncertainty of the flow gain at the start", 1e-6, 10.0
    )
    flow_gain_memory: float = log_gain(
        5.13, (0.3, 10.0), "s", "time in which the flow gain returns to the data sheet's", 1e-3, 1e6
    )
    leak_spread: float = log_gain(0.952, (0.1, 20.0), "l/min at 100 bar", "uncertainty of the leak", 1e-6, 1e3)
    leak_memory: float = log_gain(13.1, (1.0, 60.0), "s", "time in which the leak returns to 0", 1e-3, 1e6)
    offset_spread: float = log_gain(0.00216, (1e-3, 0.5), "1", "uncertainty of the offset, per full speed", 1e-9, 10.0)
    offset_memory: float = log_gain(3.27, (0.1, 5.0), "s", "time in which the offset returns to 0", 1e-3, 1e6)
    motion_spread: float = log_gain(
        0.000494, (1e-5, 0.03), "√s", "uncertainty of the motion, per full speed", 1e-9, 10.0
    )


class FlowLinearisingState(NamedTuple):
    """Memory of the controller; the first dimension of each array is that of the N axes."""

    reference: Floats  # (N, samples), m, as Preview keeps it
    supply: Floats  # (N,), Pa
    force: Floats  # (N,), N, of the oil on the piston
    slow_force: Floats  # (N,), N, low-passed
    speed: Floats  # (N,), m/s, from the flow of the data sheet
    leak: Floats  # (N,), m/s per leak conductance
    estimate: Floats  # (N, 4), as MotionFilter keeps it
    covariance: Floats  # (N, 4, 4)


class FlowLinearising(ClassicalController):
    """command = opening(desired speed), desired speed = reference speed + φ(error) + friction − damping.

    * The opening inverts the flow of the valve at the measured pressures (:class:`FlowModel`), with corrections from
      :class:`MotionFilter`: flow gain, leak, and an offset, which replaces an integral. The filter reads the measured
      spool; a saturated valve therefore causes no wind-up.
    * Reference speed and error look ahead by the delay of the loop. Jumps are removed from the reference, because they
      are no speed; the axis sets off before a jump by about half the time of the move.
    * φ is linear near zero and a square root beyond: the speed from which the axis can still brake within the error.
    * At a reversal friction changes its sign. The flow that compresses the oil accordingly is fed forward.
    * The force that accelerates the load changes with the jerk of the reference; its flow is fed forward as well.
    * Damping subtracts the high-passed force of the oil (dynamic pressure feedback).

    The start is bumpless, at rest and in motion: what the flow of the valve does not explain of the speed is shared
    between flow gain, leak and offset according to their uncertainty. The supply pressure follows from the pressures.
    """

    estimate_names = ("position_error", "flow_gain", "leak", "offset", "speed")

    def __init__(self, gains: FlowLinearisingGains, config: TaskConfig) -> None:
        super().__init__(gains, config)
        self.layout.needs(("pressure_a", "pressure_b"), "flow linearisation")
        # Without a spool sensor, the last command replaces the spool position.
        self._spool = "spool_position" if "spool_position" in self.layout.names else "previous_command"
        self.delay = delay(config)
        self.pace = pace(config)
        g, plant, period = gains, config.plant, config.control_period
        oscillation, mass = closed_port_natural_frequency(plant), plant.load.mass + plant.cylinder.piston_mass
        damping = g.damping + plant.load.viscous_damping / (mass * oscillation)
        self._lead = g.lead * (self.delay + max(damping, 0.0) / oscillation)
        self._model = FlowModel(plant)
        jump = max(speed_limits(plant)) * period
        self._preview = Preview(config)
        self._full_speed = full_speed(plant)
        self._ahead = g.prediction * self.delay
        self._weights = self._reference_weights()
        self._jumps = Jumps(self._model, jump, g.set_off_delay * self.delay, g.set_off_share, self._preview.times)
        self._oscillation, self._mass = oscillation, mass
        self._turned = _REVERSAL * plant.friction.stribeck_velocity
        noise = max(config.sensors.position.noise, config.sensors.position.resolution, 1e-9)
        leak = LITRE_PER_MINUTE / LEAKAGE_TEST_PRESSURE
        self._filter = MotionFilter(
            noise,
            np.array([noise, g.flow_gain_spread, g.leak_spread * leak, g.offset_spread * self._full_speed]),
            g.motion_spread * self._full_speed,
            np.array([g.flow_gain_memory, g.leak_memory, g.offset_memory]),
            period,
        )

    def _reference_weights(self) -> Floats:
        """Weights (horizon + 1, 4) of the reference's steps: travel to the predicted position; speed, before, after."""
        period, horizon, lead = self.config.control_period, self._preview.horizon, self._lead
        width = self.gains.smoothing * self.delay

        def speed(time: float) -> Floats:
            ends = [path_weights(time + side * width, horizon, period) for side in (-1.0, 1.0)]
            return (ends[1] - ends[0]) / (2.0 * width)

        speeds = [speed(lead), speed(lead - period), speed(lead + period)]
        return np.stack([path_weights(self._ahead, horizon, period), *speeds], axis=1)

    def act(
        self, batch: Observation, state: FlowLinearisingState | None, episode_start: Mask | None
    ) -> tuple[Floats, FlowLinearisingState]:
        """See :meth:`~hydro_agents.controllers.base.ClassicalController.act`."""
        si = self.layout.si
        position, spool, command_before = (si(batch, name) for name in ("position", self._spool, "previous_command"))
        pressures = np.stack([si(batch, "pressure_a"), si(batch, "pressure_b")])

        begins = state is None or (episode_start is not None and np.any(episode_start))
        started = np.ones(len(batch), np.bool_) if state is None else episode_start
        if begins:
            state = restarted(state, self._fresh(batch, position, pressures, spool), started)
        assert state is not None
        flow = self._model.at(position, pressures, state.supply)
        now = self._observed(state, batch, flow, position, spool)
        if begins:
            now = restarted(now, state, started)

        estimate = now.estimate
        flow_gain = np.maximum(1.0 + estimate[:, FLOW_GAIN], _LEAST_GAIN)
        other_speed = estimate[:, LEAK] * flow.leak + estimate[:, OFFSET]
        speed_ahead = flow_gain * self._model.speed(0.5 * (spool + command_before), flow) + other_speed
        position_ahead = estimate[:, POSITION] + self._ahead * speed_ahead
        wanted_speed, error = self._wanted(now, position_ahead, flow)
        g = self.gains
        wanted_speed += g.position_gain / self.pace * braked(error, g.braking * self._full_speed * self.pace)
        wanted_speed -= g.damping * self._oscillation / flow.stiffness * (flow.force - now.slow_force)
        return self._model.opening((wanted_speed - other_speed) / flow_gain, flow), now

    def estimates(self, memory: FlowLinearisingState) -> Singles:
        """Estimates of the controller, (N, 5), numbers of order 1.

        Reference minus position in 0.1 mm, flow gain in tenths, leak in l/min at 100 bar, offset in hundredths of full
        speed, speed as a fraction of full speed.
        """
        x = memory.estimate
        speed = (1.0 + x[:, FLOW_GAIN]) * memory.speed + x[:, LEAK] * memory.leak + x[:, OFFSET]
        columns = [
            1e4 * (memory.reference[:, 1] - x[:, POSITION]),
            10.0 * x[:, FLOW_GAIN],
            x[:, LEAK] * LEAKAGE_TEST_PRESSURE / LITRE_PER_MINUTE,
            100.0 * x[:, OFFSET] / self._full_speed,
            speed / self._full_speed,
        ]
        return np.stack(columns, axis=1).astype(np.float32)

    def _fresh(self, batch: Observation, position: Floats, pressures: Floats, spool: Floats) -> FlowLinearisingState:
        """Memory at the start, at rest or in motion."""
        reference = self._preview.start(batch)
        true_speed = self.layout.speed_at_start(batch, self._full_speed)
        supply = self._model.supply(pressures, true_speed)
        flow = self._model.at(position, pressures, supply)
        speed = self._model.speed(spool, flow)
        estimate, covariance = self._filter.start(position, speed, flow.leak, true_speed - speed)
        return FlowLinearisingState(reference, supply, flow.force, flow.force, speed, flow.leak, estimate, covariance)

    def _observed(
        self, old: FlowLinearisingState, batch: Observation, flow: Flow, position: Floats, spool: Floats
    ) -> FlowLinearisingState:
        """Memory one period later, updated from the observations at its end."""
        half = 0.5 * self.layout.control_period
        speed = self._model.speed(spool, flow)
        squeezed = (old.force - flow.force) / flow.stiffness
        travel = half * (old.speed + speed)
        leak_travel = half * (old.leak + flow.leak)
        estimate, covariance = self._filter.advanced(
            old.estimate, old.covariance, travel, leak_travel, squeezed, position
        )
        period = self.config.control_period
        blend = period / (period + self.gains.damping_filter * self.pace)
        slow_force = old.slow_force + blend * (flow.force - old.slow_force)
        reference = self._preview.advanced(old.reference, batch)
        memory = reference, old.supply, flow.force, slow_force, speed, flow.leak, estimate, covariance
        return FlowLinearisingState(*memory)

    def _wanted(self, now: FlowLinearisingState, position_ahead: Floats, flow: Flow) -> tuple[Floats, Floats]:
        """Reference speed with friction feed-forward (m/s), and error at the predicted position (m), each (N,)."""
        steps, jumps = self._jumps.split(now.reference)
        travel, speed, before, after = (steps @ self._weights).T
        g, period = self.gains, self.config.control_period
        force_rate = g.friction * self.config.plant.friction.largest_force / period
        force_rate = force_rate * (np.tanh(speed / self._turned) - np.tanh(before / self._turned))
        force_rate += g.force_rate * self._mass / period**2 * (after - 2.0 * speed + before)
        wanted_speed = speed + force_rate / flow.stiffness
        target = now.reference[:, 1] + travel + self._jumps.begun(jumps, flow.force, now.supply)
        error = target - position_ahead
        return wanted_speed, error
