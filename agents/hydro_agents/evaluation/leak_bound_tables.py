"""The bound as tables."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
import pandas as pd

from hydro_agents.estimation.information import TASK
from hydro_agents.estimation.known_windows import MOTIONS
from hydro_agents.evaluation.leak_bound_survey import ALL_SENSORS
from hydro_agents.running.text import frame_markdown, number, setting

ORDINARY = next(iter(MOTIONS))


def middle(values: Iterable[float], wanted: float) -> float:
    """The value with the ratio to ``wanted`` closest to 1."""
    return min(values, key=lambda value: abs(np.log(max(value, 1e-9) / wanted)))


def shown(table: pd.DataFrame) -> tuple[float, float]:
    """Fixed window (s) and leak (l/min) of the tables: the values nearest to 2 s and 0.3 l/min."""
    return middle(table["window_s"].unique(), 2.0), middle(table["leakage_flow_lpm"].unique(), 0.3)


def tables(table: pd.DataFrame) -> dict[str, pd.DataFrame]:
    """Tables of medians over the plants by title; cells are text, the bound in l/min at 100 bar."""
    length, leak = shown(table)
    ordinary, whole = table["motion"] == ORDINARY, table["sensors"] == ALL_SENSORS
    window, level, drawn = table["window_s"] == length, table["leakage_flow_lpm"] == leak, table["unknowns"] == TASK
    seconds, litres = f"window of {length:g} s", f"leak of {leak:g} l/min"
    by_leak = _medians(table[ordinary & whole & window], "leakage_flow_lpm", "unknowns", "leak, l/min")
    by_length = _medians(table[ordinary & whole & level], "window_s", "unknowns", "window, s")
    by_sensor = _medians(table[ordinary & drawn & window], "sensors", "leakage_flow_lpm", "sensors")
    by_motion = table[whole & drawn & window].pivot_table(
        "sigma_lpm", "leakage_flow_lpm", "motion", aggfunc=_spread, sort=False
    )
    by_motion.index = pd.Index([setting(leak) for leak in by_motion.index], name="leak, l/min")
    return {
        f"By leak and unknowns ({ORDINARY}, {seconds})": by_leak,
        f"By length of the window and unknowns ({ORDINARY}, {litres})": by_length,
        f"By sensors and leak ({ORDINARY}, {seconds}; unknown: {TASK})": by_sensor,
        f"By motion and leak: median, and 10 to 90 % of the plants ({seconds}; unknown: {TASK})": by_motion,
    }


def _medians(rows: pd.DataFrame, index: str, columns: str, name: str) -> pd.DataFrame:
    table = rows.pivot_table("sigma_lpm", index, columns, aggfunc="median", sort=False).map(_digits)
    table.index = pd.Index([setting(v) if isinstance(v, float) else str(v) for v in table.index], name=name)
    table.columns = pd.Index([setting(v) if isinstance(v, float) else str(v) for v in table.columns])
    return table


def _digits(value: float) -> str:
    return number(value, digits=2)


def _spread(values: pd.Series[float]) -> str:
    low, median, high = np.quantile(values, [0.1, 0.5, 0.9])
    return f"{_digits(median)} ({_digits(low)} to {_digits(high)})"


def as_markdown(table: pd.DataFrame) -> str:
    """All tables of :func:`tables` as Markdown."""
    return "\n\n".join(f"{title}:\n\n{frame_markdown(part)}" for title, part in tables(table).items())
