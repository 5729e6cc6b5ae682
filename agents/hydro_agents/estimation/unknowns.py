"""The default unknowns of an estimate, and their priors."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from hydro_agents.estimation.names import (
    BIASES,
    EXTERNAL_LEAKAGE,
    EXTERNAL_RESISTANCE,
    LATENCY,
    LEAKAGE,
)
from hydro_agents.estimation.priors import Prior, prior_of
from hydro_env import ConfigurationError, TaskConfig

START = tuple(
    f"start.{name}" for name in ("position", "velocity", "pressure_a", "pressure_b", "spool_position", "spool_velocity")
)
"""Start states of every window."""


def default_unknowns(config: TaskConfig) -> tuple[str, ...]:
    """All quantities that an episode draws, including faults, and the start: leaks, plant, biases, start states."""
    faults, drawn = config.faults, config.randomisation
    others = {
        EXTERNAL_LEAKAGE: EXTERNAL_RESISTANCE in drawn or faults.external_leak.probability > 0.0,
        "valve.null_shift": faults.valve_null_shift.probability > 0.0,
        "supply.tank_pressure": faults.tank_pressure.probability > 0.0,
        "load.external_force": config.disturbance.kind != "none" or config.disturbance.steady_share[1] > 0.0,
        LATENCY: config.command_latency_range is not None,
        **dict.fromkeys(BIASES, config.sensors.enabled),
        **dict.fromkeys(START, True),
        "start.supply_pressure": config.plant.supply.model != "constant",
        "start.bristle_deflection": config.plant.friction.model == "lugre",
    }
    plant = [path for path in drawn if path != EXTERNAL_RESISTANCE]
    return (LEAKAGE, *plant, *(name for name, included in others.items() if included and name not in plant))


def priors_of(
    config: TaskConfig, unknowns: Sequence[str] | None = None, priors: Mapping[str, Prior] | None = None
) -> dict[str, Prior]:
    """The prior of each unknown by name, in order: that of the task, unless ``priors`` gives another.

    Raises:
        ConfigurationError: a name is unknown or occurs twice.
    """
    names = default_unknowns(config) if unknowns is None else tuple(unknowns)
    for name in names:
        if names.count(name) > 1:
            raise ConfigurationError(f"unknowns: '{name}' occurs twice")
    for name in priors or {}:
        if name not in names:
            raise ConfigurationError(f"priors: '{name}' is not among the unknowns")
    own = priors or {}
    return {name: own[name] if name in own else prior_of(config, name) for name in names}
