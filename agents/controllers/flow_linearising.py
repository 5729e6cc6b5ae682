"""Flow linearisation: the command is the valve opening whose flow gives the wanted speed at the measured pressures.

Sources: Merritt, *Hydraulic Control Systems* (1967), chapters 5 and 6: flow of the edges, flow gain, oil columns.
Jelali & Kroll, *Hydraulic Servo-systems* (2003), chapters 5 and 6: inverse valve characteristic, exact linearisation,
pressure feedback. Kalman filter with parameters as states: Ljung & Söderström, *Theory and Practice of Recursive
Identification* (1983), chapter 2.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from agents.controllers.base import Floats, ObservationLayout, as_batch, gain, restarted
from agents.controllers.preview import Preview, path_weights, speed_weights
from hydro_env import TaskConfig
from hydro_env.files import Group
from hydro_env.plant.analysis import closed_port_natural_frequency, closed_port_stiffness, speed_limits
from hydro_env.plant.arrays import plant_coefficients
from hydro_env.units import LEAKAGE_TEST_PRESSURE, LITRE_PER_MINUTE

Array = NDArray[np.float64]


class FlowLinearisingGains(Group):
    """Gains of :class:`FlowLinearising`; all are factors of what the data sheet of the rig gives."""

    position_gain: float = gain(0.5, (0.1, 2.0), "1", "on the error, per delay", high=100.0, logarithmic=True)
    braking: float = gain(
        1.0, (0.1, 10.0), "1", "error, per way at full speed within the delay, beyond which φ is a root",
        high=1e4, logarithmic=True,
    )  # fmt: skip
    lead: float = gain(1.0, (0.0, 2.5), "1", "of the reference speed, in delays", high=10.0)
    prediction: float = gain(0.5, (0.0, 1.5), "1", "of the position, in delays", high=10.0)
    set_off_share: float = gain(1.0, (0.0, 2.0), "1", "set-off before a jump, per half of its time at full speed", high=10.0)
    set_off_delay: float = gain(1.0, (0.0, 4.0), "1", "set-off before a jump, in delays", high=10.0)
    pressure_trust: float = gain(0.9, (0.0, 1.3), "1", "exponent on the flow gain from pressures over its nominal", high=2.0)
    flow_gain: float = gain(1.0, (0.8, 1.25), "1", "of the flow gain of the data sheet", low=0.1, high=10.0, logarithmic=True)
    damping: float = gain(0.0, (-0.5, 0.5), "1", "dynamic pressure feedback", low=-10.0, high=10.0)
    damping_filter: float = gain(1.0, (0.1, 5.0), "1", "of its high-pass, in delays", low=1e-3, high=100.0, logarithmic=True)
    gain_spread: float = gain(0.1, (0.003, 0.5), "1", "uncertainty of the flow gain", high=10.0, logarithmic=True)
    leak_spread: float = gain(1.0, (0.01, 10.0), "l/min at 100 bar", "uncertainty of the leak", high=100.0, logarithmic=True)
    offset_spread: float = gain(0.01, (1e-4, 0.2), "1", "uncertainty of the offset, per full speed", high=10.0, logarithmic=True)
    offset_drift: float = gain(0.02, (1e-3, 1.0), "1/√s", "of the offset, per full speed", high=10.0, logarithmic=True)
    motion_spread: float = gain(0.01, (5e-4, 0.5), "1/√s", "of the speed, per full speed", high=10.0, logarithmic=True)


class FlowLinearisingState(NamedTuple):
    """Memory of the controller."""

    reference: Array  # (N, horizon + 2), m, one period ago to the farthest preview
    supply: Array  # (N,), Pa
    spool: Array  # (N,), as measured
    force: Array  # (N,), N, of the oil on the piston
    slow_force: Array  # (N,), N, low-passed
    flow_speed: Array  # (N,), m/s
    leak_speed: Array
    estimate: Array  # (N, 4): position (m), share of flow gain, leak (share), offset speed (m/s)
    covariance: Array  # (N, 4, 4)


class FlowLinearising:
    memory = FlowLinearisingState

    def __init__(self, gains: FlowLinearisingGains, config: TaskConfig) -> None:
        self.gains = gains
        self.config = config
        self.layout = ObservationLayout.of(config)
        self.preview = Preview(config)
        g, plant, c = gains, config.plant, plant_coefficients(config.plant)
        period, horizon = config.control_period, self.preview.horizon
        self._c = c
        stiffness_a, stiffness_b = c.area_a / c.volume_a0, c.area_b / c.volume_b0
        total = c.area_a * stiffness_a + c.area_b * stiffness_b
        self._share_a, self._share_b = stiffness_a / total, stiffness_b / total  # 1/m²
        self._stiffness = closed_port_stiffness(plant)
        frequency = closed_port_natural_frequency(plant)
        valve = plant.valve
        self.delay = config.command_latency + 0.5 * period + 2.0 * valve.damping_ratio / valve.natural_frequency
        out, back = speed_limits(plant)
        self.full_speed = 0.5 * (out + back)
        self._jump = max(out, back) * period
        self._out, self._back = out, back
        lead, ahead = g.lead * self.delay, g.prediction * self.delay
        self._weights = np.column_stack(
            [speed_weights(lead, horizon, period), path_weights(ahead, horizon, period)]
        )
        self._ahead = ahead
        self._step_times = period * np.arange(0.0, horizon + 1)
        self._gain = g.position_gain / self.delay
        self._near = g.braking * self.full_speed * self.delay
        self._blend = period / (period + g.damping_filter * self.delay)
        self._damp = g.damping * frequency / self._stiffness * 1.0
        self._nominal = c.edge_gain * (self._share_a + self._share_b) * np.sqrt(0.5 * (c.relief_pressure - c.tank_pressure))
        leak = g.leak_spread * LITRE_PER_MINUTE / LEAKAGE_TEST_PRESSURE * (self._share_a + self._share_b)
        self._leak = LITRE_PER_MINUTE / LEAKAGE_TEST_PRESSURE * (self._share_a + self._share_b)
        noise = max(config.sensors.position.noise, 1e-6) if config.sensors.enabled else 1e-6
        self._noise = noise**2
        spread = np.array([noise, g.gain_spread, g.leak_spread, g.offset_spread * self.full_speed])
        self._spread = np.diag(spread**2)
        self._drift_position = (g.motion_spread * self.full_speed) ** 2 * period
        self._drift_offset = (g.offset_drift * self.full_speed) ** 2 * period

    def predict(self, observation, state=None, episode_start=None, deterministic=True):
        del deterministic
        batch, single = as_batch(observation)
        g, c, period = self.gains, self._c, self.layout.control_period
        si = self.layout.si
        position = si(batch, "position")
        pressure_a, pressure_b = si(batch, "pressure_a"), si(batch, "pressure_b")
        spool, command_before = si(batch, "spool_position"), si(batch, "previous_command")
        force = c.area_a * pressure_a - c.area_b * pressure_b
        if state is None or (episode_start is not None and np.any(episode_start)):
            supply = pressure_a + pressure_b - c.tank_pressure
            extend, retract = self._flow_gains(pressure_a, pressure_b, supply)
            zeros = np.zeros(len(batch))
            estimate = np.stack([position, zeros, zeros, -self._speed(command_before, extend, retract)], axis=1)
            covariance = np.broadcast_to(self._spread, (len(batch), 4, 4))
            fresh = FlowLinearisingState(
                self.preview.start(batch), supply, spool, force, force, zeros, zeros, estimate, covariance
            )
            begun = np.ones(len(batch), dtype=np.bool_) if state is None else np.asarray(episode_start)
            old = restarted(state, fresh, episode_start)
        else:
            begun = None
            old = state
        reference = self.preview.advanced(old.reference, batch)
        if begun is not None:
            reference = np.where(begun[:, None], old.reference, reference)

        # Supply at rest
        still = 1.0 / (1.0 + (spool / 0.02) ** 2)
        supply = old.supply + still * (period / 0.2) * (pressure_a + pressure_b - c.tank_pressure - old.supply)
        extend, retract = self._flow_gains(pressure_a, pressure_b, supply)

        # Observer
        flow_speed = self._speed(spool, extend, retract)
        leak_speed = -self._leak * (pressure_a - pressure_b)
        x, p = old.estimate, old.covariance
        f = np.empty((len(batch), 4))
        f[:, 0] = 1.0
        f[:, 1] = 0.5 * period * (old.flow_speed + flow_speed)
        f[:, 2] = 0.5 * period * (old.leak_speed + leak_speed)
        f[:, 3] = period
        squeezed = (force - old.force) / self._stiffness
        row = np.einsum("nij,nj->ni", p, f)  # P f
        place = np.einsum("ni,ni->n", x, f) + f[:, 1] - squeezed
        p00 = np.einsum("ni,ni->n", row, f) + self._drift_position
        innovation = position - place
        total = p00 + self._noise
        k = row / total[:, None]
        k[:, 0] = p00 / total
        if begun is not None:
            k[begun] = 0.0
            place[begun] = position[begun]
        estimate = x + k * innovation[:, None]
        estimate[:, 0] = place + k[:, 0] * innovation
        new_p = p.copy()
        new_p[:, 0, :] = row
        new_p[:, :, 0] = row
        new_p[:, 0, 0] = p00
        column = new_p[:, 0, :].copy()
        new_p -= k[:, :, None] * column[:, None, :]
        if begun is not None:
            new_p[begun] = p[begun]
        new_p[:, 3, 3] += self._drift_offset

        # Where the axis will be
        scale = 1.0 + np.maximum(estimate[:, 1], -0.5)
        other = estimate[:, 2] * leak_speed + estimate[:, 3]
        soon = scale * self._speed(0.5 * (spool + command_before), extend, retract) + other
        place = estimate[:, 0] + self._ahead * soon

        # Wanted speed
        steps = np.diff(reference, axis=1)
        jumps = np.where(np.abs(steps) > self._jump, steps, 0.0)
        smooth = (steps - jumps) @ self._weights
        full = np.where(jumps > 0.0, self._out, self._back)
        early = g.set_off_share * 0.5 * np.abs(jumps) / full + g.set_off_delay * self.delay
        jumped = np.where(early >= self._step_times, jumps, 0.0)[:, 1:].sum(axis=1)
        error = reference[:, 1] + smooth[:, 1] + jumped - place
        size = np.abs(error)
        near = self._near
        root = np.sqrt(near * np.maximum(2.0 * size - near, near))
        correction = self._gain * np.where(size > near, np.sign(error) * root, error)
        slow_force = old.slow_force + self._blend * (force - old.slow_force)
        wanted = smooth[:, 0] + correction - self._damp * (force - slow_force)

        # Command
        flow = (wanted - other) / scale
        command = np.clip(self._opening(flow, extend, retract), -1.0, 1.0)
        action = command.astype(np.float32)[:, None]
        new = FlowLinearisingState(reference, supply, spool, force, slow_force, flow_speed, leak_speed, estimate, new_p)
        return (action[0] if single else action), new

    def _flow_gains(self, pressure_a, pressure_b, supply):
        c = self._c
        low = 0.02 * (c.relief_pressure - c.tank_pressure)
        root = lambda drop: np.sqrt(np.maximum(drop, low))
        a, b = self._share_a * c.edge_gain, self._share_b * c.edge_gain
        extend = a * root(supply - pressure_a) + b * root(pressure_b - c.tank_pressure)
        retract = a * root(pressure_a - c.tank_pressure) + b * root(supply - pressure_b)
        trust, nominal, gain = self.gains.pressure_trust, self._nominal, self.gains.flow_gain
        return gain * nominal * (extend / nominal) ** trust, gain * nominal * (retract / nominal) ** trust

    def _speed(self, spool, extend, retract):
        width = np.sqrt(spool * spool + self._c.underlap_squared)
        return 0.5 * (extend * (width + spool) - retract * (width - spool))

    def _opening(self, speed, extend, retract):
        quarter = 0.25 * self._c.underlap_squared
        forward = (speed + np.sqrt(speed * speed + 4.0 * quarter * extend * retract)) / (2.0 * extend)
        backward = (-speed + np.sqrt(speed * speed + 4.0 * quarter * extend * retract)) / (2.0 * retract)
        return forward - backward
