"""Axes under given commands, and what their sensors read."""

import numpy as np

from hydro_env import ServoHydraulicVectorEnv, TaskConfig
from hydro_env.plant.parameters import PARAMETER_PATHS
from hydro_env.task.sensors import SENSOR_COLUMNS
from hydro_env.units import resistance_from_flow
from hydro_rig.estimation.unknowns import LEAKAGE

SAMPLES = 161
CONFIG = TaskConfig(episode_duration=1.0)
FEW = (
    LEAKAGE,
    "valve.rated_flow",
    "load.mass",
    "pressure_a_bias",
    "start.position",
    "start.pressure_a",
    "start.pressure_b",
    "start.spool_position",
    "start.supply_pressure",
)
"""Unknowns of tests whose other parameters are known."""
PLANT = PARAMETER_PATHS.index


def sines(axes, time):
    return 0.25 * np.sin(25.0 * time) + 0.12 * np.sin(61.0 * time) + 0.02 - 0.3 * axes.column("position") / 0.02


def driven(config, leak, seeds, samples=SAMPLES, command=sines, start_moving=False, **options):
    """Signals (N, 5, T) of axes under some commands, their physical parameters and states at the first sample."""
    env = ServoHydraulicVectorEnv(len(seeds), config, info=False, autoreset_mode="Disabled")
    options = {"leakage_flow_lpm": np.asarray(leak, float), "initial_position": 0.0, **options}
    env.reset(seed=list(seeds), options=options)
    axes, columns = env.axes, []
    before = 15 if start_moving else 0
    for step in range(samples + before):
        if step == before:
            start = axes.state.copy()
        if step >= before:
            columns.append(np.column_stack([axes.column("measured")[:, SENSOR_COLUMNS], axes.column("command")]))
        acting = command(axes, step * config.control_period)
        env.step(np.clip(acting, -1.0, 1.0).astype(np.float32)[:, None])
    physical = axes.physical.copy()
    physical[:, PLANT("leakage.internal_resistance")] = [resistance_from_flow(flow) for flow in leak]
    return np.stack(columns, axis=-1), physical, start
