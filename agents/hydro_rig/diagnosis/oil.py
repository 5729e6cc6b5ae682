"""Viscosity of the oil, and leaks at one temperature.

A gap passes a laminar flow in proportion to 1/viscosity: the same worn seal leaks three times as much at 60 °C as at
30 °C. Sizes that are compared over weeks are therefore those at 100 bar and :data:`REFERENCE` °C. The viscosity follows
ASTM D341 (Walther): log10 log10(ν + 0.7) = A − B log10 T, with ν in mm²/s and T in K; the values at 40 °C (the ISO VG
grade, ISO 3448) and at 100 °C fix A and B. The density, which falls by 0.7 % per 10 K, is left out.
"""

from typing import NamedTuple, Self

import numpy as np
from numpy.typing import ArrayLike

from hydro_agents.detection.detector import HALF_WIDTH, Windows
from hydro_env import ConfigurationError
from hydro_env.types import Floats
from hydro_rig.diagnosis.verdict import Leak
from hydro_rig.recordings.recording import Recording

REFERENCE = 40.0  # °C, to which leaks are referred
UNMEASURED = 40.0, 20.0 * 0.9 / HALF_WIDTH  # °C, mean and standard deviation without a thermometer: 20 to 60 with 0.9
THERMOMETER = 1.5  # K, standard deviation of the oil in the gap from what a thermometer in tank or line reads; assumed
KELVIN = 273.15

GRADES = {10: 2.66, 15: 3.41, 22: 4.29, 32: 5.36, 46: 6.76, 68: 8.73, 100: 11.4, 150: 15.0, 220: 19.4, 320: 25.0}
"""mm²/s at 100 °C by ISO VG grade, of a mineral oil of viscosity index 100 (ASTM D2270, column H)."""


class Oil(NamedTuple):
    """Kinematic viscosity in mm²/s at 40 and 100 °C.

    Example:
        >>> from hydro_rig.diagnosis.oil import Oil
        >>> [round(float(value)) for value in Oil.of("46").viscosity([20.0, 40.0, 60.0])]
        [134, 46, 21]
    """

    at_40: float
    at_100: float

    @classmethod
    def of(cls, text: str) -> Self:
        """From an ISO VG grade (``46``), or from both values of a data sheet (``46/8.1``).

        Raises:
            ConfigurationError: the grade is unknown, or the values are impossible.
        """
        cold, _, hot = text.partition("/")
        try:
            oil = cls(float(cold), float(hot) if hot else GRADES[int(cold)])
        except (ValueError, KeyError):
            oil = cls(np.nan, np.nan)
        if not 1.0 <= oil.at_100 < oil.at_40 <= 5000.0:
            raise ConfigurationError(
                f"oil {text}: must be an ISO VG grade ({', '.join(map(str, GRADES))}), or mm²/s at 40 °C and at "
                "100 °C, the second smaller, within 1 to 5000, such as 46/8.1"
            )
        return oil

    def viscosity(self, temperature: ArrayLike) -> Floats:
        """mm²/s at temperatures in °C, any shape."""
        cold, hot = np.log10(np.log10(np.array(self) + 0.7))
        places = np.log10(np.array([40.0, 100.0]) + KELVIN)
        slope = (cold - hot) / (places[1] - places[0])
        double = cold - slope * (np.log10(np.asarray(temperature) + KELVIN) - places[0])
        return 10.0**10.0**double - 0.7

    def factor(self, temperature: ArrayLike) -> Floats:
        """What a leak measured at temperatures in °C is multiplied by to be that at the reference."""
        return self.viscosity(temperature) / self.viscosity(REFERENCE)

    def factors(self, temperature: float, deviations: float = 1.0) -> Floats:
        """:meth:`factor` at the likely temperature, and so many standard deviations below and above it, (3,).

        ``temperature`` is that measured, °C; NaN: unknown.
        """
        middle, deviation = (temperature, THERMOMETER) if np.isfinite(temperature) else UNMEASURED
        return self.factor(middle + deviations * deviation * np.array([0.0, -1.0, 1.0]))


def temperature_of(measured: Recording | Windows) -> float:
    """Mean temperature of the oil in a recording, or in windows of it, °C; NaN: it was not recorded."""
    readings = measured.auxiliary.get("oil_temperature", np.zeros(0))
    known = readings[np.isfinite(readings)]
    return known.mean() if len(known) else np.nan


def common_error(oil: Oil, temperature: float) -> float:
    """Standard deviation, in decades, of the error of the temperature (°C; NaN: unknown) that all sizes share."""
    _, colder, hotter = oil.factors(temperature)
    return 0.5 * np.log10(colder / hotter)


def referred(leak: Leak, oil: Oil, temperature: float) -> Leak:
    """Leaks with their intervals, numbers or arrays, at the reference temperature instead of the measured one, °C."""
    factor, colder, hotter = oil.factors(temperature, HALF_WIDTH)
    value = factor * leak.value
    size = np.maximum(leak.value, 0.0)
    low = value - np.hypot(factor * (leak.value - leak.low), (factor - hotter) * size)
    high = value + np.hypot(factor * (leak.high - leak.value), (colder - factor) * size)
    return Leak(value, low, high)
