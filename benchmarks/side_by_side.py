"""A study on several training seeds: side by side against one after another; time, and whether all bits are equal.

    python benchmarks/side_by_side.py --seeds 8 --jobs 2

Both runs follow each other on the same machine. Other programs that run at the time make the ratio of the times worse;
the processor time shows how much work was done.
"""

from __future__ import annotations

import argparse
import os
import resource
import signal
import subprocess
import sys
import tempfile
import threading
import time
from pathlib import Path

import pandas as pd

COMMAND = (sys.executable, "-m", "hydro_agents.commands.application")
SHORT = """
title: "A short study: a training of PPO and an evaluation, without a leakage head"
controllers:
  PID: {kind: pid}
  Flow linearisation: {kind: flow_linearising}
  PPO on flow linearisation: {kind: ppo, settings: {total_steps: 60000}, corrects: Flow linearisation}
leakage_head: null
evaluation: {plants: 3, leak_levels: [0.01, 4.0], families: [step], bound_plants: 1}
"""
TABLE = "tables/over_seeds.csv"
COMPARED = ("seed */controllers/*/policy.safetensors", "seed */leakage_head.safetensors", "seed */tables/*.csv")


def study(config: str, seeds: int, jobs: int, folder: Path, kill_after: float | None = None) -> tuple[float, float]:
    """Run a study; seconds that passed, and seconds of the processors.

    After ``kill_after`` seconds one of its worker processes is killed.
    """
    line = [*COMMAND, "study", "--config", config, "--seeds", str(seeds), "--jobs", str(jobs), "-o", str(folder)]
    before, began = _processor_seconds(), time.perf_counter()
    with open(folder.with_suffix(".log"), "w", encoding="utf-8") as log:
        process = subprocess.Popen(line, stdout=log)
        timer = threading.Timer(kill_after or 0.0, _kill_worker, [process.pid])
        if kill_after is not None:
            timer.start()
        code = process.wait()
        timer.cancel()
    if code:
        raise SystemExit(f"exit code {code}; {log.name} tells more")
    return time.perf_counter() - began, _processor_seconds() - before


def _processor_seconds() -> float:
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def _kill_worker(parent: int) -> None:
    found = subprocess.run(["pgrep", "-P", str(parent), "-f", "popen_loky"], capture_output=True, text=True, check=True)
    worker = int(found.stdout.split()[0])
    os.kill(worker, signal.SIGKILL)
    print(f"killed worker {worker} of study {parent}", flush=True)


def differences(one: Path, other: Path) -> list[str]:
    """Names of the weights and tables that are not equal in two folders, bit for bit; times are left out."""
    names = {path.relative_to(root) for root in (one, other) for pattern in COMPARED for path in root.glob(pattern)}
    if not names:
        raise SystemExit(f"{one}: holds no results")
    texts = [
        (root / name).read_bytes() if (root / name).exists() else b"" for name in sorted(names) for root in (one, other)
    ]
    differ = [str(name) for name, a, b in zip(sorted(names), texts[::2], texts[1::2], strict=True) if a != b]
    tables = [pd.read_csv(root / TABLE).query("figure != 'training, s'") for root in (one, other)]
    return differ + ([] if tables[0].equals(tables[1]) else [TABLE])


def main() -> None:
    """Measure, and print one line for each run."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--config", help="a study; default: a short one")
    parser.add_argument("--seeds", type=int, default=8)
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument(
        "--kill", type=float, metavar="SECONDS", help="kill a worker of the run side by side after these"
    )
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        short = Path(folder) / "short.yaml"
        short.write_text(SHORT, encoding="utf-8")
        config = given.config or str(short)
        alone, beside = Path(folder) / "alone", Path(folder) / "beside"
        print(f"load before: {os.getloadavg()[0]:.1f} on {os.cpu_count()} cores", flush=True)
        wall, work = study(config, given.seeds, 1, alone)
        print(f"one after another: {wall:.0f} s, processor {work:.0f} s", flush=True)
        wall_beside, work_beside = study(config, given.seeds, given.jobs, beside, given.kill)
        print(f"--jobs {given.jobs}: {wall_beside:.0f} s, processor {work_beside:.0f} s", flush=True)
        print(f"ratio of the times {wall_beside / wall:.2f}, of the processor times {work_beside / work:.2f}")
        print(f"weights and tables: {', '.join(differences(alone, beside)) or 'equal, bit for bit'}")


if __name__ == "__main__":
    main()
