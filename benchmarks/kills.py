"""Ends study, evaluate and trend at random moments; the same command must then finish, bit-equal.

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

JOBS = {  # without --resume first, and where nothing was kept
    "study": f"study --config {ROOT}/benchmarks/kills_study.yaml -o OUT --jobs 2 --resume",
    "evaluate": f"evaluate --protocol {ROOT}/benchmarks/kills_protocol.yaml -o OUT --jobs 2 --resume",
    "trend": "trend axes --append OUT/trend.csv --jobs 2",
}
MARK = str(os.getpid())  # of the commands, as a variable of their environment
FINISHED = (0, 10, 11, 12, 13, 14)  # exit codes
RESULTS = re.compile(r"(?!progress|state|protocol|\.hydro|.*checkpoint).*\.(csv|safetensors|parquet|svg|yaml|json)")
TIMES = re.compile(rb',\s*"(seconds|digest)": [^,}\s]*')  # of a training, and of the text with it


def start(words: str, folder: Path) -> subprocess.Popen[str]:
    """A command in a process group of its own, with the usual answer to signals."""
    return subprocess.Popen(
        [*COMMAND, *words.split()], cwd=folder, text=True, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE,
        stderr=subprocess.PIPE, env=environment(HYDRO_KILLED=MARK, LOKY_MAX_CPU_COUNT="2"), start_new_session=True,
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),
    )  # fmt: skip


def finish(words: str, folder: Path) -> list[str]:
    """Run a command to its end; what is bad about it."""
    process = start(words, folder)
    said = process.communicate()[1]
    if process.returncode == 2 and "nothing to resume" in said:
        return finish(words.removesuffix(" --resume"), folder)
    return [] if process.returncode in FINISHED else [f"again {process.returncode}: {said[-300:]}"]


def results(folder: Path) -> dict[str, bytes]:
    """The files of results, without times."""
    files = [path for path in folder.rglob("*") if RESULTS.fullmatch(path.name)]
    return {str(path.relative_to(folder)): TIMES.sub(b"", path.read_bytes()) for path in files}


def orphans() -> list[str]:
    """Processes of the commands that still run."""
    listed = subprocess.run(["ps", "axeww"], capture_output=True, text=True, check=True).stdout.splitlines()
    return [f"orphan {line[:100]}" for line in listed if f"HYDRO_KILLED={MARK} " in f"{line} "]


def killed(words: str, folder: Path, moment: float, number: signal.Signals) -> tuple[str, list[str]]:
    """End a command once, finish it, and say what it said and what is bad; no words: it had ended before."""
    out = folder / "out"
    shutil.rmtree(out, ignore_errors=True)
    process = start(words.removesuffix(" --resume"), folder)
    time.sleep(moment)
    os.killpg(process.pid, number) if number == signal.SIGINT else os.kill(process.pid, number)
    begun = time.monotonic()
    said = own_lines(process.communicate()[1])  # ends when the last process that shares the pipe has ended
    seconds, lines = time.monotonic() - begun, [line for line in said if line.startswith("hydro: ")]
    bad = [f"ended after {seconds:.0f} s"] if seconds > 20.0 else []
    if process.returncode in FINISHED:
        return "", []
    if process.returncode not in (128 + number, -number) or "Traceback" in " ".join(said) or len(lines) > 1:
        bad.append(f"exit code {process.returncode}: {' | '.join(said)[-300:]}")
    bad += orphans() + finish(words, folder)
    expected, found = results(folder / "whole"), results(out)
    bad += [f"differs: {key}" for key in sorted({*expected, *found}) if expected.get(key) != found.get(key)][:5]
    bad += [f"left: {path.name}" for path in out.rglob(".*") if path.name != ".hydro.json"]
    return f"exit code {process.returncode}, {(lines or ['nothing said'])[-1][:120]}", bad


def main() -> None:
    """Run each command without a kill, then kill them in turn."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    for name, usual in (("count", 20), ("seed", 0)):
        parser.add_argument(f"--{name}", type=int, default=usual)
    given = parser.parse_args()
    draw, seconds, done, wrong = random.Random(given.seed), dict[str, float](), 0, 0
    for name, words in JOBS.items():
        folder = given.folder.absolute() / name
        folder.mkdir(parents=True)
        for place in range(4 if name == "trend" else 0):
            finish(f"record -o axes/{place % 2}/{place}.csv --duration 6 --leakage 0.5 --seed {place}", folder)
        begun = time.monotonic()
        print(f"{name} without a kill:", finish(words.replace("OUT", "whole").removesuffix(" --resume"), folder))
        seconds[name] = time.monotonic() - begun
    while done < given.count:
        name, number = list(JOBS)[done % len(JOBS)], draw.choice([signal.SIGINT, signal.SIGTERM, signal.SIGKILL])
        folder, moment = given.folder.absolute() / name, draw.uniform(0.03, 1.0) * seconds[name]
        said, bad = killed(JOBS[name].replace("OUT", "out"), folder, moment, number)
        if said:
            done, wrong = done + 1, wrong + bool(bad)
            print(f"{done}: {name}, {number.name} after {moment:.1f} s: {said}", flush=True)
            print(*(f"   BAD {one}" for one in bad), sep="\n", end="\n" * bool(bad), flush=True)
    print(f"{done} kills, {wrong} bad")


if __name__ == "__main__":
    main()
