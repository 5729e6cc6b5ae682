"""Figures about leak detection: shares of windows, sizes, reliability, coverage."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from matplotlib.axes import Axes

from hydro_agents.evaluation.leak_protocol import HEALTHY
from hydro_agents.report.canvas import GREY, INK, Plot, curve_plot, ticks
from hydro_agents.report.content import Content, intervals
from hydro_agents.report.palette import Look

REPORTED, FALSE = "windows in which it is reported, %", "healthy windows reported as leaking, %"


def detection_plot(content: Content) -> list[Plot]:
    """Share found at 1 % false alarms over the size of the leak."""
    table = content.rows("detection", condition=content.base).sort_values("level")
    table = table[table["level"] > HEALTHY]
    if table.empty:
        return []
    parts = table.groupby("detector", sort=False)
    curves = {str(name): intervals(own, "at_1_percent", "level", 100.0) for name, own in parts}

    note = (
        f"{content.label(content.base).capitalize()}, one window each; threshold at 1 % false alarms on validation "
        "axes. Bars: 95 % interval."
    )
    named = ("detection", "Smallest leak that is found", note)
    options: dict[str, Any] = {"ylabel": "windows in which it is found, %", "ylim": (0.0, 103.0)}
    return [curve_plot(*named, curves, content.looks, " %", per="", drawn="levels", **options)]


def _rows_plot(
    content: Content,
    key: str,
    title: str,
    note: str,
    label: str,
    conditions: Sequence[str],
    level: float,
    column: tuple[str, str] = ("detection", "flagged"),
    lines: Sequence[float] = (),
) -> list[Plot]:
    """A share of the windows at a leak (``level``): conditions from top to bottom, those without a value left out."""
    table, share = column
    rows = content.rows(table, level=level)
    rows = rows[rows["condition"].isin(conditions) & rows[share].notna()] if len(rows) else rows
    known = [where for where in conditions if where in set(rows.get("condition", ()))]
    if not known:
        return []
    parts = {}
    for name in content.detectors:
        own = intervals(rows[rows["detector"] == name], share, "condition", 100.0).reindex(known)
        parts[name] = own.rename(index=content.label)

    def finish(axes: Axes) -> None:
        for value in lines:
            axes.axvline(value, color=GREY, linewidth=0.9, linestyle=":")

    return [curve_plot(key, title, note, parts, content.looks, " %", finish, drawn="rows", xlabel=label)]


def motion_plots(content: Content) -> list[Plot]:
    """Detection and false alarms under other motions and controllers."""
    where = "under other motions and controllers"
    conditions = [content.base, *content.in_groups("motion", "controller")]
    used = "Share of windows in which a leak of 0.3 l/min is reported, with the threshold that the detector uses."
    healthy = "Share of windows of healthy axes in which a leak is reported; lines: 2 and 5 %."
    false = (f"False alarms {where}", healthy, FALSE, conditions, HEALTHY)
    return [
        *_rows_plot(content, "motion-found", f"0.3 l/min {where}", used, REPORTED, conditions, 0.3),
        *_rows_plot(content, "motion-false", *false, lines=(2.0, 5.0)),
    ]


def fault_plots(content: Content) -> list[Plot]:
    """Faults and changed plants that are mistaken for a leak, and detection of a leak together with them."""
    conditions = content.in_groups("fault", "plant", "rig")
    taken = "Faults and changes mistaken for a leak past the piston"
    healthy = "Healthy seal with one other fault or change: share of windows in which a leak is reported; line: 10 %."
    both = "A leak of 0.3 l/min together with the same faults"
    leaking = "Share of windows in which the leak is reported in spite of the fault."
    return [
        *_rows_plot(content, "fault-taken", taken, healthy, FALSE, conditions, HEALTHY, lines=(10.0,)),
        *_rows_plot(content, "fault-beside", both, leaking, REPORTED, conditions, 0.3),
    ]


def coverage_plots(content: Content) -> list[Plot]:
    """Coverage of the 90 % intervals at 0.3 l/min: by law, motion and controller, and with other faults."""
    sides = {
        "Laws, motions, controllers": content.in_groups("levels", "law", "motion", "controller"),
        "Other faults and plants": content.in_groups("fault", "plant", "rig"),
    }
    note = "Leak of 0.3 l/min: share of the intervals that contain it; lines: 87 and 93 %."
    label, lines = "intervals that contain the true size, %", (87.0, 93.0)
    plots = []
    for index, (side, conditions) in enumerate(sides.items()):
        key, title = f"coverage-{index}", f"Do 90 % intervals contain the true size? {side}"
        plots += _rows_plot(content, key, title, note, label, conditions, 0.3, ("sizes", "coverage"), lines)
    return plots


def size_plot(content: Content) -> list[Plot]:
    """Size error over the leak, with the Cramér–Rao bound."""
    table = content.rows("sizes", condition=content.base)
    table = table[table["level"] > HEALTHY].sort_values("level")
    estimated = table.dropna(subset=["rms_log10"]).set_index("level")
    if estimated.empty:
        return []
    curves = dict(list(estimated.groupby("detector", sort=False)["rms_log10"]))
    bound = table.dropna(subset=["bound_rms_log10"]).drop_duplicates("level").set_index("level")["bound_rms_log10"]
    curves |= {"Cramér–Rao bound": bound} if len(bound) else {}
    looks = {**content.looks, "Cramér–Rao bound": Look(INK, "", ":")}

    note = "0.05 is about 12 %. The bound is the smallest error that any method can have on such windows."
    named = ("size", "Accuracy of the estimated size", note)
    options: dict[str, Any] = {"yscale": "log", "ylabel": "error of the size, RMS of log10"}
    return [curve_plot(*named, curves, looks, "", per="", drawn="levels", **options)]


def reliability_plot(content: Content) -> list[Plot]:
    """Probability of the detector against the frequency of leaks."""
    table = content.rows("reliability", condition=content.base)
    if table.empty:
        return []
    table = table.assign(probability=100.0 * table["probability"])
    parts = table.groupby("detector", sort=False)
    curves = {str(name): intervals(part, "frequency", "probability", 100.0) for name, part in parts}

    def finish(axes: Axes) -> None:
        axes.plot([0, 100], [0, 100], color=GREY, linewidth=0.9, zorder=1.5)
        ticks(axes.xaxis, (0, 20, 40, 60, 80, 100))
        axes.set(xlabel="probability of the detector, %", xlim=(-3, 103), ylabel="windows that leak, %", ylim=(-3, 103))

    note = "Half of the axes healthy, the others with leaks of all sizes."
    title = "Calibration of the probability"
    return [curve_plot("reliability", title, note, curves, content.looks, " %", finish, per=" %")]
