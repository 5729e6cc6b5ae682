"""Prior knowledge of the leakage head about an axis: its data sheet, as numbers for compiled code, and priors."""

import math
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from hydro_agents.controllers.sampled_loop import zero_order_hold
from hydro_env import TaskConfig
from hydro_env.compiling import digest_of_sources
from hydro_env.plant.arrays import plant_coefficients
from hydro_env.plant.parameters import Physical, PlantParameters, to_vector
from hydro_env.plant.parts.leakage import LEAK_LAWS
from hydro_env.plant.parts.supply import gas_volume_at
from hydro_env.task.paces import full_speed, within_a_period
from hydro_env.task.randomisation import own_value
from hydro_env.task.settings import settings_of
from hydro_env.task.signals import SHEET, data_sheet
from hydro_env.types import Floats, Singles
from hydro_env.units import FULL_VOLTAGE, LITRE_PER_MINUTE

SOURCES = digest_of_sources(Path(__file__).parent)  # of the kernels of this room and what they call
POINTS = 2  # points between two samples at which the flows are evaluated
FREQUENCIES, DAMPINGS = 9, 3  # numbers of natural frequencies and of damping ratios of the candidate valves
AT_ONCE = 1e5  # 1/s; rate for the ideal parts of the valve model
NOISE_WITHOUT_LAG = 1.17  # factor by which the removal of the transducers' lag raises their noise
SPOOL_NOISE_LEFT = 0.4  # share of the spool sensor's noise that remains after smoothing
LEAK_UNIT = LITRE_PER_MINUTE / LEAK_LAWS["laminar"].at_test  # m³/s per Pa, of 1 l/min at 100 bar
LAP, KNOWN_LAP = 0.005, 1e-6  # standard deviations of the overlap's prior, of full stroke
FLOW_ERROR = 0.015  # error of the flow between two samples, as a fraction of the change due to the spool's motion


class Unknowns(NamedTuple):
    """The unknowns of the fit: their values, their standard deviations, or their priors."""

    flow_gain: Any  # of the valve, relative to the data sheet
    supply_pressure: Any  # Pa, setting of the relief valve
    supply_excess: Any  # Pa, supply pressure above that setting when the window begins
    underlap: Any  # of full stroke
    null: Any  # of full stroke; null shift of the valve and bias of the spool sensor together
    internal_leak: Any  # in the rig's unit of leaks: l/min at 100 bar, times :func:`leak_scale`
    external_leak: Any  # as well
    compressibility: Any  # of the oil without air, relative to the data sheet
    air_fraction: Any
    dead_volume: Any  # m³, above the data sheet's
    bias_a: Any  # Pa, of the pressure transducer of chamber a
    bias_b: Any  # Pa
    tank_pressure: Any  # Pa
    overlap: Any  # of full stroke; negative: all edges are open at the null


class Sheet(NamedTuple):
    """The data sheet of an axis, for the compiled fit."""

    coefficients: Floats  # of the nominal plant
    mean: Floats  # (COUNT,), of the priors
    spread: Floats  # (COUNT,), standard deviations of the priors
    leak_unit: float  # m³/s per Pa, of a leak of 1 in the rig's unit
    transition: Floats  # (valves, POINTS + 1, 3, 5), see _valve_steps
    spool_noise: float  # of full stroke
    sensor_low: Floats  # (4,), lower ends of the ranges of position, pressures and spool position
    sensor_high: Floats  # (4,)
    lowest_a: float  # Pa; below this a reading may be at the end of its range
    lowest_b: float  # Pa
    pressure_decay: float  # exp(−T/τ) of the pressure transducers
    pressure_lag: float  # τ/T
    gas_volume: float  # m³, of the accumulator at the supply's pressure
    period: float  # s
    position_noise: float  # m
    pressure_noise_a: float  # Pa
    pressure_noise_b: float  # Pa
    flow_noise: float  # m per period, travel due to the noise of the spool sensor
    flow_error: float  # m per period, travel at full spool stroke, times FLOW_ERROR


def leak_scale(config: TaskConfig) -> float:
    """Flow into chamber a at full opening over that of the paper's rig: what counts as a small leak grows with it."""
    return _full_flow(config.plant) / _full_flow(PlantParameters())


def _full_flow(plant: PlantParameters) -> float:
    return plant_coefficients(plant).area_a * full_speed(plant)


RIG_FEATURES = (
    *(f"rig: {name.replace('_', ' ')}" for name in SHEET),
    "rig: noise of pressure",
    "rig: leak scale",
    "rig: error of flow",
)
"""Names of the features of a rig, which a head for any axis reads beside those of the window."""


def rig_features(config: TaskConfig) -> Singles:
    """:data:`RIG_FEATURES`, each of order 1."""
    sheet = sheet_of(config, for_any_axis=True)
    sizes = (
        1e3 * sheet.pressure_noise_a / config.plant.supply.pressure,
        leak_scale(config),
        1e3 * sheet.flow_noise / sheet.position_noise + 1e-6,
    )
    return np.array([*data_sheet(config).values(), *np.log10(sizes)], np.float32)


def sheet_of(config: TaskConfig, for_any_axis: bool = False) -> Sheet:
    """The data sheet of a task's axis, with priors that include worn axes.

    The width of a prior is the task's range of the parameter; it is larger if faults change the parameter. For any axis
    no nameplate tells the lap of the valve exactly; its edges may be sharp.

    Raises:
        ConfigurationError: a command acts later than in its own control period.
    """
    within_a_period(config.command_latency, config, "a leakage head")
    plant, sensors = config.plant, config.sensors
    a, b = sensors.pressure_a, sensors.pressure_b
    c = plant_coefficients(plant)
    numbers = settings_of(config)[0]
    priors = _priors(config, LAP if for_any_axis else KNOWN_LAP)
    mean, spread = np.array(priors).T.copy()
    full_flow = c.edge_gain * math.sqrt(0.5 * priors.supply_pressure[0])
    travel = full_flow * config.control_period / min(c.area_a, c.area_b)
    return Sheet(
        coefficients=np.array(c),
        mean=mean,
        spread=spread,
        leak_unit=LEAK_UNIT * leak_scale(config),
        transition=_candidate_valves(config),
        sensor_low=np.array([sensor.low for sensor in sensors.in_order]),
        sensor_high=np.array([sensor.high for sensor in sensors.in_order]),
        lowest_a=a.low + a.bias + 4.0 * a.noise,
        lowest_b=b.low + b.bias + 4.0 * b.noise,
        spool_noise=sensors.spool_position.noise + 1e-9,
        pressure_decay=numbers["pressure_decay"],
        pressure_lag=numbers["pressure_lag"],
        gas_volume=gas_volume_at(plant.supply.pressure, Physical(*to_vector(plant).tolist())),
        period=config.control_period,
        position_noise=math.hypot(sensors.position.noise, sensors.position.resolution) + 1e-9,
        pressure_noise_a=NOISE_WITHOUT_LAG * a.noise + 1.0,
        pressure_noise_b=NOISE_WITHOUT_LAG * b.noise + 1.0,
        flow_noise=SPOOL_NOISE_LEFT * travel * sensors.spool_position.noise + 1e-12,
        flow_error=travel * FLOW_ERROR,
    )


def _middle_and_half(config: TaskConfig, path: str) -> tuple[float, float]:
    """Middle and half width of the range of a parameter, from which episodes draw it."""
    own = own_value(config.plant, path)
    distribution = config.randomisation.get(path)
    if not distribution:
        return own, 0.0
    low, high = distribution.bounds(own)
    return 0.5 * (low + high), 0.5 * (high - low)


def _priors(config: TaskConfig, lap: float) -> Unknowns:
    """Mean and standard deviation of each prior; that of the lap is given."""
    plant, sensors = config.plant, config.sensors
    c = plant_coefficients(plant)
    supply, supply_range = _middle_and_half(config, "supply.pressure")
    dead, dead_range = _middle_and_half(config, "cylinder.dead_volume")
    excess = 0.0
    if c.supply_dynamics > 0.0 and c.relief_slope > 0.0:
        excess = 0.6 * c.pump_flow / c.relief_slope
    return Unknowns(
        flow_gain=(1.0, 0.2),
        supply_pressure=(supply, 0.7 * supply_range + 0.1 * supply),
        supply_excess=(excess, 0.5 * excess + 1e3),
        underlap=(_middle_and_half(config, "valve.underlap")[0], 0.02),
        null=(plant.valve.null_shift, 0.01),
        internal_leak=(0.0, 2.0),
        external_leak=(0.0, 1.0),
        compressibility=(1.1, 0.2),
        air_fraction=(_middle_and_half(config, "fluid.air_fraction")[0], 0.003),
        dead_volume=(dead - plant.cylinder.dead_volume, 0.6 * dead_range + 1e-7),
        bias_a=(0.0, sensors.pressure_a.bias + 1e3),
        bias_b=(0.0, sensors.pressure_b.bias + 1e3),
        tank_pressure=(plant.supply.tank_pressure, 1e5),
        overlap=(plant.valve.overlap, lap),
    )


def _candidate_valves(config: TaskConfig) -> Floats:
    """:func:`_valve_steps` of valves over the ranges of natural frequency and damping ratio."""
    frequency, frequency_range = _middle_and_half(config, "valve.natural_frequency")
    damping, damping_range = _middle_and_half(config, "valve.damping_ratio")
    across = np.linspace(-1.0, 1.0, FREQUENCIES) if frequency_range > 0.0 else np.zeros(1)
    along = np.linspace(-1.0, 1.0, DAMPINGS) if damping_range > 0.0 else np.zeros(1)
    return np.array(
        [
            _valve_steps(config, frequency + off * frequency_range, damping + out * damping_range)
            for off in across
            for out in along
        ]
    )


def _valve_steps(config: TaskConfig, frequency: float, damping: float) -> Floats:
    """Matrices (POINTS + 1, 3, 5) of a valve: its states at the points of a period and at the end of the period.

    They multiply the states at the start, the previous command and the new one. States: spool position, spool speed,
    and coil current (as the commanded spool position).
    """
    c = plant_coefficients(config.plant)
    if c.ideal_spool > 0.0:
        frequency, damping = AT_ONCE, 1.0
    coil = AT_ONCE if c.ideal_drive > 0.0 else c.coil_rate
    a = np.array([[0.0, 1.0, 0.0], [-(frequency**2), -2.0 * damping * frequency, frequency**2], [0.0, 0.0, -coil]])
    b = np.array([0.0, 0.0, coil * FULL_VOLTAGE * c.drive_rate / c.coil_rate * c.spool_gain])
    steps = []
    for share in (*((np.arange(POINTS) + 0.5) / POINTS), 1.0):
        time = share * config.control_period
        first, old = zero_order_hold(a, b, min(time, config.command_latency))
        rest, new = zero_order_hold(a, b, max(time - config.command_latency, 0.0))
        steps.append(np.column_stack([rest @ first, rest @ old, new]))
    return np.array(steps)
