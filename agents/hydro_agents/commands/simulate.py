"""``hydro simulate``: one open-loop run of a rig."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from hydro_agents.commands.options import Output, Overwrite, Rig, say


class InputSignal(StrEnum):
    """Built-in shapes of the voltage."""

    STEP = "step"
    SINE = "sine"
    SWEEP = "sweep"
    STOP = "stop"


def simulate(
    output: Output = Path("results/simulate"),
    rig: Rig = None,
    signal: Annotated[InputSignal, typer.Option("--input", help="Shape of the voltage.")] = InputSignal.STOP,
    voltage: Annotated[
        float, typer.Option(help="Amplitude in V, −10 to 10, added to the voltage that holds the initial position.")
    ] = 3.0,
    input_file: Annotated[
        Path | None,
        typer.Option(help="CSV with one voltage per sample (column `voltage`, or the last), instead of --input."),
    ] = None,
    duration: Annotated[float, typer.Option(help="Length in s.")] = 1.0,
    sample_time: Annotated[float, typer.Option(help="Time in s for which each voltage is held.")] = 1e-3,
    leakage: Annotated[float | None, typer.Option(help="Leak in l/min at 100 bar, instead of the rig's own.")] = None,
    position: Annotated[
        float | None,
        typer.Option(help="Start at rest, in m from mid-stroke; default: mid-stroke if it can be held."),
    ] = None,
    overwrite: Overwrite = False,
) -> None:
    """Run the rig open loop: states, flows and forces as CSV and as a picture.

    `--input stop` moves at constant voltage and then closes the valve: the quick stop of the paper. Compare
    `--leakage 0.01` with `--leakage 4`: the leak damps the oscillation.
    """
    from hydro_agents.rigs.simulation import simulate_to_folder

    say(
        *simulate_to_folder(
            output, rig, signal.value, voltage, input_file, duration, sample_time, leakage, position, overwrite
        )
    )
