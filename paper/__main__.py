"""``python -m paper``: the figures of the paper, as pictures, tables and one page; one or a few minutes."""

import sys
from pathlib import Path

from benchmarks import command_line
from hydro_env import HydroError
from paper.run import reproduce_to_folder

if __name__ == "__main__":
    given = command_line(__doc__, output=Path("results/reproduce"), overwrite=False)
    try:
        print(reproduce_to_folder(given.output, given.overwrite, " ".join(["python -m paper", *sys.argv[1:]])))
    except HydroError as error:
        sys.exit(str(error))
