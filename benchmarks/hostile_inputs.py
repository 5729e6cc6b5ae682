"""Hostile inputs for every command of ``hydro``: is each answered with one clear line?

``python benchmarks/hostile_inputs.py FOLDER --count 2000 --seed 0`` damages valid files, options and names, a case per
number, and writes ``cases.csv``. Numbers that are in it already are left out; ``--number 7`` shows one case. Bad are a
traceback, more than one line, an exit code that is not documented, a hang, a half-written folder, and exit code 0 for
what is wrong beyond doubt. Each fiftieth case runs as a process of its own.
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
from collections import Counter
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parents[1]
sys.path[:0] = [str(ROOT), str(ROOT / "agents"), str(ROOT / "tests")]

from command_line import COMMAND, Answer, done, environment, hydro, own_lines  # type: ignore[import-not-found]  # noqa: E402
from hostile_damage import damage, prepare_tables  # type: ignore[import-not-found]  # noqa: E402

from hydro_env.folders import config_folder  # noqa: E402

WORDS = ["nan", "inf", "-inf", "-1", "1e99", "text", "", "0x10", "1,5", "--", "a" * 5000, "[b]", "é\n", "/", "rec.csv"]
DURATION = "--duration 0.02"
# Files: by kind their names, quick commands, and long ones, which get only what is wrong beyond doubt. X is the file.
FILES: dict[str, tuple[str, list[str], list[str]]] = {
    "rig": (
        "rig.yaml",
        ["check-rig --rig X", f"simulate --rig X {DURATION} -o out", f"record --rig X {DURATION} -o out.csv"],
        [f"{job} --rig X -o out" for job in ("study", "evaluate", "bound", "alarms", "export plant", "leak-test")]
        + ["identify rec.csv --rig X -o out", "trend recs --append out/t.csv --rig X", "train head --rig X -o out"],
    ),
    "task": (
        "task.yaml",
        [f"record --task X {DURATION} -o out.csv"],
        [f"{job} --task X -o out" for job in ("study", "bound", "train ppo", "diagnose rec.csv", "alarms")],
    ),
    "study": ("study.yaml", [], ["study --config X -o out", "train head --config X -o out", "evaluate -c X -o out"]),
    "protocol": ("protocol.yaml leakage.yaml", [], ["evaluate --protocol X -o out"]),
    "gains": ("pid.yaml adrc.yaml", [f"record --controller X {DURATION} -o out.csv"], ["train pid --start X -o out"]),
    "alarm": ("alarm.yaml", [], ["export X -o out"]),
    "column map": ("map.yaml", ["diagnose rec.csv --map X -o out"], ["trend recs --map X --append out/t.csv"]),
    "recording": (
        "rec.csv rec.csv rec.parquet rec.mat rec.tdms rec.mf4",
        ["diagnose X -o out", "leak-test X -o out", "trend X --append out/t.csv"],
        ["identify X --rig rig.yaml -o out"],
    ),
    "weights": (
        "head.json head.safetensors policy.json policy.safetensors",
        [],
        [f"{job} -o out" for job in ("diagnose rec.csv --head S", "export S", "evaluate --head S", "alarms --head S")],
    ),
    "table of trends": ("trend.csv", ["trend recs --append X"], []),
    "predictions": ("predictions.parquet", ["score X --data axes", "score X --data axes -o out"], []),
    "challenge": (
        "axes/benchmark.json axes/hidden/test_labels/0000.parquet",
        ["score predictions.parquet --data axes", "score predictions.parquet --data axes -o out"],
        [],
    ),
    "program, its input": (
        "code/detect.py axes/axes.parquet axes/test/0000.parquet",
        ["score --code code --data axes", "score --code code --data axes -o out"],
        [],
    ),
}
# Options: commands and the options that get each of WORDS in turn, all of them wrong.
OPTIONS = {
    "simulate -o out": "duration sample-time leakage position input rig",
    "study -o out": "config task rig seed seeds jobs backend",
    "train ppo -o out": "config task rig seed steps agent jobs backend",
    "train pid -o out": "objective start steps",
    "evaluate -o out": "config agent task rig head plants protocol jobs",
    "bound -o out": "task rig plants leak agent",
    "check-rig": "rig period latency",
    "record -o out.csv": "task rig controller leakage fault duration family seed",
    "record --benchmark out": "count task",
    "identify rec.csv -o out --rig rig.yaml": "map hold-back task rig",
    "export plant -o out": "task rig period latency",
    "diagnose rec.csv -o out": "map task rig detector window",
    "leak-test -o out": "rig task limit duration speed opening pressure stop between",
    "trend recs --append out/t.csv": "map task rig oil temperature limit",
    "alarms -o out": "task rig detector head rate axes",
    "score --data axes": "code split",
    "score predictions.parquet": "data",
    "benchmark -o out": "only",
}
PLATE = {"bore": "63mm", "rod": "36mm", "stroke": "500mm", "rated-flow": "40l/min", "supply-pressure": "160bar"}
ARGUMENTS = ["train {} -o out", "export {} -o out", "diagnose {} -o out", "score {} --data axes", "trend {}x", "{}x"]
PLACES = ["file", "file/below", "/proc/x", "x" * 300, "/dev/null/x"]
WRITERS = ["simulate", "study", "train pid", "evaluate", "bound", "identify rec.csv --rig rig.yaml", "export plant"]
WRITERS += [
    "diagnose rec.csv",
    "leak-test",
    "alarms",
    "score predictions.parquet --data axes",
    "check-rig",
    "reproduce",
]
VERDICTS = ("diagnose", "trend", "leak-test")  # commands whose exit codes 10 to 12 are answers
UNCLEAR = re.compile(
    r"Traceback|has no attribute|NoneType|subscriptable|operand|\w+Error\b|Errno|invalid literal|could not convert"
    r"|broadcast|out of bounds|unhashable type|Warning|ndarray|numpy|dtype|pydantic|object at 0x"
)
PROGRESS = re.compile(r"[\w ]+: +\d+ %|hydro: left out: ")


def prepare(base: Path) -> None:
    """Valid files of every kind."""
    configs, weights = config_folder(), ROOT / "agents/hydro_agents/pretrained"
    base.mkdir(parents=True)
    done("record", "-o", base / "rec.csv", "--duration", "2", "--leakage", "0.5")
    done("record", "--benchmark", base / "axes", "--count", "9", "--jobs", "1")
    done("simulate", "-o", base / "foreign", "--duration", "0.02")
    (base / "rig.yaml").write_bytes((base / "foreign/rig.yaml").read_bytes())
    (base / "recs").mkdir()
    shutil.copy(base / "rec.csv", base / "recs")
    shutil.copy(base / "rec.csv", base / "file")
    hydro("trend", base / "recs", "--append", base / "trend.csv")
    for name in ("tasks/default", "studies/quick", "protocols/quick", "protocols/leakage_quick"):
        text = (configs / f"{name}.yaml").read_text().replace("../", f"{configs}/")
        kind = {"tasks/default": "task", "studies/quick": "study", "protocols/quick": "protocol"}.get(name, "leakage")
        (base / f"{kind}.yaml").write_text(text)
    for name in ("pid", "adrc", "alarm"):
        shutil.copy(configs / f"agents/{name}.yaml", base)
    for name in ("json", "safetensors"):
        shutil.copy(weights / f"leakage_head.{name}", base / f"head.{name}")
        shutil.copy(weights / f"policy.{name}", base)
    prepare_tables(base)


def case(draw: random.Random) -> tuple[str, list[str], str, bool]:
    """In the folder of the case: the kind, a command line, the damage, and whether it is wrong beyond doubt."""
    kind = draw.choice([*FILES, *FILES, "recording", "options", "options", "options", "arguments", "output"])
    if kind == "options":
        command, options = draw.choice(list(OPTIONS.items()))
        return kind, [*command.split(), f"--{draw.choice(options.split())}={draw.choice(WORDS)}"], "", True
    if kind == "arguments":
        words = [word for word in WORDS if word != "rec.csv"]
        if draw.random() < 0.4:
            plate = PLATE | {
                draw.choice([*PLATE, "mass", "absent", "text"]): draw.choice([*words, "0mm", "1e99mm", "3 elf"])
            }
            return kind, ["new-rig", *(f"{name}={value}" for name, value in plate.items()), "-o", "out"], "", True
        return kind, [word.format(draw.choice(words)) for word in draw.choice(ARGUMENTS).split()], "", True
    if kind == "output":
        return kind, [*draw.choice(WRITERS).split(), "-o", draw.choice(PLACES)], "", True
    names, quick, long = FILES[kind]
    file, command = Path(draw.choice(names.split())), draw.choice(quick + long)
    content, how, wrong = file.read_bytes(), "", False
    for _ in range(100):  # a long command needs what is wrong beyond doubt
        how, wrong = damage(draw, file)
        if wrong or command in quick:
            break
        file.write_bytes(content)
    else:
        raise RuntimeError(f"no damage of {file}")
    wrong &= kind != "table of trends" or file.exists()  # without a table a new one begins
    given = {"X": str(file), "S": str(file.with_suffix(""))}
    return kind, [given.get(word, word) for word in command.split()], f"{file}: {how}", wrong


class Hang(BaseException):
    """A case took longer than a minute."""


def hang(*_: object) -> None:
    """Answer of the clock."""
    raise Hang


def answer_of(line: list[str], apart: bool) -> Answer:
    """Run a command in this process, or in one of its own; a traceback is its error output."""
    if apart:
        whole = subprocess.run(
            [*COMMAND, *line], capture_output=True, text=True, check=False, env=environment(), stdin=subprocess.DEVNULL
        )
        return Answer(whole.returncode, whole.stdout, whole.stderr)
    try:
        return hydro(*line)
    except Hang:
        return Answer(-1, "", "hang")
    except Exception:
        return Answer(1, "", traceback.format_exc())


def fault(answer: Answer, line: list[str], wrong: bool) -> str:
    """What is bad about an answer; empty: nothing."""
    verdict = line[0] in VERDICTS
    lines = [text for text in own_lines(answer.stderr) if not PROGRESS.match(text)]
    if answer.returncode not in ((0, 2, 10, 11, 12) if verdict else (0, 2)):
        return f"exit code {answer.returncode}: {' | '.join(lines[-2:])}"
    if wrong and answer.returncode in (0, 10):
        return f"silent: exit code {answer.returncode}"
    said = re.sub("is not a readable.*", "", answer.stderr)  # what a library says about a damaged file
    if found := UNCLEAR.search(said):
        return f"unclear '{found[0]}': {' | '.join(lines)}"
    if answer.returncode == 2:
        if not lines or not lines[0].startswith("hydro: ") or max(map(len, lines)) > 3000:
            return f"no line: {' | '.join(lines)[:400]}"
        if len(lines) > 1 and not ("mistakes" in lines[0] and all(text.startswith("  ") for text in lines[1:])):
            return f"{len(lines)} lines: {' | '.join(lines)}"
        left = [name for name in ("out", "out.csv") if Path(name).exists()]
        return f"left: {left}" if left else ""
    return ""


def main() -> None:
    """Run the cases and print a table by kind."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    for name, usual in (("count", 2000), ("seed", 0), ("number", -1)):
        parser.add_argument(f"--{name}", type=int, default=usual)
    parser.add_argument("--part", default="0/1", help="such as 1/2: the second half of the numbers")
    given = parser.parse_args()
    base, cases = given.folder.absolute() / "valid", given.folder.absolute() / f"cases_{given.seed}.csv"
    if not base.exists():
        prepare(base)
    rows = list(csv.reader(cases.open())) if cases.exists() else []
    part, parts = map(int, given.part.split("/"))
    known = {int(row[0]) for row in rows}
    numbers = [number for number in range(part, given.count, parts) if number not in known]
    sys.stdin = open(os.devnull)  # noqa: SIM115
    signal.signal(signal.SIGALRM, hang)
    for number in [given.number] if given.number >= 0 else numbers:
        draw = random.Random(f"{given.seed}/{number}")
        with tempfile.TemporaryDirectory() as place:
            shutil.copytree(base, place, dirs_exist_ok=True)
            os.chdir(place)
            kind, line, how, wrong = case(draw)
            signal.alarm(60)
            answer = answer_of(line, number % 50 == 0)
            signal.alarm(0)
            bad = fault(answer, line, wrong)
            os.chdir("/")
        said = (own_lines(answer.stderr) or [""])[-1]
        row: list[Any] = [number, kind, " ".join(line)[:300], how, wrong, answer.returncode, bad[:2000], said[:300]]
        if given.number >= 0:
            print(*row, answer.stdout, answer.stderr, sep="\n")
            return
        with cases.open("a") as file:
            csv.writer(file).writerow(row)
    rows = list(csv.reader(cases.open()))
    every, bad_ones = Counter(row[1] for row in rows), Counter(row[1] for row in rows if row[6])
    print("| kind | cases | bad |\n|---|---:|---:|")
    for kind in sorted(every):
        print(f"| {kind} | {every[kind]} | {bad_ones[kind]} |")
    print(f"| all | {len(rows)} | {sum(bad_ones.values())} |")


if __name__ == "__main__":
    main()
