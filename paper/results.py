"""The results of the page as single numbers of one plant, for their sensitivity to parameters."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from scipy.optimize import brentq

from hydro_agents.controllers.sampled_loop import SampledLoop, sampled_loop
from hydro_agents.report.leaks import MODERATE, TIGHT
from hydro_env import PlantParameters, equilibrium, simulate
from hydro_env.plant.linearisation import Mode, linearise
from hydro_env.units import FULL_VOLTAGE
from paper.closed_loop import bandwidth, sensible_gain
from paper.force_rate import force_rate_table, shares
from paper.holding import cycle_energy, holding_power
from paper.moves import FIRST_STOP, HELD
from paper.rig import Law, Rig, quick_stop, simplified, with_friction_share, with_leak
from paper.settling import healthy_frequency, settling_of

LEAK = 0.3
"""l/min at 100 bar; leak of all results without another leak."""

FRICTION_SHARE = 0.02
"""Friction of the settling times relative to the assumed friction; small enough for the axis to oscillate."""


class Setting(NamedTuple):
    """Settings that do not change while a plant is varied."""

    rig: Rig
    frequency: float  # rad/s, of the oscillation that settles
    gain: float  # of the closed loop, command per metre


class Result(NamedTuple):
    """One number of the page."""

    name: str
    words: str
    unit: str
    compute: Callable[[PlantParameters, Setting, float], float]  # plant, setting, factor on the leak


def setting_of(rig: Rig) -> Setting:
    """The setting of a rig."""
    return Setting(rig, healthy_frequency(rig), sensible_gain(rig))


def _leaking(plant: PlantParameters, flow: float, law: Law = "laminar") -> PlantParameters:
    """The plant with the leak of a result, in addition to its own orifice."""
    leaking = with_leak(plant, flow, law)
    extra = plant.leakage.orifice_gain
    return leaking.replace(leakage={"orifice_gain": leaking.leakage.orifice_gain + extra}) if extra else leaking


def _settling(plant: PlantParameters, at: Setting, factor: float, leak: float = LEAK) -> float:
    run = quick_stop(_leaking(with_friction_share(plant, FRICTION_SHARE), factor * leak), at.rig)
    return settling_of(run, at.frequency, at.rig.stretch).clean_s


def _settling_ratio(plant: PlantParameters, at: Setting, factor: float) -> float:
    return _settling(plant, at, factor, TIGHT) / _settling(plant, at, factor, MODERATE)


def _mode(plant: PlantParameters, at: Setting, factor: float) -> Mode:
    leaking = _leaking(simplified(plant, "none", True), factor * LEAK)
    return linearise(leaking, position=at.rig.place).hydraulic_mode


def _move(plant: PlantParameters, at: Setting, factor: float) -> float:
    rig, leaking = at.rig, _leaking(plant, factor * LEAK, "throttle")
    driven = rig.count(rig.stretch * (FIRST_STOP - HELD))
    stopped = rig.count(rig.stretch * 0.03)
    run = simulate(leaking, [rig.voltage] * driven + [0.0] * stopped, rig.sample_time, {"position": rig.start})
    return 1e3 * float(run.position[-1] - run.position[0])


def _share(plant: PlantParameters, at: Setting, factor: float) -> float:
    varied = replace(at.rig, parameters=plant)
    table = force_rate_table(varied, "laminar", (factor * LEAK,), plant.leakage.orifice_gain)
    windows = shares(table, at.rig.stretch).set_index("window")
    return 100.0 * float(windows.loc["stop", "leakage_share"])


def _loop(plant: PlantParameters, at: Setting, factor: float) -> SampledLoop:
    return sampled_loop(_leaking(plant, factor * LEAK), at.rig.place)


def _held_error(plant: PlantParameters, at: Setting, factor: float) -> float:
    """Error at which the command of a proportional controller holds the position, without friction."""
    leaking, hold = _leaking(plant, factor * MODERATE, "throttle"), at.rig.hold
    gain = FULL_VOLTAGE * at.rig.holding_gain

    def excess(error: float) -> float:
        return gain * error - equilibrium(leaking, hold - error)[1]

    span = 0.1 * at.rig.parameters.cylinder.stroke
    return 1e3 * float(brentq(excess, -span, span, xtol=1e-9))


def _held_power(plant: PlantParameters, at: Setting, factor: float) -> float:
    return holding_power(_leaking(plant, factor * MODERATE, "throttle"), at.rig.hold, at.rig.sample_time)


RESULTS = (
    Result("move_mm", "Fig. 12: first move", "mm", _move),
    Result("settling_s", "Fig. 13: settling time", "s", _settling),
    Result("settling_ratio", "Fig. 13: settling, tight / 1 l/min", "1", _settling_ratio),
    Result("leakage_share_percent", "Section 4: leakage's share", "%", _share),
    Result("natural_frequency_hz", "natural frequency", "Hz", lambda *a: _mode(*a).natural_frequency / (2 * np.pi)),
    Result("damping_ratio", "damping ratio", "1", lambda *a: _mode(*a).damping_ratio),
    Result("bandwidth_hz", "closed-loop bandwidth", "Hz", lambda p, at, f: bandwidth(_loop(p, at, f), at.gain)),
    Result("gain_limit_per_m", "largest stable gain", "1/m", lambda *a: _loop(*a).largest_stable_gain()),
    Result("held_error_mm", "error of P while holding", "mm", _held_error),
    Result("held_power_w", "power while holding", "W", _held_power),
    Result(
        "cycle_j",
        "energy of a cycle",
        "J",
        lambda p, at, f: cycle_energy(_leaking(p, f * MODERATE, "throttle"), at.rig),
    ),
)
