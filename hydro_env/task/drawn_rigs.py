"""Rigs that nobody has, drawn from a law: what is built and sold. Each episode of such a task has another rig.

The law draws answers to the questions of ``hydro new-rig``. The mass follows from a drawn natural frequency, the size
of the valve from a drawn full speed; what the questions leave open gets that command's assumptions and ranges.
"""

import math
from functools import lru_cache, partial

import numpy as np

from hydro_env.errors import ConfigurationError
from hydro_env.plant.parameters import PlantParameters
from hydro_env.task.configuration import TaskConfig
from hydro_env.task.law import FIRST_SEEDS, RigLaw, StructureLaw
from hydro_env.task.nameplates import rig_values
from hydro_env.task.paces import pace, periods_per_step
from hydro_env.task.rig import Rig, moved, rig_from
from hydro_env.task.sensors import Sensors
from hydro_env.types import ByName
from hydro_env.units import from_unit, rounded

BULK_MODULUS = 1.2e9  # Pa, as nameplates assumes
DEAD = 0.1  # dead volume, of the swept volume, as nameplates assumes
HASTE = 2.0  # radians of its oscillation in which the supply's force brings the largest mass to full speed

TRIES = 100


def _log_uniform(draw: np.random.Generator, low: float, high: float) -> float:
    return math.exp(draw.uniform(math.log(low), math.log(high)))


def drawn_figures(law: RigLaw, seed: int, attempt: int = 0) -> tuple[ByName, dict[str, float]]:
    """The figures of the nameplates of one rig (:func:`~hydro_env.task.nameplates.rig_values`), and its timing in s.

    They have the digits with which nameplates are written.
    """
    draw = np.random.default_rng([seed, attempt])
    between = partial(_log_uniform, draw)

    def often(share: float) -> bool:
        return draw.random() < share

    bore = int(draw.choice(list(law.cylinders)))
    rod = int(draw.choice(law.cylinders[bore]))
    stroke = round(min(between(*law.stroke_per_bore) * bore, 1e3 * law.longest_stroke), -1)
    supply = float(draw.choice(law.supplies))
    both_sides = often(law.double_rod_share)
    area_b = 0.25e-6 * math.pi * (bore**2 - rod**2)
    area_a = area_b if both_sides else 0.25e-6 * math.pi * bore**2

    # No-load speed without tank pressure; the rated flow is that of both edges at 70 bar.
    forces = 1e5 * supply * (area_a + area_b) / 2.0
    wanted = between(*law.full_speed) * math.sqrt((area_a**3 + area_b**3) / (1e5 * supply * area_a))
    sizes = np.array(law.rated_flows) / 6e4 * math.sqrt(2.0 / 70e5)
    size = np.argmin(np.abs(np.log(sizes / (wanted * math.sqrt(2.0)))))
    speed = sizes[size] * math.sqrt(1e5 * supply * area_a / (area_a**3 + area_b**3))

    columns = sum(area / (stroke * 1e-3 * (0.5 * area + DEAD * area_a)) * area for area in (area_a, area_b))
    stiffness = BULK_MODULUS * columns
    frequency = 2.0 * math.pi * between(*law.natural_frequency)
    mass = min(stiffness / frequency**2, (HASTE * forces / speed) ** 2 / stiffness)

    figures: ByName = {
        "bore": from_unit(bore, "mm"),
        "rod": from_unit(rod, "mm"),
        "stroke": from_unit(stroke, "mm", 6),
        "supply_pressure": from_unit(supply, "bar", 6),
        "rated_flow": from_unit(law.rated_flows[size], "l/min", 6),
        "mass": from_unit(mass, "kg", 3),
        "bandwidth": from_unit(between(*law.bandwidth), "Hz", 3),
    }
    top = next((high for high in law.pressure_ranges if high > 1.2 * supply), law.pressure_ranges[-1])
    figures["pressure_range"] = from_unit(top, "bar", 6)
    in_parts = {
        "position_noise": (stroke, "mm"),
        "position_resolution": (stroke, "mm"),
        "position_accuracy": (100, "%"),
        "pressure_noise": (top, "bar"),
        "pressure_accuracy": (100, "%"),
    }
    for name, (whole, unit) in in_parts.items():
        figures[name] = from_unit(whole * between(*getattr(law, name)), unit, 2)
    if both_sides:
        figures["rod_a"] = figures["rod"]
    if often(law.overlap_share):
        figures["overlap"] = from_unit(100 * between(*law.overlap), "%", 2)
    elif often(law.null_flow_share):
        null_flow = between(*law.null_flow) * law.rated_flows[size] * math.sqrt(supply / 70.0)
        figures["null_flow"] = from_unit(null_flow, "l/min", 2)
    if often(law.ratio_share) and not both_sides and 0.4 < area_b / area_a < 0.6:
        figures["spool_ratio"] = 0.5
    if often(law.weight_share):
        figures["external_force"] = from_unit(min(9.81 * mass, 0.3 * 1e5 * supply * area_b), "N", 3)
    if often(law.line_share):
        figures["line_length"] = from_unit(between(*law.line_length), "m", 2)
        figures["line_diameter"] = from_unit(8 + bore // 10, "mm")
        figures["line_kind"] = "hose" if often(0.5) else "pipe"
    if often(law.no_spool_sensor_share):
        figures["absent"] = "spool_position"

    if law.structure.any:
        figures |= _structure(law.structure, figures, np.random.default_rng([seed, attempt, 1]))
    shares = np.array(list(law.periods.values()))
    period = float(draw.choice(list(law.periods), p=shares / shares.sum()))
    low, high = law.latency
    latency = between(low, min(high, period))
    return figures, {"control_period": 1e-3 * period, "command_latency": 1e-3 * round(latency, 2)}


def _structure(law: StructureLaw, figures: ByName, draw: np.random.Generator) -> ByName:
    """The figures of the parts that no nameplate tells; draws of their own, so that the rest of the rig stays."""
    between = partial(_log_uniform, draw)
    found: ByName = {}
    bends, has_waves, is_sharp, at_valve, has_hose = draw.random(5)
    frequency, share, damping = between(*law.tip_frequency), between(*law.tip_mass), between(*law.tip_damping)
    length = between(*law.line_length)
    if bends < law.tip_share:
        found["structure_frequency"] = from_unit(frequency, "Hz", 3)
        found["structure_share"], found["structure_damping"] = rounded(share), rounded(damping)
    if has_waves < law.wave_share:
        found |= {"line_waves": "yes", "line_length": from_unit(length, "m", 2)}
        found["line_diameter"] = from_unit(8 + round(1e3 * figures["bore"]) // 10, "mm")
        found["line_kind"] = "hose" if has_hose < 0.5 else "pipe"
        found["pressure_sensors"] = "valve" if at_valve < law.valve_sensor_share else "cylinder"
    if is_sharp < law.sharp_share and "overlap" not in figures:
        found["edges"] = "sharp"
    return found


def with_steps_of_the_supply(rig: Rig) -> Rig:
    """A drawn rig whose pressure readings have steps by its supply, not by their range, as in training."""
    sizes = rig.plant.supply.pressure / PlantParameters().supply.pressure
    sensors = Sensors()
    steps = {name: sizes * getattr(sensors, name).resolution for name in ("pressure_a", "pressure_b")}
    return rig._replace(sensors={f"sensors.{name}.resolution": step for name, step in steps.items()} | rig.sensors)


def drawn_rig(law: RigLaw, seed: int) -> tuple[Rig, dict[str, float]]:
    """A rig, and the timing of its task; a rig that cannot work is drawn again.

    Raises:
        ConfigurationError: none of :data:`TRIES` rigs can work.
    """
    fault = ConfigurationError("law: no rig was drawn")
    for attempt in range(TRIES):
        figures, timing = drawn_figures(law, seed, attempt)
        try:
            return with_steps_of_the_supply(rig_from(rig_values(figures), f"rig {seed} of the law")), timing
        except ConfigurationError as error:
            fault = error
    raise ConfigurationError(f"law: none of {TRIES} drawn rigs can work; the last one: {' '.join(str(fault).split())}")


def drawn_task(config: TaskConfig, law: RigLaw, seed: int) -> TaskConfig:
    """A task on a drawn rig, with its timing; its rewards count per pace of the rig.

    Raises:
        ConfigurationError: none of the drawn rigs can work.
    """
    rig, timing = drawn_rig(law, seed)
    task = TaskConfig.model_validate(moved(config, rig) | timing | {"law": None, "command_latency_range": None})
    # A control period is a larger part of a fast rig's pace than of a slow one's; a failure is paid once.
    weights = {name: getattr(task.reward, name) / periods_per_step(task) for name in ("tracking", "effort")}
    task = task.changed(reward=task.reward.changed(**weights))
    if not law.preview_paces:
        return task
    own, count, times = pace(task), 0, []
    for paces in law.preview_paces:  # each is at least one period beyond the one before
        count = max(round(paces * own / task.control_period), count + 1)
        times.append(count * task.control_period)
    return task.changed(references=task.references.changed(preview_times=tuple(times)))


def rig_tasks(config: TaskConfig) -> tuple[TaskConfig, ...]:
    """The task on each rig of its law; a task without a law is returned alone.

    Raises:
        ConfigurationError: the law can draw no working rig.
    """
    return _drawn_tasks(config, config.law) if config.law else (config,)


@lru_cache(maxsize=8)  # drawing takes some milliseconds per rig
def _drawn_tasks(config: TaskConfig, law: RigLaw) -> tuple[TaskConfig, ...]:
    first = FIRST_SEEDS[law.split] + law.first
    return tuple(drawn_task(config, law, seed) for seed in range(first, first + law.count))
