"""What `hydro trend` says over 60 days of simulated axes: the date of a limit, and healthy axes that raise anything.

Run: python benchmarks/trend.py results/trend_benchmark [--axes 20] [--days 60] [--windows 1] [--validation]

``--axes`` grow, and as many are healthy; ``--windows`` of a day are read. Each axis has a plant of its own, whose leak
at 40 °C grows by a decade in 40 days, or is healthy. On each day 30 s are
recorded in another motion and with other noise, at an oil temperature of 25 to 60 °C that the leak follows; 5 % of the
rows are lost. The seal is repaired on two days that are marked. Recording, choice of windows, checks, estimator, oil
and verdict are those of the command; the thermometer errs by 1 K, the oil's viscosity at 100 °C by 3 %, and the file
is not written. Finished axes stay in the folder; after an interruption the same command goes on.
"""

from typing import Any, NamedTuple

import numpy as np
import pandas as pd

from benchmarks import command_line, kept_rows
from hydro_agents.controllers.base import Controller
from hydro_agents.detection.detector import measured_run
from hydro_agents.learning.loading import shipped
from hydro_agents.running.cases import Cases
from hydro_agents.running.seeds import TREND_CALIBRATION, TRENDS
from hydro_agents.running.statistics import share_interval
from hydro_env import TaskConfig
from hydro_rig.diagnosis.oil import GRADES, Oil
from hydro_rig.recordings.recording import Recording
from hydro_rig.watching import fleet
from hydro_rig.watching.table import stamp
from hydro_rig.watching.trend import DAY, State, trend_of
from hydro_rig.watching.watch import row_of

LENGTH, LOST = 30.0, 0.05  # s of a day that are recorded; share of lost rows
FAMILIES = ("point_to_point", "multi_sine", "staircase", "ramp", "start_stop", "sine", "step")
SHIFT = 30.0  # s, by which the recording of one week begins later than that of the week before
WEEKS = 9
GROWTH = 1.0 / 40.0  # decades a day
LIMIT = 0.3  # l/min at 100 bar and 40 °C
WARM = (25.0, 60.0)  # °C
SEEN = 120  # seeds before these were seen when the rules of states and dates were made
SLOWEST = 3  # readings of an axis before its state counts
START = 1.79e9  # s since 1970


class Axis(NamedTuple):
    """What an axis does."""

    leak: np.ndarray  # (days,), l/min at 100 bar and 40 °C
    warm: np.ndarray  # (days,), °C
    repairs: tuple[int, int]  # days


def axis_of(seed: int, days: int, grows: bool) -> Axis:
    """Leak, oil temperature and repairs of an axis."""
    random = np.random.default_rng([seed, 60])
    first = int(random.integers(4, 9))
    repairs = first, int(random.integers(days - 9, days - 4))
    leak = np.full(days, 10.0 ** random.uniform(-2.0, np.log10(0.025)))
    if grows:
        begins = (0, *repairs)
        fresh = 10.0 ** random.uniform(np.log10(0.03), np.log10(0.05), 3)  # after the first repair the limit is reached
        for day in range(days):
            since = max(begin for begin in begins if begin <= day)
            leak[day] = fresh[begins.index(since)] * 10.0 ** (GROWTH * (day - since))
    slow = np.cumsum(random.normal(0.0, 4.0, days))
    warm = WARM[0] + (WARM[1] - WARM[0]) * (0.5 + 0.5 * np.sin(random.uniform(0, 6.3) + slow / 12.0))
    return Axis(leak, warm, repairs)


def table_of(controller: Controller, seed: int, axis: Axis, windows: int) -> pd.DataFrame:
    """The table that `hydro trend` would write about an axis, a row for each day."""
    days, random = len(axis.leak), np.random.default_rng([seed, 61])
    oil, true_oil = Oil.of("46"), Oil(46.0, GRADES[46] * (1.0 + 0.03 * random.standard_normal()))
    task = TaskConfig(episode_duration=LENGTH + SHIFT * (WEEKS - 1))
    names = np.array([FAMILIES[day % len(FAMILIES)] for day in range(days)])
    leak = axis.leak / true_oil.factor(axis.warm)
    signals, _ = measured_run(task, controller, Cases(np.full(days, seed), leak, names))
    known, off = TaskConfig(), random.normal(0.0, 1.0)
    rows = []
    for day in range(days):
        first = round(SHIFT * (day // len(FAMILIES) % WEEKS) / task.control_period)
        part = signals[day, :, first : first + round(LENGTH / task.control_period)]
        kept = np.flatnonzero(random.random(part.shape[1]) >= LOST)
        warm = {"oil_temperature": axis.warm[day] + off + random.normal(0.0, 0.3, len(kept))}
        time = (kept - kept[0]) * task.control_period
        begun = START + DAY * day
        recording = Recording("day", time, part[:, kept], {}, [], warm, begun)
        row = row_of(recording, known, oil, windows)
        mark = "x" if day in axis.repairs else ""
        rows.append({"time": stamp(begun), "until": stamp(begun), **row, "repaired": mark})
    return pd.DataFrame(rows)


def judge(controller: Controller, seed: int, days: int, grows: bool, windows: int) -> dict[str, Any]:
    """What the trend said day by day: share of dates that hold, false dates and alarms."""
    axis = axis_of(seed, days, grows)
    table = table_of(controller, seed, axis, windows)
    holds, early, raised, at_half = [], [], 0, np.nan
    since = axis.repairs[0]
    crossing = since + np.log10(LIMIT / axis.leak[since]) / GROWTH if grows else np.inf
    usual = fleet.Axis(TaskConfig(), None, Oil.of("46"), LIMIT)
    for day in range(SLOWEST - 1, days):
        trend = trend_of(f"{seed}", table.iloc[: day + 1], usual, "")
        if not grows:
            raised += trend.states[0] in (State.LEAK, State.OTHER) or trend.dated or trend.growth.ahead.value == 0.0
        elif since <= day < min(crossing, axis.repairs[1]) and axis.leak[day] >= 0.5 * LIMIT:
            left, ahead = crossing - day, trend.growth.ahead
            holds.append(trend.dated and ahead.low <= left <= ahead.high)
            early.append(trend.growth.not_before <= left)
            at_half = float(holds[-1]) if len(holds) == 1 else at_half
    value, low, high = (table[name].to_numpy() for name in ("size_40", "low_40", "high_40"))
    answered, inside = np.isfinite(value), (low <= axis.leak) & (axis.leak <= high)
    row = {"seed": seed, "grows": grows, "days": len(holds), "held": int(np.sum(holds)), "at_half": at_half}
    row |= {"not_before": float(np.mean(early)) if early else np.nan, "raised": raised}
    row |= {"read": float(answered.mean()), "inside": float(inside[answered].mean())}
    return row | {"scatter": float(np.nanstd(np.log10(np.clip(value, 1e-4, None) / axis.leak)))}


def main() -> None:
    """Print the table."""
    given = command_line(__doc__, "folder", axes=20, days=60, windows=1, jobs=1, validation=False)
    controller, seeds = shipped("pid", TaskConfig()), TREND_CALIBRATION if given.validation else TRENDS
    grows = {seed: skip == SEEN for skip in (SEEN, 1000 + SEEN) for seed in seeds.take(given.axes, skip)}

    def rows_of(seed: int) -> list[dict[str, Any]]:
        return [judge(controller, seed, given.days, grows[seed], given.windows)]

    table = kept_rows(given.folder / "axes.csv", "seed", list(grows), rows_of, given.jobs)
    growing, healthy = table[table["grows"]], table[~table["grows"]]
    held, days = int(growing["held"].sum()), int(growing["days"].sum())
    half = share_interval(int(growing["at_half"].sum()), int(growing["at_half"].notna().sum()))
    print("| figure | value |\n|---|---|")
    print(f"| days from half the limit on, date inside its 90 % interval | {held} of {days} ({held / days:.0%}) |")
    print(f"| axes, at half the limit | {half.value:.0%} ({half.low:.0%} to {half.high:.0%}, 95 %) |")
    print(f'| days on which "not before" holds | {growing["not_before"].mean():.1%} |')
    print(f"| healthy axes that raise anything | {int((healthy['raised'] > 0).sum())} of {len(healthy)} |")
    print(f"| readings with a size | {table['read'].mean():.1%} |")
    print(f"| their 90 % intervals that hold, day by day | {table['inside'].mean():.0%} |")
    print(f"| scatter of the sizes of growing axes, decades | {growing['scatter'].mean():.3f} |")


if __name__ == "__main__":
    main()
