"""``hydro record`` and ``score``: simulated recordings, data sets of them, and the benchmark of leak detectors."""

from __future__ import annotations

import contextlib
from collections.abc import Mapping
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from hydro_agents.commands.options import (
    Faults,
    Overwrite,
    OverwriteFile,
    OwnTask,
    PlantSeed,
    Rig,
    check_new_file,
    command_line,
    exact_task,
    say,
    show,
    side_by_side,
)

if TYPE_CHECKING:
    from hydro_env import TaskConfig


@side_by_side
def record(
    output: Annotated[Path | None, typer.Option("--output", "-o", help="CSV file to write.")] = None,
    minari: Annotated[
        str | None,
        typer.Option(
            metavar="NAME-v0",
            help="Minari data set to write instead, for offline learning.",
        ),
    ] = None,
    benchmark: Annotated[
        Path | None,
        typer.Option(metavar="FOLDER", help="Write the benchmark of leaking axes instead: many axes, with labels."),
    ] = None,
    key: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="A text known to nobody else, from which its test recordings follow."),
    ] = None,
    count: Annotated[
        int | None, typer.Option(help="Episodes of a data set, default 100; or recordings of the benchmark, 600.")
    ] = None,
    task: OwnTask = None,
    rig: Rig = None,
    controller: Annotated[
        str,
        typer.Option("--controller", help="A kind (pid, ppo, …), module:attribute, or the path of weights or gains."),
    ] = "pid",
    leakage: Annotated[
        float | None, typer.Option(help="Leak in l/min at 100 bar; default: drawn from the task's ranges.")
    ] = None,
    fault: Faults = None,
    duration: Annotated[
        float | None, typer.Option(help="Length in s; default: 20, or the task's for a data set.")
    ] = None,
    family: Annotated[
        str | None,
        typer.Option(help="Kind of reference, such as sine, step or point_to_point; default: drawn."),
    ] = None,
    seed: PlantSeed = 0,
    overwrite: OverwriteFile = False,
) -> None:
    """Record a simulated axis: time, position, pressures, spool and command as its sensors measure them.

    `hydro diagnose` reads the file. The first line is a comment with this command and the true leak. `--minari` writes
    a data set of episodes instead, with observations, actions, rewards and the hidden leak. `--benchmark` writes the
    public benchmark of leak detectors for `hydro score`, see `docs/benchmark.md`.

    With `--rig` alone the axis has the parameters of its file. With `--task`, for `--minari`, and without `--rig`, the
    task draws the parameters that are not known exactly.
    """
    from hydro_agents.learning.loading import GainsOrigin, load_controller, origin_of_gains, shipped
    from hydro_agents.learning.rig_gains import chosen_gains
    from hydro_agents.running.tasks import named_faults
    from hydro_env import ConfigurationError
    from hydro_env.task.configuration import task_config
    from hydro_env.task.reference_signals import FAMILIES
    from hydro_rig.recordings.simulated import record_axis

    if family is not None and family not in FAMILIES:
        raise ConfigurationError(f"--family '{family}': must be one of {', '.join(FAMILIES)}")
    if sum(place is not None for place in (output, minari, benchmark)) != 1:
        raise ConfigurationError("record: needs one of --output FILE, --minari NAME or --benchmark FOLDER")
    if benchmark is not None:
        if rig is not None:
            raise ConfigurationError("record: --benchmark draws its axes; leave out --rig")
        _record_benchmark(benchmark, task_config(task), 600 if count is None else count, key)
        return
    faults = named_faults(fault or [])
    if minari is not None:
        given = {"leakage_flow_lpm": leakage, "reference": family, "faults": faults or None}
        length: dict[str, Any] = {} if duration is None else {"episode_duration": duration}
        config = task_config(task, rig=rig, **length)
        _record_dataset(minari, config, controller, 100 if count is None else count, seed, given)
        return
    assert output is not None
    check_new_file(output, overwrite)
    usual = task_config(exact_task(task, rig), rig=rig)
    config = task_config(usual, episode_duration=20.0 if duration is None else duration)
    if by_pid := controller == "pid":  # its gains need no episodes as long as the recording
        mover = shipped(controller, config, lambda kind, _: chosen_gains(kind, usual))
    else:
        mover = load_controller(controller, config, "--controller")
    origin = origin_of_gains(controller, config) if by_pid else GainsOrigin.TUNED
    done = record_axis(output, config, mover, seed, leakage, family, faults, command_line())
    end = f"; the axis failed after {done.failed_at:g} s" if done.failed_at is not None else ""
    drawn = f"; parameters of the plant drawn by --seed {seed}" if config.randomisation else ""
    leak = f"leak {done.leakage_flow_lpm:.3g} l/min at 100 bar"
    say(
        *([f"{output}: gains of the PID: {origin}"] if origin != GainsOrigin.TUNED else []),
        f"{output}: {done.rows} rows, {done.duration:g} s, {leak}{drawn}{end}",
    )


def _record_dataset(
    name: str, config: TaskConfig, controller: str, episodes: int, seed: int, given: Mapping[str, Any]
) -> None:
    from hydro_agents.learning.loading import load_controller
    from hydro_agents.running.console import ProgressDisplay
    from hydro_rig.recordings.simulated import check_dataset, record_dataset

    check_dataset(name)
    mover = load_controller(controller, config, "--controller")
    options = {option: value for option, value in given.items() if value is not None}
    with ProgressDisplay() as display:
        report = partial(display.update, "episodes", total=episodes)
        steps, folder = record_dataset(name, config, mover, controller, episodes, seed, options, command_line(), report)
    say(f"{name}: {episodes} episodes, {steps} steps, in {folder}")


def _record_benchmark(folder: Path, config: TaskConfig, recordings: int, key: Path | None) -> None:
    from hydro_agents.running.console import ProgressDisplay
    from hydro_env.files import read_text
    from hydro_rig.challenge.axes import Benchmark
    from hydro_rig.challenge.files import HIDDEN, write_benchmark

    secret = read_text(key).strip() if key is not None else ""
    with ProgressDisplay() as display:
        made = write_benchmark(folder, config, Benchmark(recordings, secret), None, display.update)
    hours = ", ".join(f"{name} {count} ({made['hours'][name]:.3g} h)" for name, count in made["recordings"].items())
    say(f"{folder}: {hours}; README.md describes them; do not publish {folder / HIDDEN}")


def score(
    data: Annotated[Path, typer.Option(metavar="FOLDER", help="The challenge, from `hydro record --benchmark`.")],
    predictions: Annotated[
        list[Path] | None, typer.Argument(metavar="[PREDICTIONS]...", help="Parquet files, one for each detector.")
    ] = None,
    code: Annotated[
        list[Path] | None,
        typer.Option(
            metavar="FOLDER", help="Run the detect.py of this folder on the recordings first; may be repeated."
        ),
    ] = None,
    signals_only: Annotated[
        bool, typer.Option("--signals-only", help="The program of --code gets no nameplates.")
    ] = False,
    split: Annotated[str, typer.Option(help="train, validation or test.")] = "test",
    output: Annotated[
        Path | None, typer.Option("--output", "-o", metavar="FOLDER", help="Also write a page, CSV, and predictions.")
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print all numbers as JSON instead of tables.")] = False,
    overwrite: Overwrite = False,
) -> None:
    """Score anyone's leak detector in the challenge: leaks found, false alarms, delay, causes, calibration.

    A prediction is a table with a row for each look at a recording: recording, time, score, and what else the detector
    says. `--code` runs a program instead, which gets the rows one after another. `docs/benchmark.md` describes both.
    """
    import json

    from hydro_agents.running.console import ProgressDisplay
    from hydro_agents.running.folders import output_folder
    from hydro_agents.running.machine import Origin
    from hydro_env import ConfigurationError
    from hydro_env.files import write_text
    from hydro_rig.challenge.files import HIDDEN, read_table
    from hydro_rig.challenge.score_page import render_scores
    from hydro_rig.challenge.scores import bounds, labels_of, table_of, text_of
    from hydro_rig.challenge.scores import score as scored
    from hydro_rig.challenge.submitted import Run, command_of, run_program

    folders = [folder.absolute() for folder in code or []]
    if not predictions and not folders:
        raise ConfigurationError("score: needs a table of predictions, or --code FOLDER")
    for folder in folders:
        command_of(folder)
    hidden = split == "test" and not (data / HIDDEN).exists() and output and not predictions
    truth = None if hidden else labels_of(data, split)
    writes = ["scores.csv", "scores.html", "figures/*.svg", "predictions/*.parquet"]
    place = output_folder(output, "score", writes, overwrite=overwrite) if output else contextlib.nullcontext()
    with place:
        runs = [(path.stem, Run(read_table(path), [])) for path in predictions or []]
        for folder in folders:
            with ProgressDisplay() as display:
                run = run_program(folder, data, split, signals_only=signals_only, progress=display.update)
            runs.append((folder.name, run))
            if output:
                (output / "predictions").mkdir(exist_ok=True)
                run.predictions.to_parquet(output / "predictions" / f"{folder.name}.parquet", index=False)
        if truth is None:
            remarks = [f"{name}: {remark}" for name, run in runs for remark in run.remarks]
            say(*remarks, f"{output}: predictions; {data} has no labels of the test split, so that nothing is scored")
            return
        scores = []
        for name, run in runs:
            one = scored(name, run.predictions, truth)
            scores.append(one._replace(remarks=[*one.remarks, *run.remarks]))
        scores += bounds(truth)
        table = table_of(scores)
        if output:
            write_text(output / "scores.csv", table.to_csv(index=False))
            render_scores(scores, Origin.now(command_line())).write(output / "scores.html")
    if as_json:
        say(json.dumps(json.loads(table.to_json(orient="records")), indent=2))
    else:
        show(text_of(scores))
