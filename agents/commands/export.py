"""``hydro export``: the plant for other tools."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from agents.commands.options import Output, Overwrite, Rig, Task, command_line, say
from hydro_env import ConfigurationError

FMU_FILE = "hydro_axis.fmu"
SOURCES = ("plant.h", "plant.c")


def export(
    what: Annotated[str, typer.Argument(help="plant: the axis as an FMU and as C sources.", show_default=False)],
    output: Output = Path("results/export"),
    task: Task = None,
    rig: Rig = None,
    overwrite: Overwrite = False,
) -> None:
    """Write the plant for Simulink, Amesim, OpenModelica and others, or for your own C program.

    `hydro export plant` writes `hydro_axis.fmu` (FMI 2.0 co-simulation, with the binary of this platform and its
    sources; it needs a C compiler) and `plant.c`, `plant.h` (C99, no library but the mathematical one). Its inputs are
    the voltage of the valve, an external force, the leak and the faults. With `--rig` the parameters are those of your
    rig.
    """
    from agents.code_generation.fmu import make_fmu
    from agents.code_generation.plant_code import plant_code
    from agents.running.folders import output_folder
    from hydro_env.task.configuration import task_config

    if what != "plant":
        raise ConfigurationError(f"export '{what}': unknown; known: plant")
    config = task_config(task, rig=rig)
    with output_folder(output, command_line(), [FMU_FILE, *SOURCES], overwrite=overwrite):
        plant_code(config.plant).write(output)
        (output / FMU_FILE).write_bytes(make_fmu(config))
    say(*(f"written: {output / name}" for name in (FMU_FILE, *SOURCES)))
