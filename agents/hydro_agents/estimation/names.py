"""The names of the unknowns.

``leakage_flow_lpm`` and ``external_leakage_flow_lpm`` (l/min at 100 bar), the path of any number of the plant
(``valve.rated_flow``), ``command_latency`` (s), ``start.`` and a state (``start.velocity``), a sensor and ``_bias``
(its unit) or ``_gain`` (relative, 1: none). SI units otherwise.
"""

from __future__ import annotations

from hydro_env.plant.parameters import MODEL_CODES, PARAMETER_PATHS
from hydro_env.plant.states import STATE_NAMES
from hydro_env.task.randomisation import LEAKAGE_OF_THE_TASK
from hydro_env.task.sensors import SENSORS

LEAKAGE, EXTERNAL_LEAKAGE, LATENCY = "leakage_flow_lpm", "external_leakage_flow_lpm", "command_latency"
BIASES = tuple(f"{channel}_bias" for channel in SENSORS)
GAINS = tuple(f"{channel}_gain" for channel in SENSORS)
STARTS = tuple(f"start.{name}" for name in STATE_NAMES)
EXTERNAL_RESISTANCE = "leakage.external_resistance"

PATHS = tuple(path for path in PARAMETER_PATHS if path not in (*MODEL_CODES, *LEAKAGE_OF_THE_TASK, EXTERNAL_RESISTANCE))
"""Parameters of the plant; the leaks have their own names."""

NAMES = (LEAKAGE, EXTERNAL_LEAKAGE, LATENCY, *BIASES, *GAINS, *STARTS, *PATHS)
"""All possible names of unknowns."""
