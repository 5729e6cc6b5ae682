"""The command ``hydro``: simulate the axis, train controllers and the leakage head, evaluate, or do the whole study."""

from __future__ import annotations

import sys
from enum import StrEnum
from pathlib import Path
from typing import Annotated, Any

import typer

from agents.commands.evaluate import evaluate
from agents.commands.options import Output, Overwrite, Resume, command_line, stoppable
from agents.commands.study import study
from agents.commands.train import train
from hydro_env import ConfigurationError, HydroError, __version__

# Typer brings its own copy of click, or uses click, depending on its version; this finds either.
_UsageError: type[Any] = typer.BadParameter.__mro__[1]

app = typer.Typer(
    name="hydro",
    no_args_is_help=True,
    rich_markup_mode="markdown",
    pretty_exceptions_enable=False,
    add_completion=False,
    context_settings={"help_option_names": ["-h", "--help"]},
    help="""A hydraulic servo axis whose piston seal may leak: simulate it, learn to control it, notice the leak.

Begin with `hydro study` (the whole job, about six minutes on two cores), or with
`hydro simulate --leakage 1` (one run, a second). Leaks are given as practice does: l/min at 100 bar across the piston.
Healthy is up to 0.03, severe is 1 to 4.""",
)


def _print_version(wanted: bool) -> None:
    if wanted:
        typer.echo(f"hydro_env {__version__}")
        raise typer.Exit


@app.callback()
def common(
    version: Annotated[
        bool, typer.Option("--version", callback=_print_version, is_eager=True, help="Print the version and stop.")
    ] = False,
) -> None:
    """What holds for every command."""
    del version


class InputSignal(StrEnum):
    """Built-in voltages of ``hydro simulate``."""

    STEP = "step"
    SINE = "sine"
    SWEEP = "sweep"
    STOP = "stop"


@app.command()
def simulate(
    output: Output = Path("results/simulate"),
    rig: Annotated[
        Path | None,
        typer.Option("--rig", help="YAML file of a rig; without it the paper's. `configs/rigs` holds some."),
    ] = None,
    signal: Annotated[InputSignal, typer.Option("--input", help="Shape of the voltage.")] = InputSignal.STOP,
    voltage: Annotated[float, typer.Option(help="Amplitude in V, −10 to 10.")] = 3.0,
    input_file: Annotated[
        Path | None, typer.Option(help="CSV with one voltage per sample (last column), instead of --input.")
    ] = None,
    duration: Annotated[float, typer.Option(help="s")] = 1.0,
    sample_time: Annotated[float, typer.Option(help="s; each voltage is held this long.")] = 1e-3,
    leakage: Annotated[float | None, typer.Option(help="Leak in l/min at 100 bar, instead of the rig's own.")] = None,
    position: Annotated[float, typer.Option(help="Start in m from mid-stroke; the axis holds there.")] = 0.0,
    overwrite: Overwrite = False,
) -> None:
    """Run the rig open loop: states, flows and forces as CSV and as a picture.

    `--input stop` moves at constant voltage and then closes the valve: the quick stop of the paper. Compare
    `--leakage 0.01` with `--leakage 4`: with the leak the oscillation dies out sooner.
    """
    from agents.commands.simulation import simulate_to_folder

    files = simulate_to_folder(
        output, rig, signal.value, voltage, input_file, duration, sample_time, leakage, position, overwrite
    )
    for file in files:
        typer.echo(file)


@app.command("check-rig")
def check_rig(
    rig: Annotated[
        Path | None,
        typer.Option("--rig", help="YAML file of a rig; without it the paper's. `configs/rigs` holds some."),
    ] = None,
    output: Annotated[
        Path | None, typer.Option("--output", "-o", help="Folder for check.csv and check.md; without it none.")
    ] = None,
    overwrite: Overwrite = False,
) -> None:
    """Print what an engineer works out by hand for a rig, and refuse a rig that cannot work.

    Areas, flows, speeds, forces, reach, natural frequency and damping, the largest stable proportional gain of the
    sampled position loop with a tight and a leaking seal, and how finely the rig must be integrated.
    """
    from agents.commands.rig_check import check_to_console

    for file in check_to_console(rig, output, overwrite):
        typer.echo(file)


@app.command()
def reproduce(
    output: Output = Path("results/reproduce"),
    rig: Annotated[
        Path | None,
        typer.Option("--rig", help="YAML file of a rig; without it the paper's. `configs/rigs` holds some."),
    ] = None,
    overwrite: Overwrite = False,
) -> None:
    """Compute the figures of the paper again, and what it could not show: about a minute on two cores.

    Leaves for each figure a picture (PNG and SVG) and its numbers (CSV), and `page.html` (self-contained), which sets
    each beside what the paper says and tells where it does not come out. With `--rig` the same for a rig of your own;
    a figure that it cannot do is left out, and the page says why.
    """
    from agents.commands.reproduce import reproduce_to_folder

    typer.echo(reproduce_to_folder(output, overwrite, command_line(), rig))


@app.command()
def benchmark(
    output: Output = Path("results/benchmark"),
    only: Annotated[
        list[str] | None,
        typer.Option(
            "--only",
            help="Group to measure, may be given more than once: kernel, single, vector, cost, solvers, accuracy, "
            "training, beating, memory, start, inference, profile. Without it all.",
        ),
    ] = None,
    quick: Annotated[bool, typer.Option("--quick", help="Fewer sizes and shorter runs, to try it.")] = False,
    resume: Resume = False,
    overwrite: Overwrite = False,
) -> None:
    """Measure speed, memory and start-up on this machine, with other environments and solvers in turn.

    Leaves one table as `benchmark.md` and `benchmark.csv`; every figure is the median of several runs. About a quarter
    of an hour on two quiet cores, `--quick` a few minutes. Ctrl-C keeps what is measured, `--resume` goes on.
    """
    from agents.commands.benchmark import benchmark_to_folder

    with stoppable(True):
        for file in benchmark_to_folder(output, only or [], quick, resume, overwrite, command_line()):
            typer.echo(file)


app.command("train")(train)
app.command("evaluate")(evaluate)
app.command("study")(study)


def main() -> None:
    """Entry point: one clear line and exit code 2 for whatever a user can put right."""
    try:
        code = app(standalone_mode=False, prog_name="hydro")
        sys.exit(code if isinstance(code, int) else 0)
    except _UsageError as error:
        if type(error).__name__ == "NoArgsIsHelpError":  # the help has been asked for, in its way
            error.show()
            sys.exit(2)
        message = " ".join(error.format_message().replace("Value error, ", "").split())
        command = error.ctx.command_path if error.ctx is not None else "hydro"
        print(f"hydro: {message.rstrip('.')}; see {command} --help", file=sys.stderr)
        sys.exit(2)
    except HydroError as error:
        print(f"hydro: {error}", file=sys.stderr)
        sys.exit(2)
    except (KeyboardInterrupt, typer.Abort):  # before a command had begun
        sys.exit(130)
    except OSError as error:
        print(f"hydro: {ConfigurationError(f'{error.filename}: {error.strerror}')}", file=sys.stderr)
        sys.exit(2)


if __name__ == "__main__":
    main()
