"""How an axis was driven: a limit cycle, and a command at its limit, tell of the controller rather than of the axis."""

from __future__ import annotations

import numpy as np

from hydro_env import TaskConfig
from hydro_env.plant.analysis import closed_port_natural_frequency
from hydro_env.task.sensors import COMMAND, POSITION
from hydro_env.types import Floats
from hydro_env.units import FULL_VOLTAGE
from hydro_rig.recordings.channels import OVERRANGE
from hydro_rig.recordings.findings import Finding, Weight, finding_of
from hydro_rig.recordings.recording import FULL_COMMAND
from hydro_rig.recordings.sampling import Sampled, cut

AXIS = "axis"  # what findings about the manner of operation are about
STRETCH = 1.0  # s, in which an oscillation is looked for
LEAST_FREQUENCY = 0.15  # of a limit cycle, as a share of the natural frequency of the axis on its oil
LEAST_CYCLES = 3  # in a stretch
LEAST_SWING = 0.05  # of the command of an oscillation, as a fraction of full command
LEAST_POWER = 0.6  # share of the oscillation's frequency in the power of command and position
MANY_STRETCHES = 0.25  # share of stretches that oscillate, and of samples at full command, that is worth a word


def check_driving(samples: Sampled, config: TaskConfig) -> list[Finding]:
    """Find a loop that oscillates near the axis's natural frequency, and a valve at full command for long."""
    command, findings = samples.signals[COMMAND], []
    full = np.abs(command) >= FULL_COMMAND
    if (np.abs(command) > OVERRANGE).any():  # the unit is wrong
        return []
    least = LEAST_FREQUENCY * closed_port_natural_frequency(config.plant) / (2.0 * np.pi)
    windows = cut(samples, max(round(STRETCH / samples.period), LEAST_CYCLES))
    swings = [_swing(window[[COMMAND, POSITION]], samples.period, least, config) for window in windows.signals]
    found = [swing for swing in swings if swing is not None]
    if len(found) > MANY_STRETCHES * len(swings):
        frequency, volts, metres = np.median(found, axis=0) * np.array([1.0, FULL_VOLTAGE, 1e3])
        what = f"oscillates at {frequency:.2g} Hz (command ±{volts:.2g} V, position ±{metres:.2g} mm) for much of the "
        what += "recording; unless its reference does so, the gains of its controller are too high for this rig"
        findings.append(Finding(AXIS, what, Weight.NOTE, share=len(found) / len(swings)))
    if full.mean() > MANY_STRETCHES:
        findings.append(finding_of(full, samples.time, AXIS, "runs with the command at its limit", Weight.NOTE))
    return findings


def _swing(signals: Floats, period: float, least: float, config: TaskConfig) -> tuple[float, float, float] | None:
    """Frequency in Hz and amplitudes (SI) of an oscillation of command and position (2, T); ``None``: there is none."""
    if not np.isfinite(signals).all():
        return None
    time = np.linspace(-1.0, 1.0, signals.shape[1])
    motion = signals - np.array([np.polyval(np.polyfit(time, values, 2), time) for values in signals])
    power = np.abs(np.fft.rfft(np.hanning(len(time)) * motion, axis=1)) ** 2
    peak = int(power[0].argmax())
    frequency, near = peak / (len(time) * period), slice(max(peak - 2, 0), peak + 3)
    amplitude = np.sqrt(2.0) * motion.std(axis=1)
    enough = amplitude > np.array([LEAST_SWING, 5.0 * config.sensors.position.noise])
    alone = power[:, near].sum(axis=1) > LEAST_POWER * power.sum(axis=1)
    if peak < LEAST_CYCLES or frequency < least or not (enough & alone).all():
        return None
    return frequency, float(min(amplitude[0], 1.0)), float(amplitude[1])
