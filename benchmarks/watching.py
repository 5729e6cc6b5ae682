"""What `hydro watch` costs: share of a core and memory per axis, and whether memory grows.

Run: hydro record --output axis.csv --leakage 0.01 --family multi_sine --duration 120
     python benchmarks/watching.py axis.csv [--axes 40] [--minutes 2]

The rows of the recording come as lines of as many axes, again and again with later stamps, faster than real time. After
each quarter of the time it prints the axes that one core follows, and the memory per axis.
"""

import os
import tempfile
from collections.abc import Iterator
from pathlib import Path
from time import process_time

from benchmarks import command_line
from hydro_env import TaskConfig
from hydro_rig.diagnosis.oil import Oil
from hydro_rig.watching.fleet import Axis, Fleet
from hydro_rig.watching.stream import FleetWatch

PARTS = 4
LIMIT = 0.3  # l/min at 100 bar and 40 °C


def memory() -> float:
    """Resident memory of this process, MB."""
    pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[1])
    return 1e-6 * pages * os.sysconf("SC_PAGE_SIZE")


def lines_of(recording: Path, axes: int, begin: float, end: float) -> Iterator[str]:
    """The rows of all axes from ``begin`` to ``end`` s, the recording end to end."""
    rows = [line for line in recording.read_text(encoding="utf-8").splitlines() if not line.startswith("#")]
    stamps = [float(row.partition(",")[0]) for row in rows[1:]]
    round_trip = stamps[-1] - stamps[0] + stamps[1] - stamps[0]
    yield f"{rows[0]},axis"
    shift = begin // round_trip * round_trip - stamps[0]
    while stamps[0] + shift < end:
        for stamp, row in zip(stamps, rows[1:], strict=True):
            if begin <= stamp + shift < end:
                cells = row.partition(",")[2]
                for axis in range(axes):
                    yield f"{stamp + shift:.6f},{cells},{axis}"
        shift += round_trip


def main() -> None:
    """Watch, and print."""
    given = command_line(__doc__, "recording", axes=40, minutes=2.0)
    with tempfile.TemporaryDirectory() as folder:
        fleet = FleetWatch(Fleet(Axis(TaskConfig(), None, Oil.of("46"), LIMIT)), Path(folder) / "watch.csv")
        list(fleet.looks(lines_of(given.recording, min(given.axes, 2), 0.0, 30.0)))  # compiles
        before, part = memory(), 60.0 * given.minutes / PARTS
        for number in range(PARTS):
            begin = process_time()
            lines = lines_of(given.recording, given.axes, 30.0 + number * part, 30.0 + (number + 1) * part)
            states = sorted({str(look.condition) for look in fleet.looks(lines)})
            follows = given.axes * part / (process_time() - begin)
            size = (memory() - before) / given.axes
            done = f"{(number + 1) * part:.0f} s of {given.axes} axes: one core follows {follows:.0f} axes"
            print(f"{done}; {size:.2f} MB per axis; {', '.join(states)}", flush=True)


if __name__ == "__main__":
    main()
