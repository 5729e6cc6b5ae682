"""Whether the tests notice faults that somebody could make: each of seeded_faults.yaml in turn, in a copy of the code.

Run: python benchmarks/seeded_faults.py [NUMBER ...]

Exit code 1 if a fault is missed, or if its place is not found once.
"""

import os
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import yaml

ROOT = Path(__file__).resolve().parents[1]
FOLDERS = ("hydro_env", "agents", "configs", "tests", "benchmarks", "challenge", "docs", "paper")
FILES = ("pyproject.toml", "README.md", "CONTRIBUTING.md")


def noticed(root: Path, fault: dict[str, Any]) -> bool:
    """Put a fault into the copy of the code at ``root``, run its tests, and take it out again."""
    file = root / fault["file"]
    sound = file.read_text(encoding="utf-8")
    # A detector's rules may say the same of a second reading: the first place counts.
    if fault["find"] not in sound:
        raise SystemExit(f"{fault['file']}: does not hold: {fault['find']}")
    file.write_text(sound.replace(fault["find"], fault["replace"], 1), encoding="utf-8")
    environment = os.environ | {"PYTHONPATH": os.pathsep.join([str(root), str(root / "agents")])}
    command = [sys.executable, "-m", "pytest", "-x", "-q", "-p", "no:cacheprovider", *fault["tests"]]
    done = subprocess.run(command, cwd=root, env=environment, capture_output=True, text=True)
    file.write_text(sound, encoding="utf-8")
    if done.returncode not in (0, 1):
        raise SystemExit(f"{fault['fault']}: the tests do not run:\n{done.stdout[-2000:]}")
    return done.returncode == 1


def main() -> int:
    """Print a line for each fault."""
    faults = yaml.safe_load(Path(__file__).with_suffix(".yaml").read_text(encoding="utf-8"))
    chosen = [int(word) for word in sys.argv[1:]] or range(1, len(faults) + 1)
    missed = 0
    with tempfile.TemporaryDirectory() as folder:
        root = Path(folder)
        for name in FOLDERS:
            shutil.copytree(ROOT / name, root / name)
        for name in FILES:
            shutil.copy2(ROOT / name, root / name)
        for number in chosen:
            fault, began = faults[number - 1], time.monotonic()
            caught = noticed(root, fault)
            missed += not caught
            word = "caught" if caught else "MISSED"
            print(f"{number:2} {word} {time.monotonic() - began:4.0f} s  {fault['fault']}", flush=True)
    print(f"{len(chosen) - missed} of {len(chosen)} caught")
    return int(missed > 0)


if __name__ == "__main__":
    sys.exit(main())
