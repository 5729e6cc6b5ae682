"""``hydro watch``: rows of running axes → one line per axis and look, in the words of NAMUR NE 107.

A look takes the newest seconds of an axis, checks the wiring as ``hydro diagnose`` does, reads the newest window with
the leakage head, with the estimator at rest or in doubt, and adds the reading to the shipped alarm.
"""

import hashlib
import json
import sys
from collections import deque
from collections.abc import Iterable, Iterator
from pathlib import Path
from time import monotonic
from typing import Any, NamedTuple

import numpy as np
import pandas as pd

from hydro_agents.detection.activity import activity_of
from hydro_agents.detection.alarm import AlarmSettings, AlarmState, LeakAlarm
from hydro_agents.detection.detector import AUXILIARY, Cause, Reading, Windows
from hydro_agents.detection.monitor import HeadDetector
from hydro_agents.detection.sheet import leak_scale
from hydro_agents.running.text import number
from hydro_env import ConfigurationError
from hydro_env.errors import reason
from hydro_env.files import read_json, write_text
from hydro_env.folders import config_folder
from hydro_env.types import ByName
from hydro_rig.diagnosis.oil import referred, temperature_of
from hydro_rig.diagnosis.verdict import NO_LEAK, Kind, Leak, combined
from hydro_rig.estimation.estimator import EstimatorDetector
from hydro_rig.estimation.two_stage import TwoStageDetector
from hydro_rig.recordings.channels import stands_still
from hydro_rig.recordings.columns import MEASURED
from hydro_rig.recordings.findings import Finding, Weight, lines_of, severe_of
from hydro_rig.recordings.quality import check_recording
from hydro_rig.recordings.recording import Recording
from hydro_rig.recordings.sampling import Sampled, bridged, cut, on_grid, sampled
from hydro_rig.watching.fleet import Axis, Fleet
from hydro_rig.watching.rows import TAG, Row, RowError, RowReader, in_protocol
from hydro_rig.watching.table import SIZES, File, read_table, with_row, write_table
from hydro_rig.watching.trend import Condition, finite

KEPT = 10.0  # s of rows per axis, on which the wiring is checked
WINDOW = 2.0  # s
SILENT = 3.0  # looks without a row, after which an axis has no data
AGREE, LATEST = 3, 5  # a cause counts if so many of the last looks name it
CHECK_EVERY = 3  # looks
MARGIN = 2.0  # windows that are sampled between two checks, of which the newest is read
UNSURE = 75.0  # s after the last answer below the limit, from which an axis is no longer good
SET_BACK = 1.0  # s, from which an earlier stamp is a clock that was set back
DAY = 86400.0  # s; stamps that differ by more are of different clocks
MOST_AXES = 1000
READING_EVERY = 3600.0  # s between two rows of the table per axis


class Look(NamedTuple):
    """What a look at an axis tells."""

    axis: str
    time: float  # s
    condition: Condition
    since: float  # s
    cause: str  # in words; empty: none
    leak: Leak  # l/min at 100 bar and 40 °C; NaN: this look has no answer
    temperature: float  # of the oil, °C; NaN: unknown

    def fields(self) -> ByName:
        """For another program; ``None``: unknown."""
        sizes = {name: finite(size, 4) for name, size in self.leak.positive._asdict().items()}
        return {"state": self.condition.value, "since": self.since, "cause": self.cause, **sizes}

    def line(self, protocol: bool) -> str:
        """One line, in line protocol or JSON."""
        if protocol:
            return in_protocol("hydro_watch", self.axis, self.fields(), self.time)
        return json.dumps({"axis": self.axis, "time": self.time, **self.fields()}, ensure_ascii=False)


class AxisWatch:
    """One axis: its newest rows, its detector and its alarm."""

    def __init__(self, name: str, axis: Axis) -> None:
        self.name, self.axis, self.task = name, axis, axis.task
        self._task_digest = hashlib.sha256(axis.task.model_dump_json().encode()).hexdigest()
        settings = AlarmSettings.load(config_folder() / "agents" / "alarm.yaml")
        self._alarm, self.interval = LeakAlarm(settings), settings.interval
        self.memory = self._alarm.begin(1)
        self.condition, self.since = Condition.NO_DATA, np.nan
        self._detector = TwoStageDetector(HeadDetector.load(), EstimatorDetector(threads=1))
        self._scale = leak_scale(self.task)
        self._most = max(round(KEPT / self.task.control_period), 100)
        self._rows: deque[tuple[float, Any]] = deque(maxlen=self._most)
        self._due = np.nan
        self._causes: deque[str] = deque(maxlen=LATEST)
        self._looks, self._since_look, self._found = 0, 0, list[Finding]()
        self._still = set[str]()  # signals that stand still while the others move
        self.repaired = ""  # time of the newest row of the table that is marked as that of a new seal
        self._sure = -np.inf  # s, of the last answer whose whole interval lies below the limit

    @property
    def newest(self) -> float:
        """Time of the newest row, s."""
        return self._rows[-1][0] if self._rows else np.nan

    def add(self, row: Row) -> Look | None:
        """Add a row; the look that is then due."""
        now = row.time
        if self._rows and now < self.newest - SET_BACK:
            self._rows.clear()
            self._due, self._looks, self._sure = np.nan, 0, -np.inf
            return self._told(now, Condition.CHECK, "the clock was set back")
        self._rows.append((now, row.values))
        self._since_look += 1
        if np.isnan(self._due):
            self._due = now + max(WINDOW, self.interval)
        if now < self._due and self._since_look < self._most:  # a clock in the wrong unit hardly moves
            return None
        self._due, self._since_look = now + self.interval, 0
        return self.look()

    def silent(self, now: float) -> Look | None:
        """A look at an axis that has sent no row for some looks; ``None`` if it has, or if that was said."""
        late = SILENT * self.interval <= now - self.newest < DAY
        if self.condition is Condition.NO_DATA or not late:
            return None
        return self._told(now, Condition.NO_DATA, "no row")

    def look(self) -> Look:
        """Check the rows, read the newest window, and sum up; the wiring is checked at every third look."""
        rows, now = self._recording(), self.newest
        complete = self._looks % CHECK_EVERY == 0
        self._looks += 1
        try:
            if complete:
                checked = check_recording(rows, self.task)
                self._found = [one for one in checked.findings if one.weight in (Weight.SEVERE, Weight.FAULT)]
                samples = checked.samples
                self._still = {name for name in MEASURED if stands_still(name, samples, self.task)}
            else:
                first = np.searchsorted(rows.time, rows.time[-1] - MARGIN * WINDOW)
                samples = sampled(rows.part(first, len(rows.time)), self.task)
        except ConfigurationError as error:
            return self._told(now, Condition.CHECK, str(error))
        if severe := severe_of((*self._found, *samples.findings)):
            condition = Condition.FAILURE if severe[0].signal in self._still else Condition.CHECK
            return self._told(now, condition, severe[0].line())
        windows = self._newest_window(bridged(samples)[0], now)
        if not len(windows):
            return self._told(now, Condition.CHECK, "fewer rows than one window")
        reading = self._detector.read(windows, on_grid(self.task, samples.period))
        blind = not rows.has_pressure  # a faulty seal can then look healthy
        temperature = temperature_of(rows)
        leak = referred(combined(reading)[0], self.axis.oil, temperature)
        if leak.high <= self.axis.limit and not blind:
            self._sure = now
        condition, cause = self._summed_up(reading, leak, activity_of(windows.signals, samples.period))
        if condition is Condition.GOOD and now - self._sure > UNSURE:
            why = "the interval of the leak does not lie below its limit"
            if leak.low > self.axis.limit:
                why = "the leak seems to exceed its limit, and the alarm gathers more looks"
            elif blind:
                why = "without pressures a faulty seal can look healthy"
            condition, cause = Condition.CHECK, f"cannot tell: {reading.remarks[0] or why}"
        if self._found:
            condition, cause = Condition.FAILURE, self._found[0].line()
        cause = "; ".join(filter(None, [cause, *lines_of(rows.findings)]))  # of the thermometer
        return self._told(now, condition, cause, leak, temperature)

    def _recording(self) -> Recording:
        stamps = np.array([time for time, _ in self._rows])
        signals, others = np.split(np.array([row for _, row in self._rows]).T, [len(MEASURED)])
        auxiliary = {name: row for name, row in zip(AUXILIARY, others, strict=True) if np.isfinite(row).any()}
        return Recording(self.name, stamps - stamps[0], signals, {}, [], auxiliary, stamps[0]).with_plausible_oil()

    @staticmethod
    def _newest_window(samples: Sampled, now: float) -> Windows:
        """The window that ends with the newest sample; none of fewer samples."""
        length = round(WINDOW / samples.period)
        place = samples.place - samples.place[-1] - 1
        found = cut(samples._replace(place=place - place[0] // length * length), length)
        newest = found.part(np.arange(len(found))[-1:])
        ends = np.full(len(newest), now)
        return Windows(newest.signals, ends - WINDOW, ends, newest.auxiliary)

    def _summed_up(self, reading: Reading, leak: Leak, activity: Any) -> tuple[Condition, str]:
        """The condition by the alarm and by the causes of the last looks."""
        size = reading._replace(score=reading.score / self._scale, sigma=reading.sigma / self._scale)
        self.memory = self._alarm.update(size, activity, self.memory)
        named = Cause(reading.cause[0])
        if reading.answers[0]:
            self._causes.append("" if named is Cause.NONE else str(reading.fault[0]) or named.in_full)
        if self.memory.alarm[0]:
            too_much = leak.low > self.axis.limit
            return Condition.OUT if too_much else Condition.MAINTENANCE, Cause.INTERNAL_LEAK.in_full
        for cause in set(self._causes) - {""}:
            if self._causes.count(cause) >= AGREE:
                return Condition.MAINTENANCE, cause
        return Condition.GOOD, ""

    def _told(
        self, now: float, condition: Condition, cause: str, leak: Leak = NO_LEAK, temperature: float = np.nan
    ) -> Look:
        if condition is not self.condition:
            self.condition, self.since = condition, now
        return Look(self.name, now, condition, self.since, cause, leak, temperature)

    def repair(self, table: pd.DataFrame) -> None:
        """Forget the alarm if the table has a new mark of a repair."""
        marked = table["time"][(table["axis"] == self.name) & (table["repaired"] != "")].max()
        if isinstance(marked, str) and marked > self.repaired:
            self.memory, self.repaired = self._alarm.begin(1), marked
            self._causes.clear()

    def kept(self) -> ByName:
        """What a restart needs (JSON)."""
        memory = {name: values.tolist() for name, values in self.memory._asdict().items()}
        own = {"condition": self.condition.value, "since": self.since, "repaired": self.repaired}
        return {**own, "alarm": memory, "task": self._task_digest}

    def restore(self, kept: ByName) -> None:
        """Take over what :meth:`kept` gave for the same task, and say so."""
        if kept.get("task", self._task_digest) != self._task_digest:
            what = "the memory is that of another rig or task; a second axis needs another --append, or a name (--tag)"
            print(f"hydro: axis '{self.name}' starts anew: {what}", file=sys.stderr)
            return
        try:
            self.condition, self.since = Condition(kept["condition"]), float(kept["since"])
            self.repaired = str(kept["repaired"])
            self.memory = AlarmState(**{name: np.array(values) for name, values in kept["alarm"].items()})
        except (KeyError, TypeError, ValueError) as error:
            raise ConfigurationError(f"the memory of hydro watch: axis '{self.name}': {reason(error)}") from None
        said = f"'{self.condition}' since {self.since:g} s"
        print(f"hydro: axis '{self.name}' goes on from the memory of an earlier call: {said}", file=sys.stderr)


class FleetWatch:
    """All axes, the table of their readings as that of ``hydro trend``, and beside it the file that a restart reads."""

    def __init__(self, fleet: Fleet, table_file: Path) -> None:
        self._fleet = fleet
        self._file, self._memory_file = table_file, table_file.with_suffix(".json")
        self.table = read_table(table_file)
        self.axes: dict[str, AxisWatch] = {}
        self._best: dict[str, Look] = {}  # the narrowest answer since the last row of the table
        self._kept = {}
        if self._memory_file.exists():
            self._kept = read_json(self._memory_file)

    def add(self, row: Row) -> Iterator[Look]:
        """Add a row; the looks that are then due, after what they tell was written."""
        name = row.axis
        axis = self.axes.get(name)
        if not axis:
            if len(self.axes) >= MOST_AXES:
                raise ConfigurationError(f"more than {MOST_AXES} axes; --tag names the column or tag of the axis")
            axis = AxisWatch(name, self._fleet.axis(name))
            if name in self._kept:
                axis.restore(self._kept[name])
            axis.repair(self.table)
            self.axes[name] = axis
        before = axis.condition
        look = axis.add(row)
        if look:
            self._keep(look, look.condition is not before)
            yield look
            yield from self.silent(row.time)

    def silent(self, now: float | None = None, waited: float = 0.0) -> Iterator[Look]:
        """The looks at axes that have fallen silent; ``now``, s: default: ``waited`` after the newest row of each."""
        for axis in self.axes.values():
            look = axis.silent(axis.newest + waited if now is None else now)
            if look:
                self._keep(look, changed=True)
                yield look

    def looks(self, lines: Iterable[str | None], tag: str = TAG) -> Iterator[Look]:
        """The looks of all lines; a line that is no row costs a line on the error stream, once per kind.

        ``tag``: name of the column, or of the tag, that names the axis.
        """
        reader, told = RowReader(self._fleet, tag), set[str]()
        last, rows, looked = monotonic(), 0, False
        for line in lines:
            if line is None:  # nothing came for a while
                yield from self.silent(waited=monotonic() - last)
                continue
            last = monotonic()
            try:
                row = reader.row(line)
            except RowError as error:
                kind = str(error).partition(": ")[2][:40] or str(error)
                if kind not in told and len(told) < MOST_AXES:
                    print(f"hydro: left out: {error}", file=sys.stderr)
                    told.add(kind)
                continue
            if row and np.isfinite(row.time):
                rows += 1
                for look in self.add(row):
                    looked = True
                    yield look
        if not looked:
            print(f"hydro: no look: {rows} rows came, and a look needs some seconds of rows", file=sys.stderr)

    def _keep(self, look: Look, changed: bool) -> None:
        """Write the memory of the alarms, and a row of the table if one is due."""
        name = look.axis
        self._kept[name] = self.axes[name].kept()
        write_text(self._memory_file, json.dumps(self._kept, indent=1))
        best = self._best.get(name)
        wide = best.leak.high - best.leak.low if best else np.inf
        if look.leak.high - look.leak.low < wide:  # not of a look without an answer: NaN
            self._best[name] = best = look
        rows = self.table["until"][self.table["axis"] == name]
        last = 0.0 if rows.empty else np.datetime64(rows.max(), "s").astype(np.int64)
        if best and (changed or look.time - last >= READING_EVERY):
            self._write(look, best)
            del self._best[name]

    def _write(self, look: Look, best: Look) -> None:
        verdict = {Condition.GOOD: Kind.HEALTHY, Condition.CHECK: Kind.UNKNOWN}.get(look.condition, Kind.OTHER)
        if self.axes[look.axis].memory.alarm[0]:
            verdict = Kind.LEAK
        row: ByName = dict(zip(SIZES, best.leak, strict=True))
        row |= {"time": best.time, "until": look.time, "verdict": verdict.value, "reason": look.cause}
        name = f"{look.axis}/watched {number(best.time, 12)}"
        table = read_table(self._file)  # a person may have marked a repair
        self.axes[look.axis].repair(table)
        self.table = with_row(table, File(self._file, look.axis, name, 0), row | {"temperature": best.temperature})
        write_table(self._file, self.table)
