"""Ends study, evaluate, trend and record --benchmark at random moments; the same command must then finish, bit-equal.

``python benchmarks/kills.py FOLDER --count 20 --seed 0`` prints a line per kill. Bad are an orphan process, more than
one line after Ctrl-C or SIGTERM, a half-written file, and a result that differs from that of an uninterrupted run.
"""

from __future__ import annotations

import argparse
import os
import random
import re
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

ROOT = Path(__file__).parents[1]
sys.path[:0] = [str(ROOT), str(ROOT / "agents"), str(ROOT / "tests")]

from command_line import COMMAND, environment, own_lines  # type: ignore[import-not-found]  # noqa: E402

STUDY = """task: {episode_duration: 0.4}
controllers:
  PID: {kind: pid}
  PPO: {kind: ppo, corrects: PID, settings: {total_steps: 12000, axes: 64, steps_per_rollout: 32, residual_scale: 1.0}}
leakage_head: {episodes: 100, validation_episodes: 100, epochs: 2, width: 8, batch: 64}
evaluation: {plants: 3, detection_episodes: 100, leak_levels: [0.01, 1.0], families: [step, sine]}
"""
PROTOCOL = """{title: Small, task: default, leak_levels: [0.03, 4.0], families: [step, sine], plants: 3, chunk: 8,
  worst: 1, experiments: false, bound_conditions: [], standstill_leak_levels: [0.03, 8.0], standstill_plants: 3,
  conditions: {a: {group: leak, label: low, leak_levels: [0.03]}, b: {group: leak, label: high, leak_levels: [8.0]}}}
"""
JOBS = {  # arguments, and those that continue; OUT is the folder
    "study": ("study --config study.yaml -o OUT --jobs 2", "--resume"),
    "evaluate": ("evaluate --protocol protocol.yaml -o OUT --jobs 2", "--resume"),
    "trend": ("trend axes --append OUT/trend.csv --jobs 2", ""),
    "record": ("record --benchmark OUT --count 9 --jobs 2", ""),
}
COMPARED = (".csv", ".safetensors", ".parquet", ".svg", ".yaml", ".json")
CHANGING = (
    "progress.csv",
    "state.json",
    ".hydro.json",
    "checkpoint.safetensors",
    "head_checkpoint.safetensors",
    "protocol.csv",
)
TIMES = re.compile(rb'"(seconds|digest)": [^,}]*')  # of a training, and of the text with it
SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGKILL)


def start(words: str, folder: Path, mark: str) -> subprocess.Popen[str]:
    """A command in a process group of its own, with the usual answer to signals."""
    return subprocess.Popen(
        [*COMMAND, *words.split()], cwd=folder, text=True, env=environment(HYDRO_KILLED=mark), stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, start_new_session=True,
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),
    )  # fmt: skip


def content(folder: Path) -> dict[str, bytes]:
    """The files that do not hold times."""
    files = [path for path in folder.rglob("*") if path.suffix in COMPARED and path.name not in CHANGING]
    return {str(path.relative_to(folder)): TIMES.sub(b"", path.read_bytes()) for path in files}


def orphans(mark: str) -> list[int]:
    """Processes with this mark that still run."""
    found = []
    for place in Path("/proc").glob("[0-9]*/environ"):
        try:
            found += (
                [int(place.parent.name)] if f"HYDRO_KILLED={mark}".encode() in place.read_bytes().split(b"\0") else []
            )
        except OSError:
            continue
    return found


def killed(name: str, folder: Path, seconds: float, draw: random.Random, mark: str) -> tuple[str, list[str]]:
    """End a command once, finish it, and say what was done and what is bad."""
    words, more = JOBS[name]
    out, bad, number = folder / "out", [], draw.choice(SIGNALS)
    shutil.rmtree(out, ignore_errors=True)
    moment, process = draw.uniform(0.03, 0.97) * seconds, start(words.replace("OUT", "out"), folder, mark)
    try:
        process.wait(moment)
    except subprocess.TimeoutExpired:
        os.killpg(process.pid, number) if number == signal.SIGINT else os.kill(process.pid, number)
    begun = time.monotonic()
    said = own_lines(process.communicate()[1])  # ends when the last process that shares the pipe has ended
    bad += [f"ended after {time.monotonic() - begun:.0f} s"] if time.monotonic() - begun > 20.0 else []
    lines = [line for line in said if line.startswith("hydro: ")]
    if process.returncode not in (0, 128 + number, -number) or "Traceback" in " ".join(said) or len(lines) > 1:
        bad.append(f"exit code {process.returncode}: {' | '.join(said)[-300:]}")
    ends = time.monotonic() + 20.0
    while orphans(mark) and time.monotonic() < ends:
        time.sleep(0.5)
    bad += [f"orphans {orphans(mark)}"] if orphans(mark) else []
    words = words.replace("OUT", "out")
    again = start(f"{words} {more}", folder, mark)
    first = again.communicate()[1]
    if more and again.returncode == 2 and "nothing to resume" in first:
        again = start(words, folder, mark)
        first = again.communicate()[1]
    if again.returncode not in (0, 10, 11, 12):
        bad.append(f"again {again.returncode}: {' | '.join(own_lines(first))[-300:]}")
    expected, found = content(folder / "whole"), content(out)
    bad += [f"differs: {key}" for key in sorted({*expected, *found}) if expected.get(key) != found.get(key)][:5]
    bad += [f"left: {path.name}" for path in out.rglob(".*") if path.name != ".hydro.json"]
    return f"{name} {number.name} after {moment:.1f} of {seconds:.1f} s: {(lines or said or ['silent'])[-1][:120]}", bad


def main() -> None:
    """Kill each command in turn."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--count", type=int, default=20)
    parser.add_argument("--seed", type=int, default=0)
    given = parser.parse_args()
    draw, seconds, count = random.Random(given.seed), dict[str, float](), 0
    for name, (words, _) in JOBS.items():
        folder = given.folder.absolute() / name
        folder.mkdir(parents=True)
        (folder / "study.yaml").write_text(STUDY)
        (folder / "protocol.yaml").write_text(PROTOCOL)
        for place in range(4 if name == "trend" else 0):
            record = f"record -o axes/{place % 2}/{place}.csv --duration 6 --leakage 0.5 --seed {place}"
            start(record, folder, "prepare").communicate()
        begun = time.monotonic()
        print(start(words.replace("OUT", "whole"), folder, "whole").communicate()[1][-300:])
        seconds[name] = time.monotonic() - begun
    for place in range(given.count):
        name = list(JOBS)[place % len(JOBS)]
        line, bad = killed(name, given.folder.absolute() / name, seconds[name], draw, f"{os.getpid()}_{place}")
        count += bool(bad)
        print(f"{place + 1}: {line}{''.join(f'{chr(10)}   BAD {one}' for one in bad)}", flush=True)
    print(f"{given.count} kills, {count} bad")


if __name__ == "__main__":
    main()
