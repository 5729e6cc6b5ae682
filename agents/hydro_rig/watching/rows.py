"""Rows of running axes as text: CSV below a heading line, or the line protocol of InfluxDB; and the way back.

Their lines come from the standard input or an MQTT broker, by a bounded queue: a slow reader never grows memory.

Line protocol: https://docs.influxdata.com/influxdb/v2/reference/syntax/line-protocol/
"""

import json
import re
import sys
from collections.abc import Callable, Iterator, Sequence
from datetime import datetime
from queue import Empty, Queue
from threading import Thread
from typing import NamedTuple

import numpy as np

from hydro_agents.detection.detector import AUXILIARY
from hydro_env import ConfigurationError
from hydro_env.errors import reason
from hydro_env.types import ByName, Floats
from hydro_rig.recordings.columns import LOAD_PRESSURE, MEASURED, ColumnMap, own_map, place_of, unit_of
from hydro_rig.watching.fleet import Fleet

SIGNALS = (*MEASURED, *AUXILIARY)  # of a row, in this order
NANOSECOND = 1e-9  # s
TAG = "axis"  # column or tag with the name of the axis
ALONE = "axis"  # name of an axis whose rows name none
_PARTS = re.compile(r"(?<!\\) (?=(?:[^\"]*\"[^\"]*\")*[^\"]*$)")  # spaces outside of texts
_FIELDS = re.compile(r"(?<!\\),(?=(?:[^\"]*\"[^\"]*\")*[^\"]*$)")
_EQUALS = re.compile(r"(?<!\\)=")
_ESCAPED = re.compile(r"\\([ ,=\\\"])")
MOST_LINES = 10_000  # that wait; the source then waits, too
PATIENCE = 1.0  # s
Put = Callable[[str], None]  # takes a line


class Row(NamedTuple):
    """The readings of an axis at one time."""

    axis: str
    time: float  # s; of dates, and in line protocol, since 1970
    values: Floats  # (signals,), SI, in the order of SIGNALS; NaN: not measured, or lost


class RowError(ConfigurationError):
    """A line that is no row."""


class _Columns:
    """Where the cells of a line hold the signals, and their units."""

    def __init__(self, headings: Sequence[str], columns: ColumnMap | None, source: str) -> None:
        found = columns or own_map(headings, source)
        chosen = found.columns()
        if LOAD_PRESSURE in chosen or found.time.equidistant or found.command.rows_early:
            raise ConfigurationError(
                f"{source}: the map names load_pressure, equidistant or rows_early; hydro watch reads two pressures, "
                "and rows with their own stamps"
            )
        self.signals = []
        for name, column in chosen.items():
            place = place_of(column, name, headings, source)
            size = unit_of(column, name, headings[place], source)[1]
            if name == "time":
                self.time, self.time_unit = place, size
            else:
                self.signals.append((SIGNALS.index(name), place, size * column.gain, size * column.offset))

    def values(self, cells: Sequence[str]) -> Floats:
        values = np.full(len(SIGNALS), np.nan)
        for row, place, gain, offset in self.signals:
            if place < len(cells):
                values[row] = gain * _number(cells[place]) + offset
        return values


class RowReader:
    """Reads lines; the first line decides whether they are CSV or line protocol.

    The fleet gives the signal of each column or field of an axis; the column or tag ``tag`` names the axis.
    """

    def __init__(self, fleet: Fleet, tag: str = TAG) -> None:
        self._fleet, self._tag = fleet, tag
        self._headings: list[str] = []  # of a CSV
        self._separator = ","
        self._columns: dict[tuple[str, ...], _Columns] = {}  # by axis and headings
        self._gathered: dict[str, tuple[float, dict[str, str]]] = {}  # line protocol: time and fields, by axis
        self._lines = 0

    def row(self, line: str) -> Row | None:
        """The row of a line; ``None`` of a comment, an empty line or the heading line.

        Raises:
            RowError: the line is no row, or one of an axis that the fleet's file does not name.
            ConfigurationError: a column or its unit is missing.
        """
        self._lines += 1
        text = line.strip("\ufeff\r\n ")
        if not text or text.startswith("#"):
            return None
        if not self._headings:
            parts = _PARTS.split(text)
            if self._gathered or "=" in parts[-1 if len(parts) < 3 else 1]:
                return self._of_protocol(parts)
            self._separator = max(";\t,", key=text.count)
        cells = [cell.strip().strip('"') for cell in text.split(self._separator)]
        if self._headings and set(cells) != set(self._headings):
            return self._of_cells(cells)
        self._headings = cells  # also where another file begins
        if self._tag not in cells:
            self._columns_of(ALONE, cells)  # names what is missing at once
        return None

    def _columns_of(self, axis: str, headings: Sequence[str]) -> _Columns:
        key = (axis, *headings)
        if key not in self._columns:
            if why := self._fleet.missing(axis):
                raise RowError(why)
            self._columns[key] = _Columns(headings, self._fleet.axis(axis).columns, "rows")
        return self._columns[key]

    def _of_cells(self, cells: list[str]) -> Row:
        axis = ALONE
        if self._tag in self._headings:
            axis = cells[min(self._headings.index(self._tag), len(cells) - 1)]
        if self._separator != ",":
            cells = [cell.replace(",", ".") for cell in cells]  # decimal commas
        columns = self._columns_of(axis, self._headings)
        if columns.time >= len(cells):
            raise RowError(f"line {self._lines}: has {len(cells)} cells, the heading line has {len(self._headings)}")
        return Row(axis, self._time(cells[columns.time], columns.time_unit), columns.values(cells))

    def _of_protocol(self, parts: Sequence[str]) -> Row | None:
        """The row before this line's: fields of one axis and time may come in several lines."""
        if len(parts) < 3:
            raise RowError(f"line {self._lines}: must have a measurement with tags, fields and a time stamp")
        names = dict(_pair(text) for text in _FIELDS.split(parts[0])[1:])
        fields = dict(_pair(text) for text in _FIELDS.split(parts[1]))
        axis, time = names.get(self._tag, ALONE), _number(parts[2]) * NANOSECOND
        before, gathered = self._gathered.get(axis, (np.nan, {}))
        if time == before:
            gathered |= fields
            return None
        self._gathered[axis] = time, fields
        if not gathered:
            return None
        cells = ["", *(text.removesuffix("i").strip('"') for text in gathered.values())]
        try:
            return Row(axis, before, self._columns_of(axis, ["time", *gathered]).values(cells))
        except ConfigurationError as error:
            raise RowError(f"line {self._lines}: {error}") from None

    def _time(self, cell: str, unit: float) -> float:
        time = unit * _number(cell)
        if np.isfinite(time):
            return time
        try:
            return datetime.fromisoformat(cell.replace(",", ".")).timestamp()
        except ValueError:
            allowed = "a number or 2026-03-01T08:00:00.005"
            raise RowError(f"line {self._lines}: time {cell[:30]!r}: must be {allowed}") from None


def _pair(text: str) -> tuple[str, str]:
    name, _, value = _EQUALS.sub("\n", text, count=1).partition("\n")
    return _ESCAPED.sub(r"\1", name), _ESCAPED.sub(r"\1", value)


def _number(text: str) -> float:
    try:
        return float(text)
    except ValueError:
        return float("nan")


def in_protocol(measurement: str, axis: str, fields: ByName, time: float) -> str:
    """A line of line protocol; unknown numbers are left out."""
    tag = re.sub(r"([ ,=])", r"\\\1", axis)
    parts = []
    for name, value in fields.items():
        if isinstance(value, str):
            parts.append(f"{name}={json.dumps(value, ensure_ascii=False)}")
        elif value is not None:
            parts.append(f"{name}={value:.6g}")
    return f"{measurement},{TAG}={tag} {','.join(parts)} {round(time / NANOSECOND)}"


def lines_of(fill: Callable[[Put], None]) -> Iterator[str | None]:
    """The lines that ``fill`` puts from a thread of its own; ``None`` after each second without a line."""
    queue: Queue[str | Exception | None] = Queue(MOST_LINES)

    def run() -> None:
        try:
            fill(queue.put)
            queue.put(None)
        except Exception as error:  # of any library; the reader must not wait for ever
            queue.put(error)

    Thread(target=run, daemon=True).start()
    while True:
        try:
            line = queue.get(timeout=PATIENCE)
        except Empty:
            yield None
            continue
        if line is None:  # the end of the input
            return
        if isinstance(line, Exception):
            raise ConfigurationError(f"rows: cannot be read: {reason(line)}")
        yield line


def standard_input(put: Put) -> None:
    """All lines of the standard input."""
    for line in sys.stdin:
        put(line)


def broker(address: str) -> Callable[[Put], None]:
    """The lines of all messages of a topic, HOST[:PORT]/TOPIC; the client connects again by itself.

    Raises:
        ConfigurationError: paho-mqtt is missing, the address is none, or nobody listens there.
    """
    place, _, topic = address.partition("/")
    host, _, port = place.partition(":")
    if not host or not topic or not (port or "1883").isdigit():
        raise ConfigurationError(f"--mqtt {address}: must be HOST[:PORT]/TOPIC, such as localhost/press/#")
    try:
        from paho.mqtt.client import Client
        from paho.mqtt.enums import CallbackAPIVersion
    except ImportError:
        raise ConfigurationError("--mqtt: needs paho-mqtt: pip install 'hydro_env[mqtt]'") from None
    # A name of its own, under which the broker keeps rows while this client is away.
    client = Client(CallbackAPIVersion.VERSION2, client_id=f"hydro_watch {topic}", clean_session=False)
    client.reconnect_delay_set(max_delay=30)

    def on_connect(*_: object) -> None:
        client.subscribe(topic, qos=1)

    client.on_connect = on_connect

    def fill(put: Put) -> None:
        def on_message(_client: object, _data: object, message: object) -> None:
            for line in message.payload.decode(errors="replace").splitlines():  # type: ignore[attr-defined]
                put(line)

        client.on_message = on_message
        client.loop_forever(retry_first_connection=True)

    try:
        client.connect(host, int(port or 1883))
    except OSError as error:
        raise ConfigurationError(f"--mqtt {address}: {error}") from None
    return fill
