"""Compute the published figures again: ``make figures``.

    python benchmarks/figures.py [--list] [--only NAME ...] [--results results]

``figures.yaml`` is the plan. What a command prints is kept in ``printed.txt`` of its folder, its version, commit and
date in ``origin.json``, which marks it as finished: a later call leaves it out. Ctrl-C stops; most commands resume.
"""

import json
import shlex
import subprocess
import sys
from pathlib import Path
from typing import Any

import yaml

from benchmarks import command_line
from hydro_agents.running.machine import Origin
from hydro_env.files import write_text

PLAN: list[dict[str, Any]] = yaml.safe_load(Path(__file__).with_suffix(".yaml").read_text(encoding="utf-8"))
ORIGIN = "origin.json"


def compute(entry: dict[str, Any], folder: Path) -> None:
    """Run one command, show and keep what it prints, and note its origin."""
    own = Path(sys.executable).parent
    words = shlex.split(entry["command"].replace("results/", f"{folder.parent}/"))
    folder.mkdir(parents=True, exist_ok=True)
    origin = Origin.now(entry["command"])
    with open(folder / "printed.txt", "w", encoding="utf-8") as kept:
        with subprocess.Popen([own / words[0], *words[1:]], stdout=subprocess.PIPE, text=True) as process:
            assert process.stdout is not None
            for line in process.stdout:
                print(line, end="", flush=True)
                kept.write(line)
        if process.returncode:
            sys.exit(f"{entry['folder']}: the command ended with {process.returncode}; the next call goes on here")
    write_text(folder / ORIGIN, json.dumps(origin._asdict(), indent=2))


def main() -> None:
    """Compute what is not finished, then put the tables into the pages and draw their pictures."""
    given = command_line(__doc__, list=False, only={entry["folder"]: entry for entry in PLAN}, results=Path("results"))
    for entry in PLAN:
        if entry["folder"] not in given.only:
            continue
        folder = given.results / entry["folder"]
        done = (folder / ORIGIN).is_file()
        state = "done" if done else f"{entry['minutes']} min"
        print(f"{entry['folder']}: {state}, {entry['command']}", flush=True)
        if not (done or given.list):
            compute(entry, folder)
    if not given.list:
        subprocess.run([sys.executable, "-m", "benchmarks.put_into_docs", str(given.results)], check=True)
        study = given.results / "study"
        tables = [str(study)] if (study / "tables").is_dir() else []
        subprocess.run([sys.executable, "docs/pictures.py", *tables], check=True)


if __name__ == "__main__":
    try:
        main()
    except KeyboardInterrupt:
        sys.exit("stopped; the next call goes on here")
