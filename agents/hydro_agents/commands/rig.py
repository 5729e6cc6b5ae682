"""``hydro new-rig`` and ``check-rig``: the file of a rig from its nameplates, and its figures."""

import inspect
import re
import sys
from collections.abc import Sequence
from itertools import groupby
from pathlib import Path
from typing import Annotated

import typer

from hydro_agents.commands.options import Latency, OverwriteFile, Period, Rig, check_new_file, command_line, say
from hydro_agents.rigs.rig_file import QUESTIONS, Question, answers_from, parsed
from hydro_agents.rigs.rig_file import new_rig as written_rig
from hydro_env import ConfigurationError
from hydro_env.files import write_text, write_yaml
from hydro_env.mistakes import refuse_unknown
from hydro_env.task.nameplates import Figures, curve_fit

FLEET_FILE = "fleet.yaml"
POOR_FIT = 0.03  # of full flow: from here on the command tells the difference to a flow curve


def new_rig(
    figures: Annotated[
        list[str] | None,
        typer.Argument(metavar="NAME=VALUE...", help="Figures with their unit, such as bore=63mm 'mass=200 kg'."),
    ] = None,
    table: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE", help="CSV of a fleet, a row per axis: column `axis`, and figures such as `bore [mm]`."
        ),
    ] = None,
    output: Annotated[
        Path | None,
        typer.Option(
            "--output", "-o", help="YAML file, or with --table folder, to write. Default: my_rig.yaml, fleet."
        ),
    ] = None,
    overwrite: OverwriteFile = False,
) -> None:
    """Write the file of your rig from its nameplates, data sheets and drawings.

    Give figures with their unit: `bore=63mm`. If a required figure is missing, the command asks on a terminal;
    Enter skips what you do not know. The file marks every value as given, computed or assumed, and holds a range for
    every uncertain one. Check it next with `hydro check-rig`. `--table` writes the files of many rigs and the
    `fleet.yaml` that `hydro watch` and `hydro trend` read, and says what each axis lacks.
    """
    if table:
        if figures:
            raise ConfigurationError("--table FILE: holds the figures of all axes; give none beside it")
        _write_fleet(table, output or Path("fleet"), overwrite)
        return
    output = output or Path("my_rig.yaml")
    check_new_file(output, overwrite)
    given = _named_figures(figures or [])
    required = {question.key for question in QUESTIONS if question.required}
    asks = not required <= given.keys() and sys.stdin.isatty()
    try:
        if asks:
            _ask([question for question in QUESTIONS if question.key not in given], given)
        answers = answers_from(given)
        text, rig = written_rig(answers, str(output))
    except (ConfigurationError, EOFError, KeyboardInterrupt) as error:
        if asks:
            again = " ".join(f'{key.replace("_", "-")}="{answer}"' for key, answer in given.items())
            print(f"\nNothing was written. Your answers, to go on with: hydro new-rig {again}", file=sys.stderr)
        if isinstance(error, EOFError):
            raise ConfigurationError("new-rig: the input has ended") from None
        raise
    write_text(output, text)
    say(
        f"{output}: {len(given)} values given, ranges for {len(rig.randomisation)} uncertain ones",
        f"next: hydro check-rig --rig {output}",
        *_poor_fit(answers),
    )


def _write_fleet(table: Path, folder: Path, overwrite: bool) -> None:
    """Write the rigs of a table of nameplates, and the file that names them.

    Raises:
        ConfigurationError: the table is none, a file would be replaced, or axes lack figures; the others are written.
    """
    from hydro_agents.rigs.rig_table import figures_of_table

    axes, others = figures_of_table(table)
    files = {axis: re.sub(r"[^\w-]+", "_", axis) + ".yaml" for axis in axes}
    if len({*files.values(), FLEET_FILE}) <= len(files):
        raise ConfigurationError(f"{table}: two axes, or one and {FLEET_FILE}, would have files of the same name")
    for file in (*files.values(), FLEET_FILE):
        check_new_file(folder / file, overwrite)
    if others:
        say(f"columns that are no figures: {', '.join(others)}")
    written, lacking = {}, 0
    for axis, texts in axes.items():
        try:
            answers = answers_from(texts)
            text, rig = written_rig(answers, files[axis])
        except ConfigurationError as error:
            lacking += 1
            say(f"{axis}: not written: {str(error).removeprefix('new-rig: ')}")
            continue
        write_text(folder / files[axis], text)
        written[axis] = {"rig": files[axis]}
        say(
            f"{axis}: {folder / files[axis]}: {len(texts)} values given, ranges for {len(rig.randomisation)}",
            *_poor_fit(answers),
        )
    if written:
        write_yaml(folder / FLEET_FILE, {"axes": written})
        say(f"next: hydro trend RECORDINGS --fleet {folder / FLEET_FILE}")
    if lacking:
        raise ConfigurationError(f"{table}: {lacking} of {len(axes)} axes have no file; complete their rows")


def _poor_fit(figures: Figures) -> list[str]:
    fit = curve_fit(figures)
    if not fit or fit[-1] <= POOR_FIT:
        return []
    return [f"flow-curve: the rig's own differs from it by up to {100 * fit[-1]:.2g} % of full flow"]


def _all_figures() -> str:
    lines = []
    for group, questions in groupby(QUESTIONS, lambda question: question.group):
        names = [f"- `{one.name}={one.example.replace(' ', '')}`: {one.what}" for one in questions]
        lines += [f"\n**{group.capitalize()}**\n", *names]
    return "\n".join(lines)


new_rig.__doc__ = f"{inspect.getdoc(new_rig)}\n{_all_figures()}"


def _named_figures(words: Sequence[str]) -> dict[str, str]:
    """The values of ``NAME=VALUE``, by the keys of the questions.

    Raises:
        ConfigurationError: a word has another form, or its name is unknown or given twice.
    """
    names = {question.name: question.key for question in QUESTIONS}
    given = {}
    for word in words:
        name, _, value = word.partition("=")
        name = name.strip().lstrip("-").replace("_", "-")
        if not value:
            raise ConfigurationError(f"new-rig '{word[:60]}': must be NAME=VALUE, such as bore=63mm")
        refuse_unknown(f"new-rig {word[:60]}", (name,), names, "figure")
        if names[name] in given:
            raise ConfigurationError(f"new-rig {word[:60]}: '{name}' is given twice")
        given[names[name]] = value
    return given


def _ask(questions: list[Question], texts: dict[str, str]) -> None:
    """Add the answers that the user types to ``texts``; a skipped question has none."""
    print("Give figures with their unit; Enter skips what you do not know.")
    for group, asked in groupby(questions, lambda question: question.group):
        print(f"\n{group.capitalize()}")
        for question in asked:
            if text := _answer(question):
                texts[question.key] = text


def _answer(question: Question) -> str:
    """One answer; an unreadable one is asked for again."""
    hint = f"{'required, ' if question.required else ''}such as {question.example}"
    while True:
        text = input(f"  {question.what} ({hint}) ").strip()
        try:
            if text:
                parsed(question, text)
        except ConfigurationError as error:
            print(f"  {error}")
            continue
        if text or not question.required:
            return text


def check_rig(
    rig: Rig = None,
    period: Period = None,
    latency: Latency = None,
    output: Annotated[
        Path | None, typer.Option("--output", "-o", help="Page to write: all figures, Bode and step plots.")
    ] = None,
    overwrite: OverwriteFile = False,
) -> None:
    """Print the figures that an engineer calculates by hand for a rig, and refuse a rig that cannot work.

    The figures are areas, flows, speeds, forces, reach, natural frequency and damping, the largest stable proportional
    gain of the sampled position loop with a tight and a leaking seal and on the worst plant within the rig's ranges,
    and gain and phase margin.
    """
    from hydro_agents.rigs.check_table import check_to_console

    if output:
        check_new_file(output, overwrite)
    found = check_to_console(rig, period, latency)
    if output:
        from hydro_agents.rigs.check_page import check_page
        from hydro_agents.running.machine import Origin

        check_page(*found).write(output, Origin.now(command_line()))
        say(f"page: {output.resolve()}")
