"""Hostile inputs for every command of ``hydro``: is each answered with one clear line?

``python benchmarks/hostile_inputs.py FOLDER --count 2000 --seed 0`` damages valid files, options and names as
``hostile_inputs.yaml`` lists them, a case per number, and writes ``cases_0.csv``. Numbers that are in it already are
left out; ``--number 7`` shows one case. Bad are a traceback, a hang, more than one line, an unknown exit code, a
half-written folder, and exit code 0 for what is wrong beyond doubt. Each fiftieth case is a process of its own.

``--recordings [--jobs 2]`` mangles recordings of healthy and leaking axes instead (``hostile_recordings.py``), and
counts wrong verdicts of ``hydro diagnose``; ``recordings.csv`` holds every case, and those in it are left out.
"""

from __future__ import annotations

import argparse
import csv
import os
import random
import re
import shutil
import signal
import subprocess
import sys
import tempfile
import traceback
from pathlib import Path

import pandas as pd
import yaml

ROOT = Path(__file__).parents[1]
sys.path[:0] = [str(ROOT), str(ROOT / "agents"), str(ROOT / "tests")]

from command_line import COMMAND, Answer, done, environment, hydro, own_lines  # type: ignore[import-not-found]  # noqa: E402
from hostile_damage import CASES, damage, write_table  # type: ignore[import-not-found]  # noqa: E402

from benchmarks.hostile_answers import run as mangled_recordings  # noqa: E402
from hydro_env.folders import config_folder  # noqa: E402

LONG = "a" * 5000  # for a word of the cases
LINES = {kind: CASES[kind] for kind in ("arguments", "nameplate", "output")}
LINES["options"] = [f"{line} --{name}={{}}" for line, names in CASES["options"].items() for name in names.split()]
VERDICTS = ("diagnose", "trend", "leak-test")  # commands whose exit codes 10 to 14 are answers
UNCLEAR = re.compile("|".join(CASES["unclear"]))
PROGRESS = re.compile(r"[\w ]+: +\d+ %|hydro: left out: ")


def prepare(base: Path) -> None:
    """Valid files of every kind."""
    base.mkdir(parents=True)
    done("record", "-o", base / "recs/rec.csv", "--duration", "2", "--leakage", "0.5")
    done("simulate", "-o", base / "run", "--duration", "0.02")
    for place in ("rec.csv", "file"):
        shutil.copy(base / "recs/rec.csv", base / place)
    hydro("trend", base / "recs", "--append", base / "trend.csv")
    for name, source in CASES["configs"].items():
        text = (config_folder() / f"{source}.yaml").read_text()
        (base / f"{name}.yaml").write_text(text.replace("../", f"{config_folder()}/"))
    shutil.copytree(ROOT / "agents/hydro_agents/pretrained", base / "weights")
    table = pd.read_csv(base / "rec.csv", comment="#")
    for ending in ("parquet", "mat"):
        write_table(table, base / f"rec.{ending}")
    columns = {name.split(" ")[0]: {"column": name, "unit": name.split("[")[1][:-1], "gain": 1.0} for name in table}
    columns["time"] = {"column": "time [s]", "unit": "s", "equidistant": False}
    (base / "map.yaml").write_text(yaml.safe_dump(columns, sort_keys=False))


def case(draw: random.Random) -> tuple[str, list[str], str, bool]:
    """In the folder of the case: the kind, a command line, the damage, and whether it is wrong beyond doubt."""
    more = ["recording", "options", "options", "options", "arguments", "nameplate", "output"]
    kind = draw.choice([*CASES["files"], *CASES["files"], *more])
    if kind not in CASES["files"]:
        word = draw.choice(CASES["places" if kind == "output" else "words"]).replace("LONG", LONG)
        return kind, [part.format(word) for part in draw.choice(LINES[kind]).split()], "", True
    files = CASES["files"][kind]
    file, long = Path(draw.choice(files["names"].split())), files.get("long", [])
    content, command = file.read_bytes(), draw.choice([*files.get("quick", []), *long])
    how, wrong = damage(draw, file)
    while command in long and not wrong:
        shutil.rmtree(file) if file.is_dir() else file.unlink(missing_ok=True)
        file.write_bytes(content)
        how, wrong = damage(draw, file)
    wrong &= kind != "table of trends" or file.exists()  # without a table a new one begins
    given = {"X": str(file), "S": str(file.with_suffix(""))}
    return kind, [given.get(part, part) for part in command.split()], f"{file}: {how}", wrong


def answer_of(line: list[str], apart: bool) -> Answer | subprocess.CompletedProcess[str]:
    """Run a command in this process, or in one of its own; after a minute it gets a Ctrl-C, and has code 130."""
    signal.alarm(60)
    try:
        if not apart:
            return hydro(*line)
        return subprocess.run([*COMMAND, *line], capture_output=True, text=True, check=False, env=environment())
    except (Exception, KeyboardInterrupt) as error:
        return Answer(130 if isinstance(error, KeyboardInterrupt) else 1, "", traceback.format_exc())
    finally:
        signal.alarm(0)


def fault(answer: Answer | subprocess.CompletedProcess[str], line: list[str], wrong: bool) -> str:
    """What is bad about an answer; empty: nothing."""
    lines = [text for text in own_lines(answer.stderr) if not PROGRESS.match(text)]
    listed = len(lines) < 2 or ("mistakes" in lines[0] and all(text.startswith("  ") for text in lines[1:]))
    said = re.sub("is not a readable.*", "", answer.stderr)  # what a library says about a damaged file
    refused = answer.returncode == 2
    faults = {
        "hang": answer.returncode == 130,
        "traceback": "Traceback" in answer.stderr,
        "exit code": answer.returncode not in ((0, 2, *range(10, 15)) if line[0] in VERDICTS else (0, 2)),
        "silent": wrong and answer.returncode in (0, 10),
        "unclear": UNCLEAR.search(said),
        "no clear line": refused and not (lines and lines[0].startswith("hydro: ") and max(map(len, lines)) < 3000),
        "more lines": refused and not listed,
        "left a file": refused and (Path("out").exists() or Path("out.csv").exists()),
    }
    return next((name for name, found in faults.items() if found), "")


def main() -> None:
    """Run the cases and print a table by kind."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    for name, usual in (("count", 2000), ("seed", 0), ("number", -1)):
        parser.add_argument(f"--{name}", type=int, default=usual)
    parser.add_argument("--recordings", action="store_true", help="verdicts on mangled recordings")
    parser.add_argument("--jobs", type=int, default=1, help="of --recordings: processes")
    given = parser.parse_args()
    if given.recordings:
        mangled_recordings(given.folder, given.jobs)
        return
    base, cases = given.folder.absolute() / "valid", given.folder.absolute() / f"cases_{given.seed}.csv"
    if not base.exists():
        prepare(base)
    known = {int(row[0]) for row in csv.reader(cases.open())} if cases.exists() else set()
    numbers = [number for number in range(given.count) if number not in known]
    signal.signal(signal.SIGALRM, signal.default_int_handler)
    for number in [given.number] if given.number >= 0 else numbers:
        with tempfile.TemporaryDirectory() as place:
            shutil.copytree(base, place, dirs_exist_ok=True)
            os.chdir(place)
            kind, line, how, wrong = case(random.Random(f"{given.seed}/{number}"))
            answer = answer_of(line, apart=number % 50 == 0)
            bad = fault(answer, line, wrong) or "good"
        said = answer.stderr.strip()[-300:]
        row = [number, kind, bad, answer.returncode, " ".join(line)[:300], how, wrong, said]
        if given.number >= 0:
            print(*row, answer.stdout, answer.stderr, sep="\n")
            return
        with cases.open("a") as file:
            csv.writer(file).writerow(row)
    table = pd.read_csv(cases, header=None)
    print(pd.crosstab(table[1], table[2], rownames=["kind"], colnames=[""], margins=True).to_string())


if __name__ == "__main__":
    main()
