"""Recordings as maintenance people export them, for ``hostile_inputs.py``: ways to mangle four axes.

Each way says what of it is true of the axis, so that a verdict may name it: a sensor that sticks really sticks. Only
what no reading can tell apart is true as well: a position that reads 5 % too much looks like a larger valve.
"""

from __future__ import annotations

import gzip
from collections.abc import Callable, Mapping, Sequence
from datetime import datetime, timedelta
from typing import Any, NamedTuple

import numpy as np
import pandas as pd

Change = Callable[[pd.DataFrame], pd.DataFrame]
Values = Callable[[Any], Any]  # of the values of a column
Write = Callable[[pd.DataFrame], bytes]

COLUMNS = ["time [s]", "position [mm]", "pressure_a [bar]", "pressure_b [bar]", "spool_position [%]", "command [V]"]
TIME, POSITION, A, B, SPOOL, COMMAND = COLUMNS
PRESSURES = [A, B]
HALF_STROKE, DAY = 200.0, 86400.0  # mm, s
START = datetime(2026, 3, 1, 8)
NUMBERED = [f"channel {k}" for k in range(1, 7)]
GERMAN = ["Zeit [s]", "Weg [mm]", "Druck A [bar]", "Druck B [bar]", "Ventilschieber [%]", "Stellgröße [V]"]


def csv(sep: str = ",", decimal: str = ".", encoding: str = "utf-8", text: Callable[[str], str] = str) -> Write:
    """A writer of CSV; ``text`` is what is done to its text."""
    return lambda table: text(table.to_csv(index=False, sep=sep, decimal=decimal, lineterminator="\n")).encode(encoding)


class Mangling(NamedTuple):
    """One way to mangle a recording."""

    kind: str
    change: Change = pd.DataFrame.copy
    write: Write = csv()
    true: frozenset[str] = frozenset()  # causes that a verdict may name: signals, and unknowns of the estimator
    ending: str = "csv"


def on(names: str | Sequence[str], function: Values) -> Change:
    """Apply a function to the values of some columns."""
    listed = [names] if isinstance(names, str) else names
    return lambda table: table.assign(**{name: function(table[name]) for name in listed})


def renamed(names: Mapping[str, str], function: Values | None = None) -> Change:
    """Other headings; the function changes the values of the first."""
    changed = on(next(iter(names)), function or (lambda values: values))
    return lambda table: changed(table).rename(columns=names)


def dated(pattern: str, step: float = 0.001, pause: float = 0.0) -> Change:
    """Dates and times, cut to steps in s, with a pause in the middle; MS are milliseconds."""

    def texts(time: pd.Series) -> list[str]:
        seconds = np.floor(time.to_numpy() / step + 1e-6) * step
        stamps = [START + timedelta(seconds=float(second) + 1e-7) for second in seconds]
        return [one.strftime(pattern).replace("MS", f"{one.microsecond // 1000:03d}") for one in stamps]

    return lambda table: renamed({TIME: "time"}, texts)(paused(pause)(table))


def cut(step: float, begin: float = 0.0) -> Change:
    """Numeric stamps, cut to steps in s."""
    return on(TIME, lambda time: (np.floor((time + begin) / step + 1e-6) * step).round(6))


def paused(pause: float) -> Change:
    """The stamps of the second half of the rows are later by a pause in s."""
    return on(TIME, lambda time: time + pause * (np.arange(len(time)) >= 0.5 * len(time)))


def moved(names: str | Sequence[str], rows: int) -> Change:
    """Columns whose values stand some rows late."""
    return on(names, lambda values: values.shift(rows).bfill().ffill())


def every(names: str | Sequence[str], rows: int) -> Change:
    """Columns with a reading in each n-th row, and the last reading again between."""
    return on(names, lambda values: values.where(np.arange(len(values)) % rows == 0).ffill())


def steps(names: str | Sequence[str], size: float) -> Change:
    """Readings that are rounded to steps."""
    return on(names, lambda values: ((values / size).round() * size).round(9))


def deadband(values: pd.Series) -> list[float]:
    """A historian: the stored value changes once the reading has left it by 1."""
    kept = [float(values.iloc[0])]
    for value in values.iloc[1:]:
        kept.append(float(value) if abs(value - kept[-1]) >= 1.0 else kept[-1])
    return kept


def sometimes(share: float, function: Values) -> Values:
    """Change a share of the readings at random places."""
    return lambda values: values.mask(np.random.default_rng(2).random(len(values)) < share, function(values))


def held(values: pd.Series) -> Any:
    """The first reading for ever."""
    return values.iloc[0]


def held_for_a_while(values: pd.Series) -> pd.Series:
    """The reading after 30 % of the rows up to 60 % of them."""
    place = np.arange(len(values)) / len(values)
    return values.mask((place >= 0.3) & (place < 0.6), values.iloc[int(0.3 * len(values))])


def rows(function: Callable[[pd.DataFrame], Any]) -> Change:
    """Some rows in some order, given by their numbers or as a mask."""
    return lambda table: table.iloc[np.asarray(function(table))]


def summary(time: object) -> Change:
    """A row of means at the end."""
    return lambda table: pd.concat([table.astype(object), table.mean().to_frame().T.assign(**{TIME: time})])


def jittering(time: pd.Series) -> Any:
    """Stamps that jitter by 4 ms, in the right order."""
    return np.sort(time + 4e-3 * np.random.default_rng(3).standard_normal(len(time))).round(6)


def set_point(table: pd.DataFrame) -> pd.DataFrame:
    """The wanted position as command: 10 V are half a stroke."""
    wanted = table[POSITION].rolling(9, center=True, min_periods=1).mean().shift(-8).ffill()
    return table.assign(**{COMMAND: 10.0 / HALF_STROKE * wanted})


def difference(table: pd.DataFrame) -> pd.DataFrame:
    """The difference of the pressures instead of both."""
    return renamed({A: "load_pressure [bar]"})(table.assign(**{A: table[A] - table[B]}).drop(columns=B))


def two_columns(table: pd.DataFrame) -> pd.DataFrame:
    """Date and time in columns of their own."""
    days = dated("%d.%m.%Y %H:%M:%S.MS")(table)["time"].str.split(" ", expand=True)
    table = table.assign(**{TIME: days[1]}).rename(columns={TIME: "Time"})
    table.insert(0, "Date", days[0])
    return table


def long_format(table: pd.DataFrame) -> pd.DataFrame:
    """One row per reading."""
    return table.melt(TIME, var_name="tag", value_name="value").sort_values(TIME, kind="stable")


def spaced(text: str) -> str:
    """Columns between spaces, and headings behind a percent sign."""
    return "% " + text.replace(" [", "[").replace(",", " ")


def quoted_commas(text: str) -> str:
    """Decimal commas in cells with quotes."""
    return ('"' + text.replace(",", '","').replace("\n", '"\n"').replace(".", ",")).removesuffix('"')


def of_bad_quality(text: str) -> str:
    """Texts in the last two columns of each fortieth row."""
    lines = text.split("\n")
    lines[20::40] = [line.rsplit(",", 2)[0] + ",Bad,Bad" for line in lines[20::40]]
    return "\n".join(lines)


CHANGES: dict[str, dict[str, Change]] = {
    "stamps": {
        "whole seconds, German dates": dated("%d.%m.%Y %H:%M:%S", 1.0),
        "whole seconds, numbers": cut(1.0),
        "whole seconds from .9 on": cut(1.0, 0.9),
        "0.1 s, numbers": cut(0.1),
        "all stamps equal": on(TIME, lambda time: 0.0 * time),
        "hours with four decimals": renamed({TIME: "time [h]"}, lambda time: (time / 3600).round(4)),
        "US dates with PM": dated("%m/%d/%Y %I:%M:%S.MS %p"),
        "date and time in two columns": two_columns,
        "days of Excel": renamed({TIME: "time"}, lambda time: (46082 + time / DAY).round(10)),
        "single precision since 1970": on(TIME, lambda time: (1772352000 + time).astype(np.float32)),
        "number of the row": renamed({TIME: "time"}, lambda time: range(len(time))),
    },
    "clocks": {
        "stamps jitter by 4 ms": on(TIME, jittering),
        "clock 5 % fast": on(TIME, lambda time: 1.05 * time),
        "newest row first": rows(lambda table: np.arange(len(table))[::-1]),
        "counter overflows at 4.096 s": on(TIME, lambda time: (time % 4.096).round(6)),
        "clock set back by 0.3 s": paused(-0.3),
        "pause of a minute": paused(60.0),
        "pause of a day": paused(DAY),
        "summer time ends": dated("%Y-%m-%dT%H:%M:%S.MS", pause=-3600.0),
    },
    "rows": {
        "row of means with a number": summary(2000.0),
        "row of means without a stamp": summary(None),
        "each row twice": rows(lambda table: np.repeat(np.arange(len(table)), 2)),
        "5 % of the rows lost": rows(lambda table: np.random.default_rng(4).random(len(table)) > 0.05),
        "each second row": rows(lambda table: np.arange(0, len(table), 2)),
        "a second of rows lost": rows(lambda table: np.delete(np.arange(len(table)), np.s_[900:1100])),
        "one row per reading": long_format,
    },
    "units": {
        "position in cm, called mm": on(POSITION, lambda values: 0.1 * values),
        "pressures in psi, called bar": on(PRESSURES, lambda values: 14.503774 * values),
        "pressures in MPa, called bar": on(PRESSURES, lambda values: 0.1 * values),
        "command in %, called V": on(COMMAND, lambda values: 10.0 * values),
        "spool in mA, called %": on(SPOOL, lambda values: 12.0 + 0.08 * values),
        "position from the end of the stroke": on(POSITION, lambda values: values + HALF_STROKE),
        "absolute pressures": on(PRESSURES, lambda bar: bar + 1.013),
    },
    "wiring": {
        "position reversed": on(POSITION, lambda values: -values),
        "spool reversed": on(SPOOL, lambda values: -values),
        "command reversed": on(COMMAND, lambda values: -values),
        "chambers exchanged": renamed({A: B, B: A}),
        "set point as command": set_point,
        "only the difference of pressures": difference,
    },
    "resolution": {
        "pressures in steps of 1 bar": steps(PRESSURES, 1.0),
        "position in steps of 1 mm": steps(POSITION, 1.0),
        "command in steps of 0.1 V": steps(COMMAND, 0.1),
        "deadband of 1 bar": on(PRESSURES, deadband),
    },
    "channels": {
        "pressures 5 rows late": moved(PRESSURES, 5),
        "position 2 rows late": moved(POSITION, 2),
        "command 1 row early": moved(COMMAND, -1),
        "command 3 rows early": moved(COMMAND, -3),
        "pressures in each 4th row, repeated": every(PRESSURES, 4),
        "pressures in each 20th row, repeated": every(PRESSURES, 20),
    },
    "columns": {
        "German headings": renamed(dict(zip(COLUMNS, GERMAN, strict=True))),
        "headings without words": renamed(dict(zip(COLUMNS, NUMBERED, strict=True))),
        "no spool position": lambda table: table.drop(columns=SPOOL),
    },
}
TEXTS: dict[str, Write] = {
    "semicolons and decimal commas": csv(";", ","),
    "UTF-16": csv("\t", encoding="utf-16"),
    "decimal commas in quotes": csv(text=quoted_commas),
    "six lines before": csv(text=lambda text: "Logger 7\nPlant: 3, hall 2\n\nRate: 200\nUnit: x\n\n" + text),
    "headings behind %": csv(text=spaced),
    "a heading too many": csv(text=lambda text: "No.," + text),
    "texts of bad quality": csv(text=of_bad_quality),
    "truncated": csv(text=lambda text: text[: int(0.7 * len(text)) + 3]),
}
FAULTS: dict[str, dict[str, Values]] = {
    A: {
        "offset of 2 bar": lambda bar: bar + 2.0,
        "gain of 1.05": lambda bar: 1.05 * bar,
        "noise of 3 bar": lambda bar: bar + 3.0 * np.random.default_rng(1).standard_normal(len(bar)),
        "spikes": sometimes(0.01, lambda bar: bar + 100.0),
        "clipped": lambda bar: bar.clip(upper=bar.quantile(0.6)),
        "stuck": held,
        "stuck for 3 s": held_for_a_while,
    },
    POSITION: {
        "offset of 5 mm": lambda mm: mm + 5.0,
        "gain of 1.05": lambda mm: 1.05 * mm,
        "spikes": sometimes(0.01, lambda mm: mm + 100.0),
        "stuck": held,
    },
    SPOOL: {
        "offset of 2 %": lambda values: values + 2.0,
        "gain of 1.05": lambda values: 1.05 * values,
        "dead": lambda values: 0.0 * values,
    },
}
TRUE = {
    "absolute pressures": "pressure_a pressure_b supply.tank_pressure",
    "position: gain of 1.05": "position valve.rated_flow",
}
"""Causes that are true of a mangling, beside the signal of a fault."""


def manglings() -> dict[str, Mangling]:
    """All ways by name; with two healthy and two leaking axes they make 300 recordings."""
    found = {"compressed": Mangling("text", write=lambda table: gzip.compress(csv()(table)), ending="csv.gz")}
    found |= {name: Mangling("text", write=write) for name, write in TEXTS.items()}
    for kind, changes in CHANGES.items():
        for name, change in changes.items():
            found[name] = Mangling(kind, change, true=frozenset(TRUE.get(name, "").split()))
    for column, faults in FAULTS.items():
        signal = column.split(" ")[0]
        for what, fault in faults.items():
            true = TRUE.get(f"{signal}: {what}", signal)
            found[f"{signal}: {what}"] = Mangling("sensors", on(column, fault), true=frozenset(true.split()))
    return found
