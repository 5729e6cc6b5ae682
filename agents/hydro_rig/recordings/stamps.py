"""Time stamps: dates with times as people, loggers and historians write them."""

from __future__ import annotations

import re

import numpy as np
import pandas as pd

from hydro_env.types import Floats

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
    seconds: Floats = (stamps - first).dt.total_seconds().to_numpy(dtype=np.float64).copy()
    return seconds, float(first.timestamp())


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
