"""How many one-line mutations of the chosen modules the tests notice; ``make mutants`` runs mutmut and then this.

mutmut (settings: ``[tool.mutmut]`` in pyproject.toml) writes the outcome of every mutation beside its copy of the code.
Exit code 1 where fewer than 85 % were killed.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path

FOLDER = Path(__file__).resolve().parents[1] / "mutants"
FLOOR = 0.85
SURVIVED = (0, 33)
"""Exit codes of the tests under a mutation that they did not notice, or that no test reaches."""


def main() -> int:
    """Print the share of killed mutations of each module."""
    killed_of_all = count_of_all = 0
    for file in sorted(FOLDER.rglob("*.meta")):
        codes = list(json.loads(file.read_text(encoding="utf-8"))["exit_code_by_key"].values())
        tried = [code for code in codes if code is not None]
        if tried:
            killed = sum(code not in SURVIVED for code in tried)
            print(f"{str(file.relative_to(FOLDER)).removesuffix('.meta'):45} {killed:4} of {len(tried):4} killed")
            killed_of_all, count_of_all = killed_of_all + killed, count_of_all + len(tried)
    if not count_of_all:
        print("no mutations were tried: run mutmut first (make mutants)")
        return 1
    share = killed_of_all / count_of_all
    print(f"{'all':45} {killed_of_all:4} of {count_of_all:4} killed: {100 * share:.1f} % (floor: {100 * FLOOR:.0f} %)")
    return 0 if share >= FLOOR else 1


if __name__ == "__main__":
    sys.exit(main())
