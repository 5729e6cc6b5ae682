"""``hydro reproduce`` and ``hydro benchmark``: their code is in a checkout of the repository, and is not installed."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated

import typer

import hydro_env
from hydro_agents.commands.options import Output, Overwrite, command_line, say
from hydro_env import ConfigurationError

FOLDER = Path(hydro_env.__file__).resolve().parents[1]  # the root of the checkout, or the folder of installed packages


def need_checkout(package: str, what: str) -> None:
    """Make a package importable that lies beside ``hydro_env`` in a checkout and is not installed.

    Args:
        package: its name.
        what: the beginning of the message.

    Raises:
        ConfigurationError: this installation is no checkout.
    """
    if not (FOLDER / "pyproject.toml").is_file() or not (FOLDER / package / "__init__.py").is_file():
        raise ConfigurationError(
            f"{what} a checkout of the repository: clone it, and run 'pip install --editable .' there; "
            f"this hydro_env is an installed copy in {FOLDER}"
        )
    if str(FOLDER) not in sys.path:
        sys.path.insert(0, str(FOLDER))


def reproduce(output: Output = Path("results/reproduce"), overwrite: Overwrite = False) -> None:
    """Compute the paper's figures again: one or a few minutes; needs a checkout of the repository.

    Writes each figure as a picture (PNG and SVG) and as numbers (CSV), and one self-contained `page.html`, which
    compares each figure with the paper and shows which conclusions do not hold.
    """
    need_checkout("paper", "the figures of the paper need")
    from paper.run import reproduce_to_folder

    say(reproduce_to_folder(output, overwrite, command_line()))


def benchmark(
    output: Output = Path("results/benchmark"),
    only: Annotated[
        list[str] | None,
        typer.Option(
            "--only",
            help="Group to measure (repeat the option for several): kernel, single, vector, accuracy, "
            "training, memory, start, inference. Default: all.",
        ),
    ] = None,
    quick: Annotated[bool, typer.Option("--quick", help="Fewer sizes and shorter runs, for a trial.")] = False,
    overwrite: Overwrite = False,
) -> None:
    """Measure speed, memory and start-up beside other environments; needs a checkout of the repository.

    Writes one table as `benchmark.md` and `benchmark.csv`; every figure is the median of several runs. It takes long, a
    few minutes with `--quick`; each group shows the time that it still needs. Ctrl-C keeps the finished measurements.
    """
    need_checkout("benchmarks", "the benchmark needs")
    from benchmarks.run import benchmark_to_folder

    say(*benchmark_to_folder(output, only or [], quick, overwrite, command_line()))
