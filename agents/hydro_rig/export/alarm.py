"""The alarm for other machines: C99, traced from the alarm in Python, with test vectors.

The C code gives the same numbers as Python, bit by bit: both do the same operations on double numbers, in the same
order, and no operation rounds differently.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from hydro_agents.detection.alarm import AlarmSettings, AlarmState, LeakAlarm
from hydro_agents.detection.detector import Cause
from hydro_agents.detection.looks import MOVING_FROM, STANDING_BELOW, Activity
from hydro_env import __version__
from hydro_env.types import Floats
from hydro_rig.export.c_files import CCode, c_code, csv_text, tested
from hydro_rig.export.c_writer import C_TYPES, CWriter
from hydro_rig.export.tracing import trace

NAME = "alarm"
FILES = ("alarm.c", "alarm.h", "test_alarm.c", "vectors.csv", "README.md")
INPUTS = {
    "score": "of the detector; NaN: no answer",
    "sigma": "its standard deviation; NaN: unknown",
    "cause": "that the detector names, see the enumeration",
    "activity": "of the axis during the window of the look, see the enumeration",
}
OUTPUTS = {
    "alarm": "1: an alarm; it stays until alarm_reset",
    "total": "the sum of the evidence over its threshold; the alarm rises above 1",
    "cause": "another cause that the last looks name",
    "learnt": "1: the axis's own baseline is known for this activity",
}
EPISODES, LOOKS = 6, 400  # of the test vectors
KEEP, RESET, RELEARN = 0, 1, 2  # before a look of the test vectors


def alarm_code(settings: AlarmSettings) -> CCode:
    """C sources of an alarm, traced for one axis: from a look and the memory to the answer and the next memory.

    Raises:
        TraceError: the alarm uses an operation without translation.
    """
    alarm = LeakAlarm(settings)
    memory = alarm.begin(1)

    def step(score: Any, sigma: Any, cause: Any, activity: Any, **memory: Any) -> dict[str, Any]:
        now, after = alarm.step(score, sigma, cause, activity, AlarmState(**memory))
        return {**now._asdict(), **{f"next.{name}": values for name, values in after._asdict().items()}}

    number, place = np.zeros(1), np.zeros(1, dtype=np.int64)
    look = {"score": number, "sigma": number, "cause": place, "activity": place}
    graph = trace(step, {**look, **memory._asdict()})
    writer = CWriter({name: name for name in INPUTS} | {name: f"memory->{name}" for name in memory._fields}, "alarm_")
    writer.reserve("memory", "now", *INPUTS, *OUTPUTS)
    writer.plan(graph)
    lines = writer.statements(graph.nodes())
    targets = [(f"memory->{name}", f"next_{name}", f"next.{name}") for name in memory._fields]
    targets += [(f"now.{name}", f"now_{name}", name) for name in OUTPUTS]
    kept = [writer.stored(target, variable, graph.outputs[name], lines) for target, variable, name in targets]
    ones: Any = (np.ones_like(values) for values in memory)
    cleared = alarm.reset(AlarmState(*ones), np.array([True]))
    values = _texts(settings) | {
        "parts": [(C_TYPES[values.dtype], name, values.size) for name, values in memory._asdict().items()],
        "outputs": [(C_TYPES[graph.outputs[name].kind], name, meaning) for name, meaning in OUTPUTS.items()],
        "cleared": [name for name in memory._fields if not getattr(cleared, name).any()],
        "statements": "\n".join(lines),
        "kept": "\n".join(kept),
        "helpers": writer.helpers,
        "tables": writer.tables,
    }
    return c_code(NAME, values)


def _texts(settings: AlarmSettings) -> dict[str, Any]:
    return {
        "version": __version__,
        "detector": settings.detector or "a detector",
        "interval": settings.interval,
        "rate": settings.false_alarms_per_100_h,
        "causes": [(cause.name, int(cause), cause.in_full) for cause in Cause],
        "activities": [(each.name, int(each)) for each in Activity],
        "standing_below": 1e3 * STANDING_BELOW,
        "moving_from": 1e3 * MOVING_FROM,
        "inputs": INPUTS,
        "samples": EPISODES * LOOKS,
    }


def exported_alarm(settings: AlarmSettings, command: str) -> tuple[dict[str, bytes], list[str]]:
    """The files of an exported alarm by name, and the results of their checks, one line each.

    Raises:
        TraceError: the alarm uses an operation without translation.
        HydroError: the C code gives other values.
    """
    values = _texts(settings) | {"command": command}
    files, in_c = tested(alarm_code(settings), vectors(settings), values)
    return files, [f"alarm.c: {in_c}"]


def vectors(settings: AlarmSettings) -> str:
    """Looks, resets between them, and what the alarm says, as CSV; every number reads back exactly."""
    alarm, rows = LeakAlarm(settings), []
    spread, highest, shift = (settings.table(name) for name in ("spread", "highest_baseline", "shift"))
    for episode in range(EPISODES):
        generator = np.random.default_rng(episode)
        state = alarm.begin(1)
        for number in range(LOOKS):
            rise = shift * episode / (EPISODES - 1) * (number > LOOKS // 2)
            look = _look(generator, spread, highest - spread + rise)
            action = int(generator.choice([KEEP, RESET, RELEARN], p=[0.98, 0.015, 0.005]))
            if action != KEEP:
                state = alarm.reset(state, np.array([True]), relearn=action == RELEARN)
            score, sigma, cause, activity = look
            now, state = alarm.step(score, sigma, cause, activity, state)
            rows.append([action, *(values[0] for values in (*look, *now))])
    starts = np.arange(len(rows)) % LOOKS == 0
    return csv_text(["action", *INPUTS, *(f"now_{name}" for name in OUTPUTS)], starts, rows)


def _look(generator: np.random.Generator, spread: Floats, level: Floats) -> list[NDArray[Any]]:
    """A look at one axis: noise, now and then an outlier, no answer, or a named cause."""
    activity = int(generator.integers(len(Activity)))
    noise = float(generator.normal()) * (1.0 if generator.random() < 0.97 else 20.0)
    score = level[activity] + spread[activity] * noise
    if generator.random() < 0.05:
        score = generator.choice([np.nan, np.inf, -np.inf])
    sigma = spread[activity] * generator.choice([np.nan, 0.5, 2.0])
    cause = generator.choice(len(Cause)) if generator.random() < 0.5 else int(Cause.NONE)
    return [np.array([score]), np.array([sigma]), np.array([cause]), np.array([activity])]
