"""The results of the page as single numbers of one plant, so that what they hang on can be computed."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from scipy.optimize import brentq

from agents.controllers.sampled_loop import FULL_COMMAND, sampled_loop
from agents.reproduction.closed_loop import bandwidth, sensible_gain
from agents.reproduction.displacement import FIRST_STOP, HELD
from agents.reproduction.energy import cycle_energy
from agents.reproduction.force_rate import force_rate_table, shares
from agents.reproduction.rig import Law, Rig, quick_stop, simplified, with_leak
from agents.reproduction.settling import healthy_frequency, settling_of
from hydro_env import PlantParameters, equilibrium, simulate
from hydro_env.plant.linearisation import linearise

LEAK = 0.3
"""l/min at 100 bar; of all results that do not name another."""

TIGHT, MODERATE = 0.01, 1.0
FRICTION_SHARE = 0.02
"""Friction of the settling times, in parts of what is assumed: little enough that the axis still swings."""


class Setting(NamedTuple):
    """What stays the same while a plant is varied."""

    rig: Rig
    frequency: float  # rad/s, where settling is looked for
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


def rubbing(base: PlantParameters, share: float) -> PlantParameters:
    """The plant with its friction forces times ``share``."""
    friction = base.friction
    if share == 0.0:  # no model slides on forces of zero
        return base.replace(friction={"model": "none"})
    return base.replace(
        friction={
            "coulomb_force": share * friction.coulomb_force,
            "breakaway_force": share * friction.breakaway_force,
        }
    )


def _leaking(plant: PlantParameters, flow: float, law: Law = "laminar") -> PlantParameters:
    """The leak of a result beside whatever orifice the plant has besides."""
    leaking = with_leak(plant, flow, law)
    extra = plant.leakage.orifice_gain
    return leaking.replace(leakage={"orifice_gain": leaking.leakage.orifice_gain + extra}) if extra else leaking


def _settling(plant: PlantParameters, at: Setting, factor: float, leak: float = LEAK) -> float:
    run = quick_stop(_leaking(rubbing(plant, FRICTION_SHARE), factor * leak), at.rig)
    return settling_of(run, at.frequency, at.rig.stretch).clean


def _settling_ratio(plant: PlantParameters, at: Setting, factor: float) -> float:
    return _settling(plant, at, factor, TIGHT) / _settling(plant, at, factor, MODERATE)


def _natural_frequency(plant: PlantParameters, at: Setting, factor: float) -> float:
    axis = linearise(_leaking(simplified(plant, "none", True), factor * LEAK), position=at.rig.place)
    return axis.hydraulic_mode.natural_frequency / (2 * np.pi)


def _damping(plant: PlantParameters, at: Setting, factor: float) -> float:
    axis = linearise(_leaking(simplified(plant, "none", True), factor * LEAK), position=at.rig.place)
    return axis.hydraulic_mode.damping_ratio


def _move(plant: PlantParameters, at: Setting, factor: float) -> float:
    rig, leaking = at.rig, _leaking(plant, factor * LEAK, "throttle")
    driven = rig.count(rig.stretch * (FIRST_STOP - HELD))
    stopped = rig.count(rig.stretch * 0.03)
    run = simulate(leaking, [rig.voltage] * driven + [0.0] * stopped, rig.sample_time, {"position": rig.start})
    return 1e3 * float(run.position[-1] - run.position[0])


def _share(plant: PlantParameters, at: Setting, factor: float) -> float:
    varied = at.rig.with_parameters(plant)
    table = force_rate_table(varied, "laminar", (factor * LEAK,), plant.leakage.orifice_gain)
    told = shares(table, at.rig.stretch)
    return 100.0 * float(told[told["window"] == "stop"]["leakage_share"].iloc[0])


def _gain_limit(plant: PlantParameters, at: Setting, factor: float) -> float:
    return sampled_loop(_leaking(plant, factor * LEAK), at.rig.place).largest_stable_gain()


def _bandwidth(plant: PlantParameters, at: Setting, factor: float) -> float:
    return bandwidth(sampled_loop(_leaking(plant, factor * LEAK), at.rig.place), at.gain)


def _held_error(plant: PlantParameters, at: Setting, factor: float) -> float:
    """Where the command of a proportional controller is the one that the place asks for; friction left out."""
    leaking, hold = _leaking(plant, factor * MODERATE, "throttle"), at.rig.hold
    gain = FULL_COMMAND * at.rig.holding_gain

    def excess(error: float) -> float:
        return gain * error - equilibrium(leaking, hold - error)[1]

    span = 0.1 * at.rig.parameters.cylinder.stroke
    return 1e3 * float(brentq(excess, -span, span, xtol=1e-9))


def _held_power(plant: PlantParameters, at: Setting, factor: float) -> float:
    leaking = _leaking(plant, factor * MODERATE, "throttle")
    _, voltage = equilibrium(leaking, at.rig.hold)
    run = simulate(leaking, [voltage], at.rig.sample_time, {"position": at.rig.hold})
    return float(run.supply_pressure[0] * run.supply_flow[0])


def _cycle(plant: PlantParameters, at: Setting, factor: float) -> float:
    return cycle_energy(_leaking(plant, factor * MODERATE, "throttle"), at.rig)


RESULTS = (
    Result("move_mm", "Fig. 12: first move", "mm", _move),
    Result("settling_s", "Fig. 13: settling time", "s", _settling),
    Result("settling_ratio", "Fig. 13: settling, tight / 1 l/min", "1", _settling_ratio),
    Result("leakage_share_percent", "Section 4: leakage's share", "%", _share),
    Result("natural_frequency_hz", "natural frequency", "Hz", _natural_frequency),
    Result("damping_ratio", "damping ratio", "1", _damping),
    Result("bandwidth_hz", "closed-loop bandwidth", "Hz", _bandwidth),
    Result("gain_limit_per_m", "largest stable gain", "1/m", _gain_limit),
    Result("held_error_mm", "error of P while holding", "mm", _held_error),
    Result("held_power_w", "power while holding", "W", _held_power),
    Result("cycle_j", "energy of a cycle", "J", _cycle),
)
