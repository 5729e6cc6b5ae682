"""Time stamps: dates with times as people, loggers and historians write them, and the distance of rows by them."""

import re

import numpy as np
import pandas as pd

from hydro_env.types import Floats
from hydro_rig.recordings.columns import UNITS
from hydro_rig.recordings.findings import Finding, Weight

FORMATS = (
    "ISO8601",
    "%d.%m.%Y %H:%M:%S.%f",
    "%d-%b-%Y %H:%M:%S.%f",  # as PI writes them, here and in the next line
    "%d-%b-%y %H:%M:%S.%f",
    "%m/%d/%Y %I:%M:%S.%f %p",
    "%m/%d/%Y %H:%M:%S.%f",
    "%d/%m/%Y %I:%M:%S.%f %p",
    "%d/%m/%Y %H:%M:%S.%f",
)
"""Of dates with times; where two fit, the first counts: 03/04/2026 is the fourth of March."""

TRIED = 100  # number of stamps, spread over the file, that show the format
EXCEL_BEGIN = -25569.0 * 86400.0  # s since 1970, begin of the day numbers of Excel
_SECONDS = r"(:\d\d:\d\d)(?![.,:\d])"  # without parts of a second
_DATE = re.compile(r"\d{1,4}[-./]\w{1,3}[-./]\d{2,4}")
_CLOCK = re.compile(r"\d{1,2}:\d\d:\d\d([.,]\d+)?( ?[AP]M)?", re.IGNORECASE)
LARGEST_DEVIATION = 0.02
"""Largest relative deviation of the row distance from a whole fraction of the control period; clocks differ less."""

SLOWEST = 1.5  # longest row distance, in control periods, of a log on its own grid; a slower one misses commands
ROWS_TOGETHER = 20
SHORTEST_DISTANCE = 1e-7  # s between two rows; no rig logs faster, so the unit of the stamps is wrong
COMMON = (0.2, 0.5, 0.8)  # quantiles of the distances that count


def time_stamps(cells: pd.Series) -> tuple[Floats | None, float]:
    """Seconds since the first date and time, and its own since 1970; ``None``: numbers or other text."""
    if pd.api.types.is_numeric_dtype(cells):
        return None, 0.0
    if cells.dtype.kind == "M":
        stamps = pd.to_datetime(cells, utc=True)
    else:
        texts = cells.astype(str).str.strip().str.replace(r"(:\d\d),(\d)", r"\1.\2", regex=True)
        texts = texts.str.replace(_SECONDS, r"\1.0", regex=True)
        some = texts.iloc[:: max(len(texts) // TRIED, 1)]
        usual = min(FORMATS, key=lambda kind: pd.to_datetime(some, errors="coerce", utc=True, format=kind).isna().sum())
        stamps = pd.to_datetime(texts, errors="coerce", utc=True, format=usual)
    if stamps.isna().mean() > 0.5:
        return None, 0.0
    first = stamps.dropna().iloc[0]
    return (stamps - first).dt.total_seconds().to_numpy(float).copy(), first.timestamp()


def with_whole_stamps(table: pd.DataFrame) -> pd.DataFrame:
    """A table in which a column of dates and one of times of day hold the whole stamp, both of them."""
    first = [str(cell).strip() for cell in table.head(1).to_numpy().ravel()]
    dates = [place for place, cell in enumerate(first) if _DATE.fullmatch(cell)]
    clocks = [place for place, cell in enumerate(first) if _CLOCK.fullmatch(cell)]
    if len(dates) == len(clocks) == 1:
        date, clock = (table.iloc[:, place].astype(str).str.strip() for place in dates + clocks)
        for place in dates + clocks:
            table.isetitem(place, date + " " + clock)
    return table


def equidistant(stamps: Floats) -> float | None:
    """Distance of rows that lie at equal distances, s, from their stamps (n,); NaN is a missing stamp.

    Stamps may be rounded, or come late. ``None``: they do not tell the distance, or rows were lost.
    """
    row = np.flatnonzero(np.isfinite(stamps))
    lag = len(row) // 2
    low, distance, high = np.quantile((stamps[row[lag:]] - stamps[row[:-lag]]) / (row[lag:] - row[:-lag]), COMMON)
    usual = np.median(np.diff(stamps[row]))  # 0 between rounded stamps
    lost = usual > 0.0 and abs(usual / distance - 1.0) > LARGEST_DEVIATION
    if distance < SHORTEST_DISTANCE or lost or high - low > LARGEST_DEVIATION * distance:
        return None
    return distance


def row_distance(time: Floats, period: float) -> float:
    """Usual distance of two rows in s: the median, or that over many rows if only this fits the period."""
    distance = np.median(np.diff(time))
    many = min(ROWS_TOGETHER, len(time) - 1)
    together = np.median(time[many:] - time[:-many]) / many
    return distance if whole_fraction(distance, period) or not whole_fraction(together, period) else together


def whole_fraction(distance: float, period: float) -> int:
    """Rows per control period; 0 if the row distance is not a whole fraction of it."""
    rows = round(period / max(distance, SHORTEST_DISTANCE))
    return rows if rows >= 1 and abs(distance * rows / period - 1.0) <= LARGEST_DEVIATION else 0


def other_sampling(distance: float, period: float, unit: str) -> Finding:
    """The finding that the row distance does not fit the control period, with a unit of time that would fit."""
    units = UNITS["time"]
    rows = {name: whole_fraction(distance * units[name] / units[unit], period) for name in units}
    fitting = [name for name in units if 1 <= rows[name] <= 100]
    what = f"has one row every {1e3 * distance:.4g} ms, but the rig's control period is {1e3 * period:g} ms"
    if fitting:
        what += f"; stamps in {min(fitting, key=rows.__getitem__)} instead of {unit} would fit"
    else:
        what += f": the commands between the rows are unknown; {1.0 / (SLOWEST * period):.0f} rows a second would do, "
        what += "a measured flow at this rate, or the --task of this rig with its control period"
    return Finding("time", what, Weight.SEVERE)
