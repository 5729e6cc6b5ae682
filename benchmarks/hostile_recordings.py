"""Recordings as maintenance people export them, for ``hostile_inputs.py``: 114 ways to mangle four axes.

Each way says what of it is true of the axis, so that a verdict may name it: a sensor that sticks really sticks. Only
what no reading can tell apart is true as well: a position that reads 5 % too much looks like a larger valve.
"""

from __future__ import annotations

import gzip
from collections.abc import Callable
from typing import Any

import numpy as np
import pandas as pd

from benchmarks.hostile_changes import (
    COLUMNS,
    COMMAND,
    GERMAN,
    HALF_STROKE,
    NUMBERED,
    POSITION,
    PRESSURES,
    SPOOL,
    TIME,
    A,
    B,
    Change,
    Mangling,
    blank_rows,
    csv,
    cut,
    dated,
    deadband,
    during,
    every,
    held,
    jitter,
    long_format,
    milliamperes,
    moved,
    named,
    noise,
    on,
    paused,
    plain,
    rows,
    set_point,
    sometimes,
    spaced,
    steps,
    summary,
    then,
    two_columns,
    unit,
)


def manglings() -> dict[str, Mangling]:
    """All ways by name; with two healthy and two leaking axes they make 456 recordings."""
    found: dict[str, Mangling] = {}

    def add(kind: str, changes: dict[str, Change], true: str = "", write: Any = None, ending: str = "csv") -> None:
        for name, change in changes.items():
            found[name] = Mangling(kind, change, write or csv(), frozenset(true.split()), ending)

    def say(kind: str, writers: dict[str, Callable[[pd.DataFrame], bytes]]) -> None:
        found.update({name: Mangling(kind, plain, write) for name, write in writers.items()})

    day = 86400.0
    add(
        "stamps",
        {
            "whole seconds, German dates": dated("%d.%m.%Y %H:%M:%S", 1.0),
            "whole seconds, ISO dates": dated("%Y-%m-%d %H:%M:%S", 1.0),
            "whole seconds, numbers": cut(1.0),
            "whole seconds from .5 on": cut(1.0, 0.5),
            "whole seconds from .9 on": cut(1.0, 0.9),
            "0.1 s, numbers": cut(0.1),
            "0.1 s, dates": dated("%Y-%m-%dT%H:%M:%S.MS", 0.1),
            "0.01 s, numbers": cut(0.01),
            "all stamps equal": on(TIME, lambda time: 0.0 * time),
            "hours with four decimals": then(unit(TIME, "h", 1 / 3600), on("time [h]", lambda time: time.round(4))),
            "minutes with four decimals": then(unit(TIME, "min", 1 / 60), on("time [min]", lambda time: time.round(4))),
            "ISO dates": dated(),
            "German dates with milliseconds": dated("%d.%m.%Y %H:%M:%S.MS"),
            "PI dates": dated("%d-%b-%Y %H:%M:%S.MS"),
            "US dates with PM": dated("%m/%d/%Y %I:%M:%S.MS %p"),
            "date and time in two columns": two_columns,
            "days of Excel": then(named({TIME: "time"}), on("time", lambda time: (46082 + time / day).round(10))),
            "single precision since 1970": on(TIME, lambda time: (1772352000 + time).astype(np.float32)),
            "number of the row": then(named({TIME: "time"}), on("time", lambda time: range(len(time)))),
        },
    )
    add(
        "clocks",
        {
            "stamps jitter by 4 ms": jitter(4e-3),
            "clock 1 % fast": on(TIME, lambda time: 1.01 * time),
            "clock 5 % fast": on(TIME, lambda time: 1.05 * time),
            "newest row first": rows(lambda table: np.arange(len(table))[::-1]),
            "counter overflows at 4.096 s": on(TIME, lambda time: (time % 4.096).round(6)),
            "clock set by 0.3 s": paused(0.3),
            "clock set back by 0.3 s": paused(-0.3),
        },
    )
    add(
        "pauses",
        {
            "pause of a minute": paused(60.0),
            "pause of a day": paused(day),
            "two pauses of a minute": then(paused(60.0, 0.3), paused(60.0, 0.7)),
            "summer time begins": then(paused(3600.0), dated()),
            "summer time ends": then(paused(-3600.0), dated()),
        },
    )
    add(
        "rows",
        {
            "row of means with a text": summary("mean"),
            "row of means with a number": summary(2000.0),
            "row of means with the length": summary(20.0),
            "row of means without a stamp": summary(None),
            "each row twice": rows(lambda table: np.repeat(np.arange(len(table)), 2)),
            "each hundredth row twice": rows(
                lambda table: np.repeat(np.arange(len(table)), 1 + (np.arange(len(table)) % 100 == 0))
            ),
            "5 % of the rows lost": rows(lambda table: np.random.default_rng(4).random(len(table)) > 0.05),
            "each second row": rows(lambda table: np.arange(0, len(table), 2)),
            "a second of rows lost": rows(lambda table: np.delete(np.arange(len(table)), np.s_[900:1100])),
        },
    )
    say(
        "rows",
        {
            "blank rows": csv(text=blank_rows),
            "headings again": csv(text=lambda text: text[: len(text) // 2].rsplit("\n", 1)[0] + "\n" + text),
            "truncated": csv(text=lambda text: text[: int(0.7 * len(text)) + 3]),
        },
    )
    say(
        "text",
        {
            "semicolons and decimal commas": csv(";", ","),
            "tabs": csv("\t"),
            "spaces": csv(text=lambda text: text.replace(" [", "[").replace(",", "  ")),
            "UTF-16": csv("\t", encoding="utf-16"),
            "all cells in quotes": csv(quoting=1),
            "decimal commas in quotes": csv(
                text=lambda text: (
                    text.replace(",", '","').replace("\n", '"\n"').replace(".", ",").join(['"', ""]).removesuffix('"')
                )
            ),
            "line sep=; of Excel": csv(";", ",", text=lambda text: "sep=;\n" + text),
            "six lines before": csv(text=lambda text: "Logger 7\nPlant: 3, hall 2\n\nRate: 200\nUnit: x\n\n" + text),
            "headings behind %": csv(text=spaced),
            "headings behind #": csv(text=lambda text: "# " + text),
            "a heading too many": csv(text=lambda text: "No.," + text),
            "a heading too few": csv(text=lambda text: text.replace("position [mm],", "", 1)),
            "texts of bad quality": csv(
                text=lambda text: "\n".join(
                    line.rsplit(",", 2)[0] + ",Bad,Bad" if k % 40 == 20 else line
                    for k, line in enumerate(text.split("\n"))
                )
            ),
        },
    )
    add("text", {"compressed": plain}, write=lambda table: gzip.compress(csv()(table)), ending="csv.gz")
    add("text", {"one row per reading": long_format})
    add(
        "units",
        {
            "position in m": unit(POSITION, "m", 1e-3),
            "pressures in MPa": then(unit(A, "MPa", 0.1), unit(B, "MPa", 0.1)),
            "position in cm, called mm": on(POSITION, lambda values: 0.1 * values),
            "pressures in psi, called bar": on(PRESSURES, lambda values: 14.503774 * values),
            "pressures in MPa, called bar": on(PRESSURES, lambda values: 0.1 * values),
            "command in %, called V": on(COMMAND, lambda values: 10.0 * values),
            "spool in parts, called %": on(SPOOL, lambda values: 0.01 * values),
            "spool in mA, called %": milliamperes(SPOOL, -100.0, 100.0),
            "pressure in mA, called bar": milliamperes(A, 0.0, 250.0),
            "command in mA, called V": milliamperes(COMMAND, -10.0, 10.0),
            "position from the end of the stroke": on(POSITION, lambda values: values + HALF_STROKE),
        },
    )
    add(
        "units",
        {"absolute pressures": on(PRESSURES, lambda bar: bar + 1.013)},
        "pressure_a pressure_b supply.tank_pressure",
    )
    add(
        "wiring",
        {
            "position reversed": on(POSITION, lambda values: -values),
            "spool reversed": on(SPOOL, lambda values: -values),
            "command reversed": on(COMMAND, lambda values: -values),
            "chambers exchanged": named({A: B, B: A}),
            "set point as command": set_point,
            "only the difference of pressures": lambda table: (
                table.assign(**{A: table[A] - table[B]}).drop(columns=B).rename(columns={A: "load_pressure [bar]"})
            ),
        },
    )
    faults: dict[str, dict[str, Callable[[Any], Any]]] = {
        A: {
            "offset of 2 bar": lambda bar: bar + 2.0,
            "gain of 1.05": lambda bar: 1.05 * bar,
            "noise of 3 bar": noise(3.0),
            "spikes": sometimes(0.01, lambda bar: bar + 100.0),
            "clipped": lambda bar: bar.clip(upper=bar.quantile(0.6)),
            "stuck": held,
            "stuck for 3 s": during(0.3, 0.6, held),
            "drops out": sometimes(0.03, lambda bar: 0.0 * bar),
        },
        POSITION: {
            "offset of 5 mm": lambda mm: mm + 5.0,
            "gain of 1.05": lambda mm: 1.05 * mm,
            "spikes": sometimes(0.01, lambda mm: mm + 100.0),
            "stuck": held,
            "stuck for 3 s": during(0.3, 0.6, held),
        },
        SPOOL: {
            "offset of 2 %": lambda values: values + 2.0,
            "gain of 1.05": lambda values: 1.05 * values,
            "dead": lambda values: 0.0 * values,
            "dead for 3 s": during(0.3, 0.6, lambda values: 0.0 * values),
        },
    }
    for column, ways in faults.items():
        signal = column.split(" ")[0]
        for what, fault in ways.items():
            alike = " valve.rated_flow" if signal == "position" and "gain" in what else ""
            add("sensors", {f"{signal}: {what}": on(column, fault)}, signal + alike)
    add(
        "resolution",
        {
            "pressures in steps of 0.1 bar": steps(PRESSURES, 0.1),
            "pressures in steps of 1 bar": steps(PRESSURES, 1.0),
            "position in steps of 0.1 mm": steps(POSITION, 0.1),
            "position in steps of 1 mm": steps(POSITION, 1.0),
            "command in steps of 0.1 V": steps(COMMAND, 0.1),
            "deadband of 1 bar": deadband(PRESSURES, 1.0),
            "deadband of 0.1 mm": deadband(POSITION, 0.1),
        },
    )
    add(
        "channels",
        {
            "pressures 1 row late": moved(PRESSURES, 1),
            "pressures 5 rows late": moved(PRESSURES, 5),
            "position 2 rows late": moved(POSITION, 2),
            "command 1 row early": moved(COMMAND, -1),
            "command 1 row late": moved(COMMAND, 1),
            "command 3 rows early": moved(COMMAND, -3),
            "pressures in each 4th row": every(PRESSURES, 4),
            "pressures in each 4th row, repeated": every(PRESSURES, 4, repeated=True),
            "pressures in each 20th row, repeated": every(PRESSURES, 20, repeated=True),
            "position in each 4th row, repeated": every(POSITION, 4, repeated=True),
        },
    )
    add(
        "columns",
        {
            "German headings": named(dict(zip(COLUMNS, GERMAN, strict=True))),
            "headings without words": named(dict(zip(COLUMNS, NUMBERED, strict=True))),
            "headings without units": named({name: name.split(" ")[0] for name in COLUMNS}),
            "no spool position": lambda table: table.drop(columns=SPOOL),
        },
    )
    return found
