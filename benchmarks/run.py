"""``hydro benchmark``: measures the groups one after another, each in rounds, and saves every finished round."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numba
import torch
from rich.table import Table

from benchmarks.accuracy import accuracy_cases
from benchmarks.environment_rows import cost_cases, single_cases, vector_cases
from benchmarks.kernel_rows import kernel_cases, solver_cases
from benchmarks.resource_rows import inference_cases, memory_cases, start_cases
from benchmarks.table import (
    FULL,
    HEADINGS,
    QUICK,
    Case,
    Extent,
    Row,
    UnavailableError,
    cells,
    read_csv,
    write_csv,
    write_markdown,
)
from benchmarks.training_rows import default_study, training_cases
from hydro_agents.running.console import ProgressDisplay
from hydro_agents.running.folders import output_folder
from hydro_agents.running.machine import machine_description, package_versions
from hydro_env import ConfigurationError
from hydro_env.files import read_yaml, write_yaml
from hydro_env.mistakes import unknown

CSV_FILE = "benchmark.csv"
MARKDOWN_FILE = "benchmark.md"
CIRCUMSTANCES_FILE = "benchmark.yaml"

GROUPS: dict[str, tuple[str, Callable[[Extent], list[Case]]]] = {
    "kernel": ("The bare integrator: plants × control periods of 5 ms per second.", kernel_cases),
    "single": ("One environment through `gym.make`.", single_cases),
    "vector": ("N axes through `gym.make_vec`, info and restarts included.", vector_cases),
    "cost": ("Cost of one step of one axis through `gym.make_vec`, `NextStep`, info included.", cost_cases),
    "solvers": ("The same plant with SciPy's `solve_ivp`, at the accuracy of the integrator.", solver_cases),
    "accuracy": ("Error and time of the integrator over drawn rigs, against Radau (one axis).", accuracy_cases),
    "training": ("PPO of stable-baselines3, end to end, and the shares of its time.", training_cases),
    "memory": ("Memory.", memory_cases),
    "start": ("Start-up, wall time of fresh processes.", start_cases),
    "inference": ("From observation to command on one axis.", inference_cases),
}
"""Title of each group, and the function that lists its cases. The cases take turns, round by round."""


def benchmark_to_folder(
    folder: Path, only: Sequence[str], quick: bool, resume: bool, overwrite: bool, command: str
) -> list[Path]:
    """Measure the groups and write the table; returns its files.

    Raises:
        ConfigurationError: a group is unknown, or the folder cannot be used.
        KeyboardInterrupt: Ctrl-C; the measurements so far have been written.
    """
    for name in only:
        if name not in GROUPS:
            raise ConfigurationError(f"--only {name}: {unknown(name, GROUPS, 'group')}")
    circumstances = {"quick": quick, "machine": machine_description(), "versions": package_versions()}
    heading = _heading(circumstances, command)
    order = list(GROUPS)
    finished: list[str] = []
    rows: list[Row] = []

    def keep() -> None:
        rows.sort(key=lambda row: order.index(row.group))  # stable: the rows of a group keep their order
        write_yaml(folder / CIRCUMSTANCES_FILE, circumstances | {"threads": _threads(), "finished": finished})
        write_csv(folder / CSV_FILE, rows)
        write_markdown(folder / MARKDOWN_FILE, rows, {name: title for name, (title, _) in GROUPS.items()}, heading)

    files = (CSV_FILE, MARKDOWN_FILE, CIRCUMSTANCES_FILE)
    with output_folder(folder, "benchmark", files, resume=resume, overwrite=overwrite), ProgressDisplay() as display:
        if resume:
            finished, rows = _stored(folder, circumstances)
        display.console.lines(heading)
        for name in only or order:
            if name not in finished:
                rows[:] = [row for row in rows if row.group != name]
                measure_group(name, GROUPS[name][1](QUICK if quick else FULL), rows, keep, display)
                finished.append(name)
                keep()
            _show(name, rows, display)
    return [folder / MARKDOWN_FILE, folder / CSV_FILE]


def measure_group(
    group: str, cases: Sequence[Case], rows: list[Row], keep: Callable[[], None], display: ProgressDisplay
) -> None:
    """Measure the cases in turn, round by round; ``keep`` is called after every measurement."""
    unavailable: set[int] = set()
    turns = [(run, case) for run in range(max(case.runs for case in cases)) for case in cases if run < case.runs]
    for done, (run, case) in enumerate(turns):
        display.update(group, done, len(turns), case.rows[0].name)
        if id(case) in unavailable:
            continue
        if run == 0:
            for row in case.rows:
                row.group = group
        try:
            for row, value in zip(case.rows, case.measure(run), strict=True):
                row.values.append(float(value))
        except (UnavailableError, RuntimeError) as error:
            unavailable.add(id(case))
            for row in case.rows:
                row.note = "; ".join(part for part in (row.note, " ".join(str(error).split())) if part)
        if run == 0:
            rows += case.rows
        keep()
    display.update(group, len(turns), len(turns))


def _stored(folder: Path, circumstances: dict[str, Any]) -> tuple[list[str], list[Row]]:
    """Finished groups, and their rows, for --resume."""
    file = folder / CIRCUMSTANCES_FILE
    if not file.exists():
        raise ConfigurationError(f"{folder}: nothing to resume, there is no {CIRCUMSTANCES_FILE}; leave --resume out")
    before = read_yaml(file)
    for key, value in circumstances.items():
        if before.get(key) != value:
            raise ConfigurationError(f"{file}: was measured with another '{key}'; --overwrite begins anew")
    finished = [name for name in GROUPS if name in (before.get("finished") or [])]
    rows = read_csv(folder / CSV_FILE) if finished else []
    return finished, [row for row in rows if row.group in finished]


def _threads() -> str:
    """Number of threads of each part, as text."""
    return (
        f"vector environment: one per 256 axes, as many as cores at most; torch, in training: "
        f"{default_study().ppo.torch_threads}; torch, elsewhere: {torch.get_num_threads()}; "
        f"numba: {numba.get_num_threads()}; OMP_NUM_THREADS: {os.environ.get('OMP_NUM_THREADS', 'not set')}"
    )


def _heading(circumstances: dict[str, Any], command: str) -> str:
    versions = ", ".join(f"{name} {version}" for name, version in circumstances["versions"].items())
    trial = " A quick trial: its figures are rough." if circumstances["quick"] else ""
    return (
        f"`{command}`. {circumstances['machine']}; {versions}. Threads of the {_threads()}. Each figure "
        'is the median of its runs; the rows of a group were measured in turn, round by round, and "beside" is the '
        f"median of the rounds' ratios. Compare rows, not absolute numbers of another day.{trial}"
    )


def _show(group: str, rows: Sequence[Row], display: ProgressDisplay) -> None:
    table = Table(title=GROUPS[group][0], title_justify="left")
    for heading in (*HEADINGS[:4], HEADINGS[5]):
        table.add_column(heading, justify="right" if heading == "median" else "left")
    for row in (row for row in rows if row.group == group):
        line = cells(row, rows)
        table.add_row(*line[:4], line[5] if row.values else row.note)
    display.console.lines(table)
