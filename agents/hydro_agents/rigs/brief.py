"""The first six lines of ``hydro check-rig``, and the values that are missing in a rig's file."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import groupby
from typing import Any

from hydro_agents.rigs.check import LEAKS, MILLIMETRE, Row, beyond_dead_band, leak_text
from hydro_env import PlantParameters
from hydro_env.plant.analysis import speed_limits
from hydro_env.plant.parameters import PARAMETER_PATHS
from hydro_env.units import FULL_VOLTAGE

WEAK_DAMPING = 0.05
"""Damping ratio below which an axis rings: after five periods a step still oscillates by a fifth."""


def brief(rows: Sequence[Row], parameters: PlantParameters) -> list[tuple[str, str]]:
    """Speeds, forces, frequency, damping, gain and a verdict, each as (name, text).

    Args:
        rows: of :func:`hydro_agents.rigs.check.check_rig`.
        parameters: of the rig.
    """
    by_name: dict[str, list[Row]] = {}
    for row in rows:
        by_name.setdefault(row.quantity, []).append(row)

    def first(quantity: str) -> Row:
        return by_name[quantity][0]

    def text(quantity: str, digits: int = 3) -> str:
        return first(quantity).text(digits)

    lowest = first("lowest natural frequency")
    healthy, leaking = leak_text(LEAKS[0]), leak_text(LEAKS[-1])
    damping = {
        leak: next(row for row in by_name["damping ratio, linearised"] if leak in row.at) for leak in (healthy, leaking)
    }
    worst = {leak: next(row for row in by_name["largest stable gain"] if leak in row.at) for leak in (healthy, leaking)}
    return [
        (
            "speeds",
            f"{text('no-load speed out')} mm/s out, {text('no-load speed in')} mm/s in; at 2/3 of the largest force "
            f"{text('speed out')} and {text('speed in')} mm/s",
        ),
        (
            "forces",
            f"{text('force limit out')} kN out, {text('force limit in')} kN in; it reaches {text('reach in')} to "
            f"{text('reach out')} mm",
        ),
        ("natural frequency", f"{lowest.text(3)} Hz at the softest place ({lowest.at}), ports shut"),
        (
            "damping ratio",
            f"{damping[healthy].text(2)} with a healthy seal, {damping[leaking].text(2)} with a leak of {leaking}, "
            "without friction",
        ),
        ("largest stable gain", _gains(worst[healthy], worst[leaking], leaking, parameters)),
        ("verdict", _verdict(by_name, damping[healthy])),
    ]


def _gains(healthy: Row, leaking: Row, leak: str, parameters: PlantParameters) -> str:
    """The gain in V/mm, and as velocity gain K_v in 1/s from the mean no-load speed; beyond a dead band."""

    def both(row: Row) -> str:
        if isinstance(row.value, str):
            return row.value
        full_speed = sum(speed_limits(beyond_dead_band(parameters))) / 2.0
        return f"{row.value * FULL_VOLTAGE * MILLIMETRE:.3g} V/mm (K_v = {row.value * full_speed:.3g} 1/s)"

    return f"{both(healthy)} with a healthy seal, {both(leaking)} with {leak}; use half of it"


def _verdict(rows: Mapping[str, Sequence[Row]], damping: Row) -> str:
    watch = []
    if dead := rows.get("dead band"):
        watch.append(
            f"the valve is dead within ±{dead[0].text(3)} V: its amplifier or the controller must jump over that "
            "(the gains above suppose it)"
        )
    for direction in ("out", "in"):
        lasting = rows.get(f"lasting speed {direction}")
        full = rows[f"no-load speed {direction}"][0].value
        if (
            lasting
            and isinstance(lasting[0].value, float)
            and isinstance(full, float)
            and lasting[0].value < 0.999 * full
        ):
            watch.append(f"the pump alone sustains only {lasting[0].text(3)} mm/s {direction}")
    if isinstance(damping.value, float) and damping.value < WEAK_DAMPING:
        watch.append("the axis rings: use damping (pressure feedback) or a low gain")
    small_enough = rows.get("is the inner step small enough")
    if small_enough and small_enough[0].value != "yes":
        watch.append("the integrator is less accurate than on the paper's rig")
    if isinstance(damping.value, str) and damping.value != "overdamped":
        watch.append(f"at the examined position: {damping.value}")
    return f"it works{'; ' if watch else ''}{'; '.join(watch)}"


USED_WITH = {
    "valve.coil_inductance": ("valve.model", "drive"),
    "friction.bristle_stiffness": ("friction.model", "lugre"),
    "friction.bristle_damping": ("friction.model", "lugre"),
    "supply.line_volume": ("supply.model", "pump"),
}
"""Fields that act with one choice of another field alone."""


def assumed(values: Mapping[str, Any], parameters: PlantParameters) -> list[tuple[str, list[str]]]:
    """Fields that are missing in a rig's file and have an effect, with their default values, by group.

    Args:
        values: content of the file.
        parameters: the resulting parameters.
    """
    missing = [path.split(".") for path in PARAMETER_PATHS]
    missing = [[group, field] for group, field in missing if field not in (values.get(group) or {})]
    own = parameters.model_dump()
    for path, (choice, needed) in USED_WITH.items():
        group, field = choice.split(".")
        if own[group][field] != needed:
            missing = [parts for parts in missing if ".".join(parts) != path]
    result = []
    for group, fields in groupby(missing, key=lambda path: path[0]):
        entries = [f"{field} = {_shown(getattr(getattr(parameters, group), field))}" for _, field in fields]
        result.append((group, entries))
    return result


def _shown(value: Any) -> str:
    return f"{value:.4g}" if isinstance(value, float) else str(value)
