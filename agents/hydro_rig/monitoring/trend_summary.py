"""What the table of ``hydro trend`` says about each axis: its state, its growth, and the sentence for the planner."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import Any

import numpy as np
import pandas as pd

from hydro_agents.detection.detector import HALF_WIDTH
from hydro_agents.running.text import decimals_for, number
from hydro_env.types import Floats
from hydro_rig.diagnosis.verdict import EXIT_CODES, Kind
from hydro_rig.monitoring.growth import Growth, growth
from hydro_rig.monitoring.oil import UNKNOWN_TEMPERATURE, Oil, common_error
from hydro_rig.monitoring.trend_table import seconds, stamp

DAY = 86400.0  # s
LATEST, AGREE = 5, 3  # the state of an axis is the verdict on which three of its last five readings agree
MOST_COMMON = 0.1  # decades, of an error of the plant that all readings share
SURE = 0.999  # smallest probability of growth for which a date is told
FARTHEST = 365.0  # days ahead, up to which a date is told


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
    state: Kind
    reason: str  # of the state; empty for a healthy axis
    growth: Growth  # in days, since the last repair
    limit: float  # l/min at 100 bar and 40 °C

    @property
    def dated(self) -> bool:
        """Whether the axis leaks, the leak grows for sure, and it reaches the limit soon enough for a date."""
        return self.state is Kind.LEAK and self.growth.grows >= SURE and self.growth.ahead.value <= FARTHEST

    def date(self, days: float) -> str:
        """A date so many days after the last reading; with its year if it is another one."""
        then = date_text(float(self.time[-1]) + DAY * days)
        return then.removesuffix(date_text(float(self.time[-1]))[-5:])

    def sentence(self) -> str:
        """What a planner needs."""
        found, limit = self.growth, f"{number(self.limit, max(decimals_for(self.limit, 2), 2))} l/min"
        level = found.level
        if np.isnan(level.value):
            after = " since the repair" if self.repairs and self.repairs[-1] > self.time[0] else ""
            return f"{self.axis} has too few readings for a trend{after}."
        size = (
            f"{number(level.value, digits=2)} l/min ({number(level.low, digits=2)} to {number(level.high, digits=2)})"
        )
        if found.ahead.value == 0.0:
            return f"{self.axis} has reached {limit}: it leaks {size}."
        if not self.dated:
            soon = found.not_before
            when = f"before {self.date(soon)}" if soon <= FARTHEST else "within a year"
            return f"{self.axis} does not grow measurably: it leaks {size} and does not reach {limit} {when}."
        low, high = found.ahead.low, found.ahead.high
        late = f"to {self.date(high)}" if high <= 5.0 * FARTHEST else "or later"
        about = f"about {self.date(found.ahead.value)} (90 %: {self.date(low)} {late})"
        return f"{self.axis} will reach {limit} {about}; not before {self.date(found.not_before)}."

    def json(self) -> dict[str, Any]:
        """The same for another program; ``null``: unknown or never."""
        found = self.growth
        dates = dict(zip(("expected", "low", "high", "not_before"), (*found.ahead, found.not_before), strict=True))
        return {
            "axis": self.axis,
            "state": self.state.value,
            "exit_code": EXIT_CODES[self.state],
            "reason": self.reason,
            "sentence": self.sentence(),
            "readings": len(self.time),
            "last": stamp(self.time[-1]),
            "leak_40": {name: _finite(value) for name, value in found.level._asdict().items()},
            "decades_per_day": {name: _finite(value) for name, value in found.rate._asdict().items()},
            "limit": self.limit,
            "limit_reached": {name: self._day(days) for name, days in dates.items()} if self.dated else None,
            "repaired": [stamp(when) for when in self.repairs],
        }

    def _day(self, days: float) -> str | None:
        """A day so many days after the last reading; ``None``: never."""
        return stamp(float(self.time[-1]) + DAY * days)[:10] if days < 1e5 else None


def trends_of(
    table: pd.DataFrame,
    limits: Mapping[str, float],
    oil: Oil,
    between: tuple[float, float] = UNKNOWN_TEMPERATURE,
) -> list[AxisTrend]:
    """The trend of each axis of a table, in the order of their names.

    Args:
        table: of :func:`~hydro_rig.monitoring.trend_table.read_table`.
        limits: by axis, l/min at 100 bar and 40 °C.
        oil: in the axes.
        between: lowest and highest possible temperature in °C of axes without a thermometer.
    """
    return [_trend(str(axis), rows, limits[str(axis)], oil, between) for axis, rows in table.groupby("axis", sort=True)]


def _trend(axis: str, rows: pd.DataFrame, limit: float, oil: Oil, between: tuple[float, float]) -> AxisTrend:
    rows = rows.assign(_time=seconds(rows["time"])).sort_values("_time", kind="stable")
    time = rows["_time"].to_numpy(dtype=np.float64)
    marked = time[(rows["repaired"] != "").to_numpy()]
    since = rows[time >= marked.max(initial=-np.inf)]
    state, reason = _state([Kind(verdict) for verdict in since["verdict"]], since["reason"].tolist())
    size = since["size_40"].to_numpy(dtype=np.float64)
    # A reading's own error, without the thermometer's. The readings share plant and sensors, too: their usual error may
    # be common to all.
    with np.errstate(invalid="ignore", divide="ignore"):
        factor = np.where(since["size"] != 0.0, size / since["size"], 1.0)
    deviation = factor * (since["high"] - since["low"]).to_numpy(dtype=np.float64) / (2.0 * HALF_WIDTH)
    relative = (deviation / size)[np.isfinite(deviation) & (size > 0.0)]
    plant = float(np.median(relative)) / np.log(10.0) if len(relative) else 0.0
    common = float(np.hypot(common_error(oil, since["temperature"].median(), between), min(plant, MOST_COMMON)))
    return AxisTrend(
        axis=axis,
        time=time,
        **{name: rows[f"{name}_40"].to_numpy(dtype=np.float64) for name in ("size", "low", "high")},
        verdicts=tuple(Kind(verdict) for verdict in rows["verdict"]),
        repairs=tuple(np.unique(marked).tolist()),
        state=state,
        reason=reason,
        growth=growth(since["_time"].to_numpy(dtype=np.float64) / DAY, size, limit, deviation, common),
        limit=limit,
    )


def _state(verdicts: Sequence[Kind], reasons: Sequence[str]) -> tuple[Kind, str]:
    """The verdict on which three of the last five readings agree, or both of two, else undecided; and its reason."""
    kind, count = Counter(verdicts[-LATEST:]).most_common(1)[0]
    kind = kind if count >= min(len(verdicts), AGREE) else Kind.UNKNOWN
    return kind, next((why for each, why in zip(verdicts[::-1], reasons[::-1], strict=True) if each is kind), "")


def exit_code(states: Sequence[Kind]) -> int:
    """10 if an axis leaks, else 11 if one has another fault, else 12 if one cannot be told, else 0."""
    return next((EXIT_CODES[kind] for kind in (Kind.LEAK, Kind.OTHER, Kind.UNKNOWN) if kind in states), 0)


def date_text(time: float) -> str:
    """``14 Feb 2027``."""
    day = datetime.fromtimestamp(time, UTC)
    return f"{day.day} {day:%b %Y}"


def _finite(value: float) -> float | None:
    return float(f"{value:.6g}") if np.isfinite(value) else None
