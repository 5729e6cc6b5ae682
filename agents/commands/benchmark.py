"""``hydro benchmark``: measures group after group, in rounds, and keeps every finished round."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numba
import torch
from rich.table import Table

from agents.benchmark.accuracy_rows import accuracy_cases
from agents.benchmark.environment_rows import cost_cases, single_cases, vector_cases
from agents.benchmark.kernel_rows import kernel_cases
from agents.benchmark.profile_rows import profile_cases
from agents.benchmark.resource_rows import inference_cases, memory_cases, start_cases
from agents.benchmark.solver_rows import solver_cases
from agents.benchmark.table import (
    Case,
    Result,
    UnavailableError,
    markdown_table,
    read_csv,
    write_csv,
    write_markdown,
)
from agents.benchmark.timing import FULL, QUICK, Extent
from agents.benchmark.training_rows import beating_cases, default_study, training_cases
from agents.running.console import ProgressDisplay
from agents.running.folders import output_folder
from agents.running.machine import machine_description, package_versions
from hydro_env import ConfigurationError
from hydro_env.files import read_yaml, write_yaml

CSV_FILE = "benchmark.csv"
MARKDOWN_FILE = "benchmark.md"
CIRCUMSTANCES_FILE = "benchmark.yaml"


class Group(NamedTuple):
    """Rows that are measured in turn, round by round."""

    title: str
    cases: Callable[[Extent], list[Case]]


GROUPS: dict[str, Group] = {
    "kernel": Group("The bare integrator: plants × control periods of 5 ms per second.", kernel_cases),
    "single": Group("One environment through `gym.make`.", single_cases),
    "vector": Group("N axes through `gym.make_vec`, info and restarts included.", vector_cases),
    "cost": Group("Cost of one step of one axis through `gym.make_vec`, `NextStep`, info included.", cost_cases),
    "solvers": Group("The same plant with SciPy's `solve_ivp`, at the accuracy of the integrator.", solver_cases),
    "accuracy": Group(
        "Error of the integrator against Radau over drawn rigs, states and inputs, beside its time (one axis).",
        accuracy_cases,
    ),
    "training": Group("PPO of stable-baselines3, end to end, and where its time goes.", training_cases),
    "beating": Group("Training until PPO's mean error is below the tuned PID's.", beating_cases),
    "memory": Group("Memory.", memory_cases),
    "start": Group("Start-up, wall time of fresh processes.", start_cases),
    "inference": Group("From observation to command on one axis.", inference_cases),
    "profile": Group("Where the time of a step and of a PPO iteration goes.", profile_cases),
}


def benchmark_to_folder(
    folder: Path, only: Sequence[str], quick: bool, resume: bool, overwrite: bool, command: str
) -> list[Path]:
    """Measure the groups and write the table; returns its files.

    Raises:
        ConfigurationError: an unknown group, or a folder that cannot be used.
        KeyboardInterrupt: Ctrl-C; what is measured so far has been written.
    """
    chosen = _chosen(only)
    circumstances = {"quick": quick, "machine": machine_description(), "versions": package_versions()} | thread_counts()
    extent = QUICK if quick else FULL
    heading = _heading(circumstances, command, extent)
    titles = {name: group.title for name, group in GROUPS.items()}

    def keep() -> None:
        order = list(GROUPS)
        results.sort(key=lambda result: order.index(result.group))  # stable: rows keep their order
        write_csv(folder / CSV_FILE, results)
        write_markdown(folder / MARKDOWN_FILE, results, titles, heading)

    files = (CSV_FILE, MARKDOWN_FILE, CIRCUMSTANCES_FILE)
    with output_folder(folder, "benchmark", files, resume=resume, overwrite=overwrite), ProgressDisplay() as display:
        results = _stored(folder, circumstances) if resume else []
        write_yaml(folder / CIRCUMSTANCES_FILE, circumstances)
        display.say(heading)
        for name in chosen:
            if not any(result.group == name for result in results):
                measure_group(name, GROUPS[name].cases(extent), results, keep, display)
            _show(name, results, display)
    return [folder / MARKDOWN_FILE, folder / CSV_FILE]


def measure_group(
    group: str, cases: Sequence[Case], results: list[Result], keep: Callable[[], None], display: ProgressDisplay
) -> None:
    """Measure the cases in turn, round by round; ``keep`` is called after every measurement that adds to the table."""
    own = [[Result(group, row) for row in case.rows] for case in cases]
    missing: set[int] = set()
    total, done = sum(case.runs for case in cases), 0
    results += [result for case_results in own for result in case_results]
    display.update(group, 0, total)
    try:
        for run in range(max(case.runs for case in cases)):
            for number, case in enumerate(cases):
                if run >= case.runs:
                    continue
                if number not in missing:
                    try:
                        for result, value in zip(own[number], case.measure(run), strict=True):
                            result.values.append(float(value))
                    except (UnavailableError, RuntimeError) as error:
                        missing.add(number)
                        for result in own[number]:
                            result.note = " ".join(str(error).split())
                done += 1
                display.update(group, done, total, case.rows[0].name)
                keep()
    except BaseException:
        for result in own_without_values(own):
            results.remove(result)
        keep()
        raise


def own_without_values(own: Sequence[Sequence[Result]]) -> list[Result]:
    """Rows for which nothing was measured and nothing is known to be missing."""
    return [result for rows in own for result in rows if not result.values and not result.note]


def thread_counts() -> dict[str, Any]:
    """How many threads each part may use."""
    return {
        "threads": {
            "cores": os.cpu_count(),
            "vector environment": "one per 256 axes, as many as cores at most",
            "torch, in training": default_study().ppo.torch_threads,
            "torch, elsewhere": torch.get_num_threads(),
            "numba": numba.get_num_threads(),
            "OMP_NUM_THREADS": os.environ.get("OMP_NUM_THREADS", "not set"),
        }
    }


def _chosen(only: Sequence[str]) -> list[str]:
    for name in only:
        if name not in GROUPS:
            raise ConfigurationError(f"--only {name}: unknown group; known: {', '.join(GROUPS)}")
    return [name for name in GROUPS if not only or name in only]


def _stored(folder: Path, circumstances: dict[str, Any]) -> list[Result]:
    """Rows of groups that were measured whole, for --resume."""
    file = folder / CIRCUMSTANCES_FILE
    if not file.exists():
        raise ConfigurationError(f"{folder}: nothing to resume, there is no {CIRCUMSTANCES_FILE}; leave --resume out")
    before = read_yaml(file)
    for key in ("quick", "machine", "versions"):
        if before.get(key) != circumstances[key]:
            raise ConfigurationError(
                f"{file}: was measured with another '{key}'; cannot resume, --overwrite begins anew"
            )
    results = read_csv(folder / CSV_FILE) if (folder / CSV_FILE).exists() else []
    extent = QUICK if circumstances["quick"] else FULL
    whole = []
    for name in {result.group for result in results if result.group in GROUPS}:
        runs = {row.name + row.unit: case.runs for case in GROUPS[name].cases(extent) for row in case.rows}
        own = [result for result in results if result.group == name]
        found = {r.row.name + r.row.unit: len(r.values) for r in own}
        missing = {r.row.name + r.row.unit for r in own if not r.values}
        if all(found.get(key, -1) == count or key in missing for key, count in runs.items()):
            whole.append(name)
    return [result for result in results if result.group in whole]


def _heading(circumstances: dict[str, Any], command: str, extent: Extent) -> str:
    versions = ", ".join(f"{name} {version}" for name, version in circumstances["versions"].items())
    threads = ", ".join(f"{name}: {count}" for name, count in circumstances["threads"].items())
    trial = " A quick trial: its figures are rough." if extent is QUICK else ""
    return (
        f"`{command}`. {circumstances['machine']}; {versions}. Threads: {threads}. Each figure is the median of its "
        'runs; the rows of a group were measured in turn, round by round, and "beside" is the median of the rounds\' '
        f"ratios. Compare rows, not absolute numbers of another day.{trial}"
    )


def _show(group: str, results: Sequence[Result], display: ProgressDisplay) -> None:
    table = Table(title=GROUPS[group].title, title_justify="left")
    for heading in ("what", "unit", "median", "lowest–highest", "beside"):
        table.add_column(heading, justify="right" if heading == "median" else "left")
    for line in markdown_table(results, group).splitlines()[2:]:
        cells = [cell.strip() for cell in line.strip("|").split("|")]
        table.add_row(*cells[:4], cells[5] or ("" if cells[2] != "–" else cells[6]))
    display.console.lines(table)
