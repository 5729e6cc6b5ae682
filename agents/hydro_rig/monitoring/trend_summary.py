"""What the table of ``hydro trend`` says about each axis: its states, its growth, and the sentence for the planner."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from datetime import UTC, datetime
from enum import StrEnum
from typing import Any

import numpy as np
import pandas as pd

from hydro_agents.detection.detector import HALF_WIDTH
from hydro_agents.running.statistics import Interval
from hydro_agents.running.text import decimals_for, number
from hydro_env.types import Floats
from hydro_rig.diagnosis.verdict import EXIT_CODES, Kind
from hydro_rig.monitoring.growth import NO_GROWTH, UNKNOWN, Growth, growth
from hydro_rig.monitoring.oil import UNKNOWN_TEMPERATURE, Oil, common_error
from hydro_rig.monitoring.trend_table import seconds, stamp

DAY = 86400.0  # s
LATEST, AGREE = 5, 3  # the state of an axis is the verdict on which three of its last five readings agree
MOST_COMMON = 0.1  # decades, of an error of the plant that all readings share
SURE = 0.999  # smallest probability of growth for which a date is told
FARTHEST = 365.0  # days ahead, up to which a date is told
LATE = 3.0
"""An axis without a reading for so many times the median distance between its readings, or a day if that is longer, is
stale."""


class State(StrEnum):
    """What is known about an axis, the most serious first."""

    LEAK = Kind.LEAK.value
    OTHER = Kind.OTHER.value
    UNREAD = "unread"  # its newest file cannot be read
    STALE = "stale"  # it has had no reading for longer than usual
    UNKNOWN = Kind.UNKNOWN.value
    HEALTHY = Kind.HEALTHY.value


CODES = {**{State(kind): code for kind, code in EXIT_CODES.items()}, State.UNREAD: 13, State.STALE: 14}
"""Exit codes; that of the command is the code of the most serious state of an axis."""


@dataclass(frozen=True)
class AxisTrend:
    """An axis over weeks."""

    axis: str
    time: Floats  # (L,), s since 1970, of its readings
    size: Floats  # (L,), l/min at 100 bar and 40 °C; NaN: none
    low: Floats  # (L,), 90 % interval
    high: Floats
    verdicts: tuple[Kind, ...]  # (L,)
    repairs: tuple[float, ...]  # s since 1970, rising
    states: tuple[State, ...]  # all that hold, the most serious first
    reason: str  # of the states; empty for a healthy axis
    growth: Growth  # in days, since the last repair; NaN: unknown, or the last reading contradicts it
    leak: Interval  # l/min at 100 bar and 40 °C: of the trend, or without one of the last reading with a size
    limit: float  # l/min at 100 bar and 40 °C
    last: float  # s since 1970, end of the last reading; NaN: none
    now: float  # s since 1970, from which on the trend looks ahead

    @property
    def state(self) -> State:
        """The most serious one."""
        return self.states[0]

    @property
    def dated(self) -> bool:
        """Whether the axis leaks, the leak grows for sure, and it reaches the limit soon enough for a date."""
        return self.state is State.LEAK and self.growth.grows >= SURE and self.growth.ahead.value <= FARTHEST

    @property
    def urgency(self) -> tuple[int, float]:
        """What sorts axes: those at their limit (0), those with a date (1), those that leak (2), then by state."""
        if self.leak.value >= self.limit:
            return 0, -self.leak.value
        return (1, self.growth.ahead.value) if self.dated else (2 + [*State].index(self.state), 0.0)

    def date(self, days: float) -> str:
        """A date so many days from now; with its year if it is another one."""
        return date_text(self.now + DAY * days).removesuffix(date_text(self.now)[-5:])

    def last_reading(self) -> tuple[str, str]:
        """Date and age of the last reading."""
        if np.isnan(self.last):
            return "none", "–"
        days = (self.now - self.last) / DAY
        return date_text(self.last), f"{days:.0f} d" if days >= 2.0 else f"{24.0 * days:.0f} h"

    def leak_text(self, unit: str = "") -> str:
        """The leak with its interval, such as ``0.31 (0.28 to 0.35)``, or with the unit behind the first number."""
        value, low, high = (number(part, digits=2) for part in self.leak)
        return "–" if np.isnan(self.leak.value) else f"{value}{unit} ({low} to {high})"

    def line(self) -> str:
        """The sentence, the states, and the last reading."""
        why = f" ({self.reason})" if self.reason else ""
        last = "{}, {} ago".format(*self.last_reading()) if len(self.time) else "none"
        return f"{self.sentence()} Now: {', '.join(self.states)}{why}. Last reading: {last}."

    def sentence(self) -> str:
        """What a planner needs."""
        found, limit = self.growth, f"{number(self.limit, max(decimals_for(self.limit, 2), 2))} l/min"
        size = self.leak_text(" l/min")
        if np.isnan(found.level.value):
            if State.STALE in self.states and np.isfinite(self.leak.value):
                return f"{self.axis} leaked {size} in its last reading."
            if self.state is State.LEAK:
                above = f", above {limit}" if self.leak.low > self.limit else ""
                return f"{self.axis} leaks {size} in its last reading{above}."
            after = " since the repair" if self.repairs and self.repairs[-1] > self.time[0] else ""
            return f"{self.axis} has too few readings for a trend{after}."
        if found.ahead.value == 0.0:
            return f"{self.axis} has reached {limit}: it leaks {size}."
        if not self.dated:
            soon = found.not_before
            when = f"before {self.date(soon)}" if soon <= FARTHEST else "within a year"
            return f"{self.axis} does not grow measurably: it leaks {size} and does not reach {limit} {when}."
        low, high = found.ahead.low, found.ahead.high
        late = f"to {self.date(high)}" if high <= 5.0 * FARTHEST else "or later"
        about = f"about {self.date(found.ahead.value)} (90 %: {self.date(low)} {late})"
        return f"{self.axis} leaks {size} and will reach {limit} {about}; not before {self.date(found.not_before)}."

    def json(self) -> dict[str, Any]:
        """The same for another program; ``null``: unknown or never."""
        found = self.growth
        dates = dict(zip(("expected", "low", "high", "not_before"), (*found.ahead, found.not_before), strict=True))
        return {
            "axis": self.axis,
            "state": self.state.value,
            "states": [state.value for state in self.states],
            "exit_code": CODES[self.state],
            "reason": self.reason,
            "sentence": self.sentence(),
            "readings": len(self.time),
            "last": None if np.isnan(self.last) else stamp(self.last),
            "age_days": _finite((self.now - self.last) / DAY),
            "leak_40": {name: _finite(value) for name, value in self.leak._asdict().items()},
            "decades_per_day": {name: _finite(value) for name, value in found.rate._asdict().items()},
            "limit": self.limit,
            "limit_reached": {name: self._day(days) for name, days in dates.items()} if self.dated else None,
            "repaired": [stamp(when) for when in self.repairs],
        }

    def _day(self, days: float) -> str | None:
        """A day so many days from now; ``None``: never."""
        return stamp(self.now + DAY * days)[:10] if days < 1e5 else None


def trends_of(
    table: pd.DataFrame,
    limits: Mapping[str, float],
    oil: Oil,
    between: tuple[float, float] = UNKNOWN_TEMPERATURE,
    unread: Mapping[str, str] | None = None,
    now: float | None = None,
) -> list[AxisTrend]:
    """The trend of each axis of a table, in the order of their names.

    Args:
        table: of :func:`~hydro_rig.monitoring.trend_table.read_table`.
        limits: by axis, l/min at 100 bar and 40 °C.
        oil: in the axes.
        between: lowest and highest possible temperature in °C of axes without a thermometer.
        unread: the error of each axis whose newest file cannot be read.
        now: s since 1970; default: the end of the last reading of each axis.
    """
    errors = unread or {}
    return [
        _trend(axis, table[table["axis"] == axis], limits[axis], oil, between, errors.get(axis), now)
        for axis in sorted({*table["axis"], *errors})
    ]


def _trend(
    axis: str,
    rows: pd.DataFrame,
    limit: float,
    oil: Oil,
    between: tuple[float, float],
    error: str | None,
    now: float | None,
) -> AxisTrend:
    rows = rows.assign(_time=seconds(rows["time"])).sort_values("_time", kind="stable")
    time = rows["_time"].to_numpy(dtype=np.float64)
    last = float(seconds(rows["until"]).max()) if len(rows) else np.nan
    now = last if now is None else now
    late = LATE * max(DAY, float(np.median(np.diff(time))) if len(time) > 1 else DAY)
    stale = abs(now - last) > late  # also by a clock that runs ahead
    marked = time[(rows["repaired"] != "").to_numpy()]
    since = rows[time >= marked.max(initial=-np.inf)]
    sized = since[since["verdict"].isin([Kind.HEALTHY, Kind.LEAK]) & since["size_40"].notna()]
    latest = Interval(*sized[["size_40", "low_40", "high_40"]].iloc[-1]) if len(sized) else UNKNOWN
    size = since["size_40"].to_numpy(dtype=np.float64)
    # A reading's own error, without the thermometer's. The readings share plant and sensors, too: their usual error may
    # be common to all.
    with np.errstate(invalid="ignore", divide="ignore"):
        factor = np.where(since["size"] != 0.0, size / since["size"], 1.0)
    deviation = factor * (since["high"] - since["low"]).to_numpy(dtype=np.float64) / (2.0 * HALF_WIDTH)
    relative = (deviation / size)[np.isfinite(deviation) & (size > 0.0)]
    plant = float(np.median(relative)) / np.log(10.0) if len(relative) else 0.0
    common = float(np.hypot(common_error(oil, since["temperature"].median(), between), min(plant, MOST_COMMON)))
    days = np.append(since["_time"].to_numpy(dtype=np.float64), now) / DAY
    found = growth(days, np.append(size, np.nan), limit, np.append(deviation, np.nan), common)
    found = NO_GROWTH if stale else found
    reasons = _reasons(since, limit, latest, found.ahead.value == 0.0)
    reasons |= {State.UNREAD: error} if error else {}
    reasons |= {State.STALE: f"no reading within {late / DAY:.0f} d"} if stale else {}
    if len(reasons) > 1:
        reasons.pop(State.HEALTHY, None)
    jumped = latest.low > limit > found.level.value or (found.odd and latest.low > found.level.high)
    found = NO_GROWTH if jumped and State.LEAK in reasons else found
    states = tuple(state for state in State if state in reasons)
    return AxisTrend(
        axis=axis,
        time=time,
        **{name: rows[f"{name}_40"].to_numpy(dtype=np.float64) for name in ("size", "low", "high")},
        verdicts=tuple(Kind(verdict) for verdict in rows["verdict"]),
        repairs=tuple(np.unique(marked).tolist()),
        states=states,
        reason="; ".join(reasons[state] for state in states if reasons[state]),
        growth=found,
        leak=latest if np.isnan(found.level.value) else found.level,
        limit=limit,
        last=last,
        now=now,
    )


def _reasons(rows: pd.DataFrame, limit: float, latest: Interval, reached: bool) -> dict[State, str]:
    """The state that the readings tell, with its reason; none without readings.

    It is a leak if the last reading with a size lies wholly above the limit, otherwise the verdict on which three of
    the last five readings agree, or both of two; undecided without one, and if it is healthy at a trend at the limit.
    """
    if rows.empty:
        return {}
    verdict, count = Counter(rows["verdict"].tail(LATEST)).most_common(1)[0]
    state = State(verdict) if count >= min(len(rows), AGREE) else State.UNKNOWN
    if latest.low > limit:
        state = State.LEAK
    elif state is State.HEALTHY:
        return {State.UNKNOWN if reached else state: ""}
    return {state: next(iter(rows["reason"][rows["verdict"] == state][::-1]), "")}


def exit_code(states: Iterable[State]) -> int:
    """That of the most serious state."""
    return CODES[min(states, key=[*State].index, default=State.HEALTHY)]


def date_text(time: float) -> str:
    """``14 Feb 2027``."""
    day = datetime.fromtimestamp(time, UTC)
    return f"{day.day} {day:%b %Y}"


def _finite(value: float) -> float | None:
    return float(f"{value:.6g}") if np.isfinite(value) else None
