"""Changes of the table of a recording, and writers of it, for ``hostile_recordings.py``."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from datetime import datetime, timedelta
from typing import Any, NamedTuple

import numpy as np
import pandas as pd

Change = Callable[[pd.DataFrame], pd.DataFrame]
Values = Callable[[Any], Any]  # of the values of a column

COLUMNS = ["time [s]", "position [mm]", "pressure_a [bar]", "pressure_b [bar]", "spool_position [%]", "command [V]"]
TIME, POSITION, A, B, SPOOL, COMMAND = COLUMNS
PRESSURES = [A, B]
HALF_STROKE = 200.0  # mm
START = datetime(2026, 3, 1, 8)
NUMBERED = [f"channel {k}" for k in range(1, 7)]
GERMAN = ["Zeit [s]", "Weg [mm]", "Druck A [bar]", "Druck B [bar]", "Ventilschieber [%]", "Stellgröße [V]"]


class Mangling(NamedTuple):
    """One way to mangle a recording."""

    kind: str
    change: Change
    write: Callable[[pd.DataFrame], bytes]
    true: frozenset[str] = frozenset()  # causes that a verdict may name: signals, and unknowns of the estimator
    ending: str = "csv"


def plain(table: pd.DataFrame) -> pd.DataFrame:
    """The table as it is."""
    return table


def csv(
    sep: str = ",",
    decimal: str = ".",
    encoding: str = "utf-8",
    text: Callable[[str], str] = lambda text: text,
    **how: Any,
) -> Callable[[pd.DataFrame], bytes]:
    """A writer of CSV: options of ``pandas``, and what is done to the text."""
    return lambda table: text(table.to_csv(index=False, sep=sep, decimal=decimal, lineterminator="\n", **how)).encode(
        encoding
    )


def on(names: str | Sequence[str], function: Callable[[Any], Any]) -> Change:
    """Apply a function to the values of some columns."""
    listed = [names] if isinstance(names, str) else names
    return lambda table: table.assign(**{name: function(table[name]) for name in listed})


def named(names: dict[str, str]) -> Change:
    """Other headings."""
    return lambda table: table.rename(columns=names)


def then(*changes: Change) -> Change:
    """One change after the other."""

    def change(table: pd.DataFrame) -> pd.DataFrame:
        for one in changes:
            table = one(table)
        return table

    return change


def unit(name: str, new: str, gain: float, offset: float = 0.0) -> Change:
    """Another unit, which the heading tells."""
    return then(on(name, lambda values: gain * values + offset), named({name: f"{name.split(' ')[0]} [{new}]"}))


def dated(pattern: str = "%Y-%m-%dT%H:%M:%S.MS", step: float = 0.001, begin: float = 0.0) -> Change:
    """Dates and times, cut to steps in s; MS are milliseconds."""

    def texts(time: Any) -> list[str]:
        seconds = np.floor((np.asarray(time) + begin) / step + 1e-6) * step
        stamps = [START + timedelta(seconds=float(second) + 1e-7) for second in seconds]
        return [one.strftime(pattern).replace("MS", f"{one.microsecond // 1000:03d}") for one in stamps]

    return then(on(TIME, texts), named({TIME: "time"}))


def cut(step: float, begin: float = 0.0) -> Change:
    """Numeric stamps, cut to steps in s."""
    return on(TIME, lambda time: (np.floor((time + begin) / step + 1e-6) * step).round(6))


def paused(pause: float, at: float = 0.5) -> Change:
    """The stamps after a share of the rows are later by a pause in s."""
    return on(TIME, lambda time: time + pause * (np.arange(len(time)) >= at * len(time)))


def moved(name: str | Sequence[str], rows: int) -> Change:
    """Columns whose values stand some rows late."""
    return on(name, lambda values: values.shift(rows).bfill().ffill())


def every(names: str | Sequence[str], rows: int, repeated: bool = False) -> Change:
    """Columns with a reading in each n-th row: blank cells between, or the last reading again."""

    def slower(values: pd.Series) -> pd.Series:
        kept = values.where(np.arange(len(values)) % rows == 0)
        return kept.ffill() if repeated else kept

    return on(names, slower)


def steps(names: str | Sequence[str], size: float) -> Change:
    """Readings that are rounded to steps."""
    return on(names, lambda values: ((values / size).round() * size).round(9))


def deadband(names: str | Sequence[str], size: float) -> Change:
    """A historian: the stored value changes once the reading has left it by so much."""

    def stored(values: pd.Series) -> list[float]:
        kept = [float(values.iloc[0])]
        for value in values.iloc[1:]:
            kept.append(float(value) if abs(value - kept[-1]) >= size else kept[-1])
        return kept

    return on(names, stored)


def noise(size: float) -> Values:
    """A sensor with more noise."""
    return lambda values: values + size * np.random.default_rng(1).standard_normal(len(values))


def sometimes(share: float, function: Values) -> Values:
    """Change a share of the readings at random places."""
    return lambda values: values.mask(np.random.default_rng(2).random(len(values)) < share, function(values))


def during(begin: float, end: float, function: Values) -> Values:
    """Change the readings of a part of the rows, given as shares of them; the function gets those of this part."""

    def change(values: Any) -> Any:
        part = slice(int(begin * len(values)), int(end * len(values)))
        changed = values.copy()
        changed.iloc[part] = function(values.iloc[part])
        return changed

    return change


def held(values: Any) -> Any:
    """The first reading for ever."""
    return values.iloc[0]


def rows(function: Callable[[pd.DataFrame], Any]) -> Change:
    """Some rows in some order, given by their numbers or as a mask."""
    return lambda table: table.iloc[np.asarray(function(table))]


def summary(time: object) -> Change:
    """A row of means at the end."""
    return lambda table: pd.concat([table.astype(object), table.mean().to_frame().T.assign(**{TIME: time})])


def jitter(size: float) -> Change:
    """Stamps that jitter by a standard deviation in s, in the right order."""
    return on(TIME, lambda time: np.sort(time + size * np.random.default_rng(3).standard_normal(len(time))).round(6))


def set_point(table: pd.DataFrame) -> pd.DataFrame:
    """The wanted position as command: 10 V are half a stroke."""
    wanted = table[POSITION].rolling(9, center=True, min_periods=1).mean().shift(-8).ffill()
    return table.assign(**{COMMAND: 10.0 / HALF_STROKE * wanted})


def blank_rows(text: str) -> str:
    """A blank line after each fiftieth."""
    lines = text.split("\n")
    return "\n".join(line + "\n" * (k % 50 == 49) for k, line in enumerate(lines))


def two_columns(table: pd.DataFrame) -> pd.DataFrame:
    """Date and time in columns of their own."""
    days = dated("%d.%m.%Y %H:%M:%S.MS")(table)["time"].str.split(" ", expand=True)
    table = table.assign(**{TIME: days[1]}).rename(columns={TIME: "Time"})
    table.insert(0, "Date", days[0])
    return table


def long_format(table: pd.DataFrame) -> pd.DataFrame:
    """One row per reading."""
    return table.melt(TIME, var_name="tag", value_name="value").sort_values(TIME, kind="stable")


def milliamperes(name: str, low: float, high: float) -> Change:
    """A signal as 4 to 20 mA under its usual heading."""
    return on(name, lambda values: 4.0 + 16.0 * (values - low) / (high - low))


def spaced(text: str) -> str:
    """Columns between spaces, and headings behind a percent sign."""
    first, _, rest = text.replace(" [", "[").replace(",", " ").partition("\n")
    return f"% {first}\n{rest}"
