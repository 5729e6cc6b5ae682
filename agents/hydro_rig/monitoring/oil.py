"""Viscosity of the oil, and leaks at one temperature.

A gap passes a laminar flow in proportion to 1/viscosity: the same worn seal leaks three times as much at 60 °C as at
30 °C. Sizes that are compared over weeks are therefore those at 100 bar and :data:`REFERENCE` °C.

The viscosity follows ASTM D341 (Walther): log10 log10(ν + 0.7) = A − B log10 T, with ν in mm²/s and T in K. Two values
fix A and B: those at 40 °C (the number of the ISO VG grade, ISO 3448) and at 100 °C. The density, which falls by 0.7 %
per 10 K, is left out.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from hydro_agents.detection.detector import HALF_WIDTH, Reading
from hydro_env import ConfigurationError
from hydro_env.types import Floats

REFERENCE = 40.0  # °C, to which leaks are referred
UNKNOWN_TEMPERATURE = (20.0, 60.0)  # °C, of an oil without a thermometer
COLDEST, HOTTEST = -30.0, 120.0  # °C, of an oil in use
KELVIN = 273.15
THERMOMETER = 1.5
"""K, standard deviation by which the oil in the gap differs from what a thermometer in tank or line reads; assumed."""
WITHIN = 0.9  # share of the range of an unknown temperature that its interval holds

GRADES = {10: 2.66, 15: 3.41, 22: 4.29, 32: 5.36, 46: 6.76, 68: 8.73, 100: 11.4, 150: 15.0, 220: 19.4, 320: 25.0}
"""mm²/s at 100 °C by ISO VG grade, of a mineral oil of viscosity index 100 (ASTM D2270, column H)."""


class Oil(NamedTuple):
    """Kinematic viscosity in mm²/s at 40 and 100 °C.

    Example:
        >>> from hydro_rig.monitoring.oil import Oil
        >>> [round(float(value)) for value in Oil.of("46").viscosity([20.0, 40.0, 60.0])]
        [134, 46, 21]
    """

    at_40: float
    at_100: float

    @classmethod
    def of(cls, text: str) -> Oil:
        """From an ISO VG grade (``46``), or from both values of a data sheet (``46/8.1``).

        Raises:
            ConfigurationError: the grade is unknown, or the values are impossible.
        """
        cold, _, hot = text.upper().removeprefix("ISO").strip().removeprefix("VG").strip().partition("/")
        try:
            oil = cls(float(cold), float(hot) if hot else GRADES[int(cold)])
        except (ValueError, KeyError):
            oil = cls(np.nan, np.nan)
        if not 1.0 <= oil.at_100 < oil.at_40 <= 5000.0:
            raise ConfigurationError(
                f"--oil {text}: must be an ISO VG grade ({', '.join(map(str, GRADES))}), or mm²/s at 40 °C and at "
                "100 °C, the second smaller, within 1 to 5000, such as 46/8.1"
            )
        return oil

    def viscosity(self, temperature: ArrayLike) -> Floats:
        """mm²/s at temperatures in °C, any shape."""
        cold, hot = (np.log10(np.log10(value + 0.7)) for value in self)
        places = np.log10(np.array([40.0, 100.0]) + KELVIN)
        slope = (cold - hot) / (places[1] - places[0])
        double = cold - slope * (np.log10(np.asarray(temperature, dtype=np.float64) + KELVIN) - places[0])
        return np.asarray(10.0**10.0**double - 0.7)

    def factor(self, temperature: ArrayLike) -> Floats:
        """What a leak measured at temperatures in °C is multiplied by to be that at the reference."""
        return self.viscosity(temperature) / self.viscosity(REFERENCE)


def common_error(oil: Oil, temperature: float, between: tuple[float, float]) -> float:
    """Standard deviation, in decades, of the error that all sizes at the reference share: of the thermometer.

    Args:
        oil: in the axis.
        temperature: usual one, °C; NaN: unknown.
        between: lowest and highest possible temperature where it is unknown, °C.
    """
    known = bool(np.isfinite(temperature))
    middle = temperature if known else 0.5 * (between[0] + between[1])
    half = 0.0 if known else 0.5 * WITHIN * (between[1] - between[0]) / HALF_WIDTH
    ends = oil.factor(middle + np.hypot(half, THERMOMETER) * np.array([-1.0, 1.0]))
    return float(0.5 * np.log10(ends[0] / ends[1]))


def temperature_range(text: str) -> tuple[float, float]:
    """Lowest and highest temperature in °C from ``20..60``, or from one number.

    Raises:
        ConfigurationError: the text has another form, or the temperatures are impossible.
    """
    low, _, high = text.partition("..")
    try:
        ends = float(low), float(high or low)
    except ValueError:
        ends = np.nan, np.nan
    if not COLDEST <= ends[0] <= ends[1] <= HOTTEST:
        raise ConfigurationError(f"--temperature {text}: must be °C as 45 or 20..60, within {COLDEST:g} to {HOTTEST:g}")
    return ends


def referred(reading: Reading, oil: Oil, temperature: Floats, between: tuple[float, float]) -> Reading:
    """A reading of N windows with its leaks at the reference temperature.

    Args:
        reading: leaks at the temperatures of the recording.
        oil: in the axis.
        temperature: of each window, °C, (N,); NaN: unknown.
        between: lowest and highest possible temperature where it is unknown, °C; the intervals are widened by it.
    """
    known = np.isfinite(temperature)
    middle, half = 0.5 * (between[0] + between[1]), 0.5 * WITHIN * (between[1] - between[0])
    best = np.where(known, temperature, middle)
    reach = np.hypot(np.where(known, 0.0, half), HALF_WIDTH * THERMOMETER)
    factor, size = oil.factor(best), np.maximum(reading.flow_lpm, 0.0)
    down, up = (factor - oil.factor(best + reach)) * size, (oil.factor(best - reach) - factor) * size
    value = factor * reading.flow_lpm
    low = value - np.hypot(factor * (reading.flow_lpm - reading.low_lpm), down)
    high = value + np.hypot(factor * (reading.high_lpm - reading.flow_lpm), up)
    return reading._replace(flow_lpm=value, low_lpm=low, high_lpm=high)
