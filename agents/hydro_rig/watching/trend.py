"""What the table of ``hydro trend`` says about an axis: its states, its growth, and the line for the planner."""

from collections import Counter
from enum import StrEnum
from typing import Any, NamedTuple

import numpy as np
import pandas as pd

from hydro_agents.detection.detector import HALF_WIDTH
from hydro_agents.running.statistics import UNKNOWN, Interval
from hydro_agents.running.text import number
from hydro_rig.diagnosis.oil import Oil, common_error
from hydro_rig.diagnosis.verdict import EXIT_CODES, Kind
from hydro_rig.watching.fleet import Axis
from hydro_rig.watching.growth import NO_GROWTH, Growth, growth
from hydro_rig.watching.table import SIZES, seconds, stamp

DAY = 86400.0  # s
LATEST, AGREE = 5, 3  # the state of an axis is the verdict on which three of its last five readings agree
PLANT_ERROR = 0.1  # decades, the most of a usual error of the readings that may be common to all
SURE = 0.999  # smallest probability of growth for which a date is told
FARTHEST = 365.0  # days ahead, up to which a date is told
LATE = 3.0  # median distances between its readings (or days, if longer) without one, after which an axis is stale


class State(StrEnum):
    """What is known about an axis, the most serious first."""

    LEAK = Kind.LEAK.value
    OTHER = Kind.OTHER.value
    UNREAD = "unread"  # its newest file cannot be read
    STALE = "stale"  # it has had no reading for longer than usual
    UNKNOWN = Kind.UNKNOWN.value
    HEALTHY = Kind.HEALTHY.value


SERIOUS = list(State).index  # sorts states
CODES = {State(kind): code for kind, code in EXIT_CODES.items()} | {State.UNREAD: 13, State.STALE: 14}
"""Exit codes; that of the command is the code of the most serious state of an axis."""


class Condition(StrEnum):
    """What the person who maintains an axis does about it, NAMUR NE 107; the most urgent first."""

    FAILURE = "failure"  # a sensor that the diagnosis needs is faulty
    OUT = "out of specification"  # the leak exceeds its limit
    MAINTENANCE = "maintenance required"  # the axis leaks, or something else is worn
    CHECK = "function check"  # its rows or files tell nothing: wiring, units, clock, rig
    NO_DATA = "no data"
    GOOD = "good"


CONDITIONS = {
    State.LEAK: Condition.MAINTENANCE,
    State.OTHER: Condition.MAINTENANCE,
    State.UNREAD: Condition.CHECK,
    State.STALE: Condition.NO_DATA,
    State.UNKNOWN: Condition.CHECK,
    State.HEALTHY: Condition.GOOD,
}


class AxisTrend(NamedTuple):
    """An axis over weeks."""

    axis: str
    rows: pd.DataFrame  # of the table, in the order of time
    states: list[State]  # all that hold, the most serious first
    reason: str  # of the states; empty: none
    growth: Growth  # in days, since the last repair; NaN: unknown, or the last reading contradicts it
    leak: Interval  # l/min at 100 bar and 40 °C: of the trend, or without one of the last reading with a size
    limit: float  # l/min at 100 bar and 40 °C
    last: float  # s since 1970, end of the last reading; NaN: none
    now: float  # s since 1970

    @property
    def condition(self) -> Condition:
        """By the most serious state, and by the limit."""
        return Condition.OUT if self.leak.value >= self.limit else CONDITIONS[self.states[0]]

    @property
    def dated(self) -> bool:
        """Whether the axis leaks, the leak grows for sure, and it reaches the limit soon enough for a date."""
        return self.states[0] is State.LEAK and self.growth.grows >= SURE and self.growth.ahead.value <= FARTHEST

    @property
    def urgency(self) -> tuple[float, float]:
        """What sorts axes: those at their limit, those with a date, then by state."""
        if self.leak.value >= self.limit:
            return 0.0, -self.leak.value
        if self.dated:
            return 1.0, self.growth.ahead.value
        return 2.0 + SERIOUS(self.states[0]), 0.0

    def facts(self) -> dict[str, Any]:
        """What another program needs; leaks in l/min at 100 bar and 40 °C, ``None``: unknown or never."""
        dates = None
        if self.dated:
            days = {**self.growth.ahead._asdict(), "not_before": self.growth.not_before}
            dates = {name: stamp(self.now + DAY * ahead)[:10] if ahead < 1e5 else None for name, ahead in days.items()}
        return {
            "axis": self.axis,
            "condition": self.condition.value,
            "state": self.states[0].value,
            "states": [state.value for state in self.states],
            "exit_code": CODES[self.states[0]],
            "reason": self.reason,
            "leak_40": {name: finite(value) for name, value in self.leak._asdict().items()},
            "limit": self.limit,
            "limit_reached": dates,
            "decades_per_day": {name: finite(value) for name, value in self.growth.rate._asdict().items()},
            "readings": len(self.rows),
            "last": None if np.isnan(self.last) else stamp(self.last),
            "age_days": finite((self.now - self.last) / DAY),
        }

    def line(self) -> str:
        """What a planner needs."""
        facts = self.facts()
        text = f"{self.axis}: {', '.join(self.states)}{f' ({self.reason})' if self.reason else ''}"
        if np.isfinite(self.leak.value):
            value, low, high = (number(part, digits=2) for part in self.leak)
            text += f"; leak {value} l/min ({low} to {high}), limit {number(self.limit, digits=2)}"
        dates = facts["limit_reached"]
        if dates and self.growth.ahead.value == 0.0:
            text += ", which it has reached"
        elif dates:
            text += f", reached about {dates['value']} ({dates['low']} to {dates['high'] or 'later'}), "
            text += f"not before {dates['not_before']}"
        age = f"{facts['last'][:10]}, {facts['age_days']:.1f} d ago" if facts["last"] else "none"
        return f"{text}; last reading {age}"


def trend_of(name: str, rows: pd.DataFrame, axis: Axis, error: str, now: float | None = None) -> AxisTrend:
    """The trend of one axis, from its rows of the table and the ``error`` of its newest file (empty: that was read).

    ``now``: s since 1970; default: the end of the last reading.
    """
    # Without copies of a file under another name.
    rows = rows[~rows.duplicated(["time", "until", "verdict", "size_40"], keep="last")]
    rows = rows.assign(begin=seconds(rows["time"]), end=seconds(rows["until"])).sort_values("begin", kind="stable")
    last = rows["end"].max()
    now = last if now is None else now
    late = LATE * np.fmax(DAY, rows["begin"].diff().median())
    stale = abs(now - last) > late  # also by a clock that runs ahead
    repaired = rows["begin"][rows["repaired"] != ""].max()
    since = rows if np.isnan(repaired) else rows[rows["begin"] >= repaired]
    found = NO_GROWTH if stale else _growth(since, axis.limit, axis.oil, now / DAY)
    sized = since[since["verdict"].isin([Kind.HEALTHY, Kind.LEAK]) & since["size_40"].notna()]
    latest = Interval(*sized[SIZES].iloc[-1]) if len(sized) else UNKNOWN
    reasons = _reasons(since, axis.limit, latest, found)
    if error:
        reasons[State.UNREAD] = error
    if stale:
        reasons[State.STALE] = f"no reading within {late / DAY:.0f} d"
    if not reasons:
        reasons[State.STALE] = "no reading"
    if len(reasons) > 1:
        reasons.pop(State.HEALTHY, None)
    if State.LEAK in reasons and latest.low > found.level.high:
        found = NO_GROWTH  # the last reading is far above the trend
    states = sorted(reasons, key=SERIOUS)
    reason = "; ".join(reasons[state] for state in states if reasons[state])
    leak = Interval(*np.maximum(latest if np.isnan(found.level.value) else found.level, 0.0))
    return AxisTrend(name, rows, states, reason, found, leak, axis.limit, last, now)


def _growth(rows: pd.DataFrame, limit: float, oil: Oil, now: float) -> Growth:
    """The growth in days. A part of the readings' usual error is common to all: they share thermometer and plant."""
    size = rows["size_40"].to_numpy(float)
    deviation = (rows["high_40"] - rows["low_40"]).to_numpy(float) / (2.0 * HALF_WIDTH)
    shared = common_error(oil, rows["temperature"].median())
    own = np.sqrt(np.maximum(deviation**2 - (np.log(10.0) * shared * size) ** 2, 0.0))
    relative = own[size > 0.0] / size[size > 0.0] / np.log(10.0)
    plant = min(np.median(relative), PLANT_ERROR) if len(relative) else 0.0
    return growth(rows["begin"] / DAY, size, limit, own, np.hypot(shared, plant), now)


def _reasons(rows: pd.DataFrame, limit: float, latest: Interval, found: Growth) -> dict[State, str]:
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
    if state is State.HEALTHY and found.ahead.value == 0.0:
        return {State.UNKNOWN: ""}
    return {state: "".join(rows["reason"][rows["verdict"] == state][-1:])}


def finite(value: float, digits: int = 6) -> float | None:
    """A number with so many digits; ``None`` if it is none, as JSON has no other."""
    return float(f"{value:.{digits}g}") if np.isfinite(value) else None
