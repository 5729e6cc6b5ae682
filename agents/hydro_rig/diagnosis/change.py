"""Before and after: what the change of a seal did to the leak, at one temperature of the oil."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from hydro_agents.running.text import number
from hydro_rig.diagnosis.oil import Oil, referred, temperature_of
from hydro_rig.diagnosis.pipeline import Diagnosis
from hydro_rig.diagnosis.verdict import Leak


class Change(NamedTuple):
    """What became of the leak."""

    fall: Leak | None  # l/min at 100 bar and 40 °C, with its 90 % interval; None: a recording gives no leak
    line: str


def change_of(before: Diagnosis, after: Diagnosis, oil: Oil) -> Change:
    """The leak of one recording minus that of a later one; their errors count as independent."""
    sizes = []
    for when, one in (("before", before), ("after", after)):
        if one.verdict.leak is None:
            return Change(None, f"cannot tell what has changed: {when}: {one.verdict.why}")
        sizes.append(referred(one.verdict.leak, oil, temperature_of(one.recording)))
    old, new = sizes
    fall = float(old.value - new.value)
    low = fall - float(np.hypot(old.value - old.low, new.high - new.value))
    high = fall + float(np.hypot(old.high - old.value, new.value - new.low))
    what = "cannot tell whether the leak has changed"
    if low > 0.0:
        what = "the leak has fallen"
    elif high < 0.0:
        what = "the leak has grown"
    ends = ", ".join(number(size, digits=2) for size in (low, high))
    line = f"{what}: before minus after {number(fall, digits=2)} [{ends}] l/min at 100 bar and 40 °C"
    return Change(Leak(fall, low, high), line)
