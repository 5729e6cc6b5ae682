"""Structured Text of exported controllers through MATIEC and STruC++: vectors, time and memory beside the C code.

    hydro export ppo --output ppo
    python benchmarks/structured_text.py ppo --matiec ../matiec --strucpp ../STruCpp

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
MAIN = """#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <time.h>
%(before)s
static double v[%(samples)d][%(columns)d]; static %(type)s block;
static void call(const double *v) { if (v[0]) { %(reset)s; } %(inputs)s %(step)s; }
int main(void)
{
    double largest = 0.0, best = HUGE_VAL, wrong = 0.0;
    for (int n = 0; n < %(samples)d; ++n)
        for (int i = 0; i < %(columns)d; ++i) { char text[64]; scanf("%%63s", text); v[n][i] = strtod(text, NULL); }
    for (int n = 0; n < %(samples)d; ++n) {
        call(v[n]);
        const double apart = fabs((double)%(command)s - v[n][%(columns)d - 3 + 0]);
        if (!(apart <= largest)) largest = apart > largest ? apart : HUGE_VAL;
        wrong += (double)%(state)s != v[n][%(columns)d - 3 + 1] || (double)%(fault_code)s != v[n][%(columns)d - 3 + 2];
    }
    for (int round = 0; round < 7; ++round) {
        const clock_t begun = clock();
        for (int k = 0; k < 20; ++k) for (int n = 0; n < %(samples)d; ++n) call(v[n]);
        best = fmin(best, (double)(clock() - begun) / CLOCKS_PER_SEC / 20 / %(samples)d);
    }
    printf("%%.3g %%g %%.4g %%d\\n", largest, wrong, 1e6 * best, (int)sizeof block);
}
"""


def ran(command: Sequence[object], folder: Path, given: str = "") -> str:
    """What a command prints; its complaint ends the program."""
    result = subprocess.run([*map(str, command)], cwd=folder, input=given, capture_output=True, text=True, check=False)
    if result.returncode != 0:
        sys.exit(f"{command[0]}: {(result.stderr or result.stdout).strip()[:500]}")
    return result.stdout


def measured(block: Path, work: Path, words: dict[str, str], field: str, compiler: Sequence[object]) -> list[float]:
    """Largest difference in V, samples with another state, µs per call, bytes of an instance.

    ``words``: of :data:`MAIN`; ``field``: text of an input or output; {0}: name in C, {1}: in the text, {2}: a gain.
    """
    names, *samples = csv.reader(block.with_name("vectors.csv").open())

    def text(name: str) -> str:
        outer, _, inner = name.partition(".")
        return field.format(name, st_name(outer).upper(), f".{inner.upper()}" if inner else "")

    size: dict[str, object] = {"samples": len(samples), "columns": len(names)}
    size["inputs"] = " ".join(f"{text(name)} = v[{place}];" for place, name in enumerate(names[:-3]) if place)
    main = "main.cpp" if str(compiler[0]) == "g++" else "main.c"
    (work / main).write_text(MAIN % {**size, **words, **{name: text(name) for name in names[-3:]}})
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
        lines["C"] = measured(block, work, words, "block.{0}", ["gcc", "-std=c99"])
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
    for who, (apart, wrong, time, size) in lines.items():
        of_c = time / lines["C"][2]
        print(f"{block.parent.name} | {who} | {apart:.2g} | {wrong:.0f} | {time:.3g} | {of_c:.1f} | {size:.0f}")


def main() -> None:
    """Print a table of the folders that the command line names."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n\n")[0])
    parser.add_argument("folders", type=Path, nargs="+")
    for option, command, depth in (("--matiec", "iec2c", 0), ("--strucpp", "strucpp", 2)):
        found = shutil.which(command)
        parser.add_argument(option, type=Path, default=Path(found).resolve().parents[depth] if found else None)
    given = parser.parse_args()
    print("folder | compiler | V | other states | µs per call | of C | bytes of an instance")
    for folder in given.folders:
        block = next(file for file in folder.glob("*.st") if not file.stem.endswith("_call"))
        compared(block, *(place and place.absolute() for place in (given.matiec, given.strucpp)))


if __name__ == "__main__":
    main()
