"""``hydro benchmark``: measures the groups one after another, each in rounds."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from pathlib import Path

import numba
import torch

from benchmarks.accuracy import accuracy_cases
from benchmarks.environment_rows import kernel_cases, single_cases, vector_cases
from benchmarks.resource_rows import inference_cases, memory_cases, start_cases
from benchmarks.table import FULL, QUICK, Case, Extent, Row, UnavailableError, markdown_table, write_csv, write_markdown
from benchmarks.training_rows import training_cases
from hydro_agents.running.console import ProgressDisplay
from hydro_agents.running.folders import output_folder
from hydro_agents.running.machine import machine_description, package_versions
from hydro_env import ConfigurationError
from hydro_env.mistakes import unknown

FILES = ("benchmark.csv", "benchmark.md")

GROUPS: dict[str, tuple[str, Callable[[Extent], list[Case]]]] = {
    "kernel": ("The bare integrator: plants × control periods of 5 ms per second.", kernel_cases),
    "single": ("One environment through `gym.make`.", single_cases),
    "vector": ("N axes through `gym.make_vec`, info and restarts included.", vector_cases),
    "accuracy": ("Error and time of the integrator over drawn rigs, against Radau (one axis).", accuracy_cases),
    "training": ("PPO of stable-baselines3, end to end, and the shares of its time.", training_cases),
    "memory": ("Memory.", memory_cases),
    "start": ("Start-up, wall time of fresh processes.", start_cases),
    "inference": ("From observation to command on one axis.", inference_cases),
}
"""Title of each group, and the function that lists its cases. The cases take turns, round by round."""


def benchmark_to_folder(folder: Path, only: Sequence[str], quick: bool, overwrite: bool, command: str) -> list[Path]:
    """Measure the groups and write the table; returns its files.

    Raises:
        ConfigurationError: a group is unknown, or the folder cannot be used.
        KeyboardInterrupt: Ctrl-C; the measurements so far have been written.
    """
    for name in only:
        if name not in GROUPS:
            raise ConfigurationError(f"--only {name}: {unknown(name, GROUPS, 'group')}")
    heading, rows = _heading(quick, command), list[Row]()
    titles = {name: title for name, (title, _) in GROUPS.items()}
    table, page = (folder / file for file in FILES)
    with output_folder(folder, "benchmark", FILES, overwrite=overwrite), ProgressDisplay() as display:
        display.console.lines(heading)
        for name in only or GROUPS:
            try:
                measure_group(name, GROUPS[name][1](QUICK if quick else FULL), rows, display)
            finally:
                write_csv(table, rows)
                write_markdown(page, rows, titles, heading)
            display.console.lines(f"{titles[name]}\n\n{markdown_table(rows, name)}\n")
    return [page, table]


def measure_group(group: str, cases: Sequence[Case], rows: list[Row], display: ProgressDisplay) -> None:
    """Measure the cases in turn, round by round, and add their rows."""
    for case in cases:
        for row in case.rows:
            row.group = group
        rows += case.rows
    unavailable: set[int] = set()
    turns = [(run, case) for run in range(max(case.runs for case in cases)) for case in cases if run < case.runs]
    for done, (run, case) in enumerate(turns):
        display.update(group, done, len(turns), case.rows[0].name)
        if id(case) in unavailable:
            continue
        try:
            for row, value in zip(case.rows, case.measure(run), strict=True):
                row.values.append(float(value))
        except (UnavailableError, RuntimeError) as error:
            unavailable.add(id(case))
            for row in case.rows:
                row.note = "; ".join(part for part in (row.note, " ".join(str(error).split())) if part)
    display.update(group, len(turns), len(turns))


def _heading(quick: bool, command: str) -> str:
    versions = ", ".join(f"{name} {version}" for name, version in package_versions().items())
    trial = " A quick trial: its figures are rough." if quick else ""
    return (
        f"`{command}`. {machine_description()}; {versions}. Threads of the vector environment: one per 256 axes, as "
        f"many as cores at most; torch: "
        f"{torch.get_num_threads()}; numba: {numba.get_num_threads()}; OMP_NUM_THREADS: "
        f"{os.environ.get('OMP_NUM_THREADS', 'not set')}. Each figure is the median of its runs; the rows of a group "
        'were measured in turn, round by round, and "beside" is the median of the rounds\' ratios. Compare rows, not '
        f"absolute numbers of another day.{trial}"
    )
