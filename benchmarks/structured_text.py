"""Structured Text of exported blocks through MATIEC and STruC++: vectors, time and memory beside the C code.

    hydro export ppo --output ppo
    hydro export leakage_head --output head
    python benchmarks/structured_text.py ppo head --matiec ../matiec --strucpp ../STruCpp

The options name checkouts with a built compiler (github.com/beremiz/matiec, github.com/Autonomy-Logic/STruCpp);
default: those of iec2c and strucpp on the PATH; one that is not found is left out. All programs do the same.
"""

import argparse
import csv
import re
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path

from hydro_rig.export.structured_text import st_name

FLAGS = ("-O2", "-ffp-contract=off", "-w")
MAIN = Path(__file__).with_suffix(".c").read_text()


def ran(command: Sequence[object], folder: Path, given: str = "") -> str:
    """What a command prints; its complaint ends the program."""
    result = subprocess.run([*map(str, command)], cwd=folder, input=given, capture_output=True, text=True, check=False)
    if result.returncode != 0:
        sys.exit(f"{command[0]}: {(result.stderr or result.stdout).strip()[:500]}")
    return result.stdout


def measured(block: Path, work: Path, words: dict[str, str], field: str, compiler: Sequence[object]) -> list[float]:
    """Largest difference (V, l/min, or of a state), mean and longest µs per call, bytes of an instance.

    ``words``: of :data:`MAIN`; ``field``: text of an input or output; {0}: name in C, {1}: in the text, {2}: a gain.
    """
    names, *samples = csv.reader(block.with_name("vectors.csv").open())
    head, in_c = "probability" in names, "{0}" in field
    first = names.index("probability") if head else len(names) - 3  # output

    def text(name: str) -> str:
        outer, _, inner = name.partition(".")
        return field.format(name, st_name(outer).upper(), f".{inner.upper()}" if inner else "")

    values: dict[str, object] = {"samples": len(samples), "columns": len(names), "first": first}
    inputs = {name: f"v[{place}]" for place, name in enumerate(names[:first]) if place and not (head and in_c)}
    if head and not in_c:
        inputs |= {"enable": "1"} | {f"valid_{name}": f"{value} == {value}" for name, value in inputs.items()}
    values["inputs"] = " ".join(f"{text(name)} = {value};" for name, value in inputs.items())
    values["outputs"] = ", ".join(f"(double){text(name)}" for name in names[first:])
    answered = "row == n" if in_c else text("fresh")
    new = f"v[n][{first}] == v[n][{first}] && (v[n][0] || v[n][{first}] != v[n - 1][{first}])"
    values["due"], values["fresh"] = (new, answered) if head else ("1", "1")
    main = "main.cpp" if str(compiler[0]) == "g++" else "main.c"
    (work / main).write_text(MAIN % {**values, **words})
    ran([*compiler, *FLAGS, main, "-o", "main", "-lm"], work)
    return [float(one) for one in ran(["./main"], work, "\n".join(" ".join(one) for one in samples)).split()]


def compared(block: Path, matiec: Path | None, strucpp: Path | None) -> None:
    """Print a line per compiler about a block in Structured Text, in the folder of its C code and vectors."""
    name = re.findall(r"^FUNCTION_BLOCK (\w+)", block.read_text(), re.MULTILINE)[0]
    upper, code, lines = name.upper(), block.stem, {}
    with tempfile.TemporaryDirectory() as place:
        work = Path(place)
        include = f'#include "{block.with_suffix(".c").absolute()}"'
        words = {"before": include, "type": name, "reset": f"{code}_reset(&block)", "step": f"{code}_step(&block)"}
        field = "block.{0}"
        if name == "LeakageHead":
            words |= {"reset": "leakage_head_start(&block)", "step": "leakage_head_update(&block, v + 1)"}
            field = "block.estimate.{0}"
        lines["C"] = measured(block, work, words, field, ["gcc", "-std=gnu99"])
        if matiec:
            ran([matiec / "iec2c", "-I", matiec / "lib", "-T", work, block.absolute()], work)
            words = {"before": '#include "POUS.h"\n#include "POUS.c"', "type": upper}
            words |= {"reset": f"{upper}_init__(&block, 0)", "step": f"{upper}_body__(&block)"}
            lines["MATIEC"] = measured(block, work, words, "block.{1}.value{2}", ["gcc", "-I", matiec / "lib/C"])
        if strucpp:
            ran(["node", strucpp / "dist/node/cli.js", block.absolute(), "-o", "block.cpp"], work)
            words = {"before": '#include "block.cpp"\nusing namespace strucpp;', "type": f"strucpp::{upper}"}
            words |= {"reset": f"block = strucpp::{upper}()", "step": "block()"}
            compiler = ["g++", "-std=c++17", "-I", strucpp / "src/runtime/include"]
            lines["STruC++"] = measured(block, work, words, "block.{1}{2}", compiler)
    for who, (apart, mean, longest, size) in lines.items():
        of_c, longest_of_c = mean / lines["C"][1], longest / lines["C"][2]
        row = (f"{apart:.2g}", f"{mean:.3g}", f"{of_c:.1f}", f"{longest:.3g}", f"{longest_of_c:.2g}", f"{size:.0f}")
        print(" | ".join((block.parent.name, who, *row)))


def main() -> None:
    """Print a table of the folders that the command line names."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n\n")[0])
    parser.add_argument("folders", type=Path, nargs="+")
    for option, command, depth in (("--matiec", "iec2c", 0), ("--strucpp", "strucpp", 2)):
        found = shutil.which(command)
        parser.add_argument(option, type=Path, default=Path(found).resolve().parents[depth] if found else None)
    given = parser.parse_args()
    print("folder | compiler | largest difference | µs per call | of C | longest call | of C | bytes of an instance")
    for folder in given.folders:
        block = next(file for file in folder.glob("*.st") if not file.stem.endswith("_call"))
        compared(block, *(place and place.absolute() for place in (given.matiec, given.strucpp)))


if __name__ == "__main__":
    main()
