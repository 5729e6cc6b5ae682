"""Rigs that nobody has: answers to the questions of ``hydro new-rig``, drawn from what is built and sold.

Cylinders of the usual bores and rods, servo and proportional valves of the usual sizes, supplies from 70 to 250 bar.
The mass follows from a drawn natural frequency, the size of the valve from a drawn full speed. What the questions leave
open gets the assumptions and ranges of ``hydro new-rig``.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np

from hydro_agents.rigs.new_rig import answers_from, new_rig
from hydro_env import ConfigurationError, TaskConfig
from hydro_env.files import write_text
from hydro_env.task.configuration import task_config

BORES_AND_RODS = {
    25: (12, 14, 18),
    32: (14, 18, 22),
    40: (18, 22, 28),
    50: (22, 28, 36),
    63: (28, 36, 45),
    80: (36, 45, 56),
    100: (45, 56, 70),
    125: (56, 70, 90),
}
"""mm; ISO 6020 and 3320."""

RATED_FLOWS = (5.0, 10.0, 20.0, 40.0, 60.0, 100.0, 150.0, 250.0)  # l/min at 70 bar
SUPPLIES = (70.0, 100.0, 120.0, 160.0, 210.0, 250.0)  # bar
RANGES = (100.0, 160.0, 250.0, 400.0)  # bar, of pressure sensors
PERIODS, SHARES = (1.0, 2.0, 4.0, 5.0, 8.0, 10.0), (0.1, 0.2, 0.2, 0.2, 0.15, 0.15)  # ms, and how often each occurs

BULK_MODULUS, DEAD = 1.2e9, 0.1  # Pa, and of the swept volume, as hydro new-rig assumes
HASTE = 2.0
"""Radians of its oscillation in which the supply's force brings the largest mass to full speed."""

TRIES = 100


def drawn_answers(seed: int, attempt: int = 0) -> tuple[dict[str, str], dict[str, Any]]:
    """The texts of the answers by key, and the timing of the task in s, of one rig."""
    draw = np.random.default_rng([seed, attempt])

    def between(low: float, high: float) -> float:
        return float(math.exp(draw.uniform(math.log(low), math.log(high))))

    def often(share: float) -> bool:
        return bool(draw.random() < share)

    bore = int(draw.choice(list(BORES_AND_RODS)))
    rod = int(draw.choice(BORES_AND_RODS[bore]))
    stroke = round(min(between(3.0, 15.0) * bore, 1200.0), -1)
    supply = float(draw.choice(SUPPLIES))
    both_sides = often(0.15)
    area_b = 0.25e-6 * math.pi * (bore**2 - rod**2)
    area_a = area_b if both_sides else 0.25e-6 * math.pi * bore**2

    # No-load speed without tank pressure; the rated flow is that of both edges at 70 bar.
    forces = 1e5 * supply * (area_a + area_b) / 2.0
    wanted = between(0.1, 1.0) * math.sqrt((area_a**3 + area_b**3) / (1e5 * supply * area_a))
    sizes = np.array(RATED_FLOWS) / 6e4 * math.sqrt(2.0 / 70e5)
    size = int(np.argmin(np.abs(np.log(sizes / (wanted * math.sqrt(2.0))))))
    speed = sizes[size] * math.sqrt(1e5 * supply * area_a / (area_a**3 + area_b**3))

    columns = sum(area / (stroke * 1e-3 * (0.5 * area + DEAD * area_a)) * area for area in (area_a, area_b))
    stiffness = BULK_MODULUS * columns
    frequency = 2.0 * math.pi * between(10.0, 80.0)
    mass = min(stiffness / frequency**2, (HASTE * forces / speed) ** 2 / stiffness)

    texts = {
        "bore": f"{bore} mm",
        "rod": f"{rod} mm",
        "stroke": f"{stroke:g} mm",
        "supply_pressure": f"{supply:g} bar",
        "rated_flow": f"{RATED_FLOWS[size]:g} l/min",
        "mass": f"{mass:.3g} kg",
        "bandwidth": f"{between(30.0, 150.0):.3g} Hz",
        "position_noise": f"{between(1e-5, 1e-4) * stroke:.2g} mm",
        "position_resolution": f"{between(1e-6, 4e-5) * stroke:.2g} mm",
        "position_accuracy": f"{between(0.01, 0.1):.2g} %",
    }
    top = next(high for high in RANGES if high > 1.2 * supply)
    texts |= {"pressure_range": f"{top:g} bar", "pressure_noise": f"{between(2e-4, 2e-3) * top:.2g} bar"}
    texts["pressure_accuracy"] = f"{between(0.25, 1.0):.2g} %"
    if both_sides:
        texts["rod_a"] = texts["rod"]
    if often(0.3):
        texts["overlap"] = f"{between(1.0, 10.0):.2g} %"
    elif often(0.5):
        null_flow = between(0.002, 0.03) * RATED_FLOWS[size] * math.sqrt(supply / 70.0)
        texts["null_flow"] = f"{null_flow:.2g} l/min"
    if often(0.2) and not both_sides and 0.4 < area_b / area_a < 0.6:
        texts["spool_ratio"] = "0.5"
    if often(0.2):
        texts["external_force"] = f"{min(9.81 * mass, 0.3 * 1e5 * supply * area_b):.3g} N"
    if often(0.3):
        texts |= {"line_length": f"{between(0.5, 3.0):.2g} m", "line_diameter": f"{8 + bore // 10} mm"}
        texts["line_kind"] = "hose" if often(0.5) else "pipe"
    if often(0.3):
        texts["absent"] = "spool_position"

    period = float(draw.choice(PERIODS, p=SHARES))
    latency = between(0.5, min(5.0, period))
    return texts, {"control_period": 1e-3 * period, "command_latency": 1e-3 * round(latency, 2)}


def drawn_task(folder: Path, seed: int, task: str = "default") -> TaskConfig:
    """The task on a drawn rig, whose file is written to the folder; a rig that cannot work is drawn again.

    Raises:
        ConfigurationError: none of the drawn rigs can work.
    """
    file = folder / f"rig_{seed}.yaml"
    fault = ConfigurationError(f"{file}: no rig was drawn")
    for attempt in range(TRIES):
        texts, timing = drawn_answers(seed, attempt)
        try:
            text, _ = new_rig(answers_from(texts), texts, str(file))
            write_text(file, text)
            return task_config(task, rig=file, **timing)
        except ConfigurationError as error:
            fault = error
    raise fault
