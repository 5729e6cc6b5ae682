"""``python -m paper``: the figures of the paper, as pictures, tables and one page; one or a few minutes."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from hydro_env import HydroError
from paper.run import reproduce_to_folder


def main() -> None:
    """Compute the figures and name the page."""
    parser = argparse.ArgumentParser("python -m paper", description=__doc__)
    parser.add_argument("--output", "-o", type=Path, default=Path("results/reproduce"), help="folder for the results")
    parser.add_argument("--overwrite", action="store_true", help="replace earlier results in the folder")
    given = parser.parse_args()
    try:
        print(reproduce_to_folder(given.output, given.overwrite, " ".join(["python -m paper", *sys.argv[1:]])))
    except HydroError as error:
        sys.exit(str(error))


if __name__ == "__main__":
    main()
