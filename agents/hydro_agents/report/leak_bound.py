"""Tables as text of ``hydro leak-bound`` and ``hydro test-move``."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
import pandas as pd

from hydro_agents.estimation.information import TASK, ratios_to_bound
from hydro_agents.estimation.known_windows import MOTIONS
from hydro_agents.estimation.move_design import Design, Move
from hydro_agents.evaluation.leak_bound import ALL_SENSORS
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


def bound_markdown(table: pd.DataFrame) -> str:
    """All tables of :func:`tables` as Markdown."""
    return "\n\n".join(f"{title}:\n\n{frame_markdown(part)}" for title, part in tables(table).items())


def trial_table(table: pd.DataFrame) -> pd.DataFrame:
    """Bound and errors of the estimate by motion and leak; cells are text, l/min at 100 bar."""
    rows = []
    for (motion, leak), part in table.groupby(["motion", "leakage_flow_lpm"], sort=False):
        kept = part[part["holds"]]
        within = (kept["estimate_lpm"] - leak).abs() <= 1.645 * kept["deviation_lpm"]
        median = float((kept["estimate_lpm"] - leak).abs().median()) if len(kept) else np.nan
        ratio = ratios_to_bound(*(kept[name].to_numpy() for name in ("leakage_flow_lpm", "estimate_lpm", "sigma_lpm")))
        rows.append(
            {
                "motion": motion,
                "leak, l/min": setting(float(leak)),
                "bound, median": number(float(part["sigma_lpm"].median()), digits=2),
                "largest": number(float(part["sigma_lpm"].max()), digits=2),
                "error, median": number(median, digits=2),
                "error over bound": number(ratio[0].ratio if ratio else np.nan, digits=2),
                "within 90 %": f"{within.sum()} of {len(kept)}",
                "model holds": f"{len(kept)} of {len(part)}",
            }
        )
    return pd.DataFrame(rows).set_index("motion")


def move_table(move: Move) -> str:
    """The move as Markdown, one row per stroke."""
    rows = [
        (f"{1e3 * one.start:.1f}", f"{one.hold:.2f}", f"{1e3 * one.end:.1f}", f"{one.duration:.2f}")
        for one in move.strokes
    ]
    last = (f"{1e3 * move.strokes[-1].end:.1f}", f"{move.last_hold:.2f}", "–", "–")
    frame = pd.DataFrame([*rows, last], columns=["hold at, mm", "for, s", "then move to, mm", "in, s"])
    frame.index = pd.Index(range(1, len(frame) + 1), name="")
    return frame_markdown(frame)


def gain(best: Design) -> str:
    """Gain of the search on the plants of the design, as a sentence."""
    first = f"{number(best.first_bound, digits=2)} l/min" if np.isfinite(best.first_bound) else "not possible"
    return (
        f"Bound on the plants of the design: {number(best.bound, digits=2)} l/min; of one stroke there and back at "
        f"mid-range: {first}."
    )


def trial_markdown(table: pd.DataFrame) -> str:
    """The table of :func:`trial_table` as Markdown."""
    return frame_markdown(trial_table(table))
