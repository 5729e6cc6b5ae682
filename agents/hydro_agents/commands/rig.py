"""``hydro new-rig`` and ``hydro check-rig``: the file of a rig from its nameplates, and the figures of a rig."""

from __future__ import annotations

import inspect
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any

import typer

from hydro_agents.commands.options import Latency, Overwrite, OverwriteFile, Period, Rig, check_new_file, say
from hydro_agents.rigs.questions import QUESTIONS, Question, answers_from, parsed
from hydro_env import ConfigurationError

BACK = "<"  # typed as an answer: asks the question before once more


def _with_an_option_per_question(command: Callable[..., None]) -> Callable[..., None]:
    """The command with one option per question; typer reads them from its signature."""
    own = [
        parameter
        for parameter in inspect.signature(command, eval_str=True).parameters.values()
        if parameter.kind is not inspect.Parameter.VAR_KEYWORD
    ]
    asked = [
        inspect.Parameter(
            question.key,
            inspect.Parameter.KEYWORD_ONLY,
            default=None,
            annotation=Annotated[
                str | None,
                typer.Option(
                    f"--{question.name}",
                    metavar="TEXT" if not question.unit else question.example.replace(" ", ""),
                    help=question.what + (" Required." if question.required else ""),
                    rich_help_panel=question.group.capitalize(),
                ),
            ],
        )
        for question in QUESTIONS
    ]
    made: Any = command
    made.__signature__ = inspect.Signature([*own, *asked])
    made.__annotations__ = {parameter.name: parameter.annotation for parameter in (*own, *asked)}
    return command


@_with_an_option_per_question
def new_rig(
    output: Annotated[Path, typer.Option("--output", "-o", help="YAML file to write.")] = Path("my_rig.yaml"),
    overwrite: OverwriteFile = False,
    **texts: str | None,
) -> None:
    """Write the file of your rig from its nameplates, data sheets and drawings.

    Give figures with their unit: `--bore "63 mm"`. If a required figure is missing, the command asks on a terminal;
    Enter skips what you do not know. The file marks every value as given, computed or assumed, and holds a range for
    every uncertain one. Check it next with `hydro check-rig`.
    """
    from hydro_agents.rigs.new_rig import new_rig as written_rig
    from hydro_env.files import write_text

    check_new_file(output, overwrite)
    given = {key: text for key, text in texts.items() if text is not None}
    required = {question.key for question in QUESTIONS if question.required}
    if not required <= given.keys() and sys.stdin.isatty():
        try:
            _ask([question for question in QUESTIONS if question.key not in given], given)
            text, rig = written_rig(answers_from(given), given, str(output))
        except (ConfigurationError, EOFError, KeyboardInterrupt) as error:
            options = " ".join(f'--{key.replace("_", "-")} "{answer}"' for key, answer in given.items())
            print(f"\nNothing was written. Your answers as options, to go on with: {options}", file=sys.stderr)
            if isinstance(error, EOFError):
                raise ConfigurationError("new-rig: the input has ended") from None
            raise
    else:
        text, rig = written_rig(answers_from(given), given, str(output))
    write_text(output, text)
    say(
        f"{output}: {len(given)} values given, ranges for {len(rig.randomisation)} uncertain ones",
        f"next: hydro check-rig --rig {output}",
    )


def _ask(questions: list[Question], texts: dict[str, str]) -> None:
    """Add the answers that the user types to ``texts``; a skipped question has none."""
    print(f"Give figures with their unit; Enter skips what you do not know, {BACK} goes back to the question before.")
    group, number = "", 0
    while number < len(questions):
        question = questions[number]
        if question.group != group:
            group = question.group
            print(f"\n{group.capitalize()}")
        text = _answer(question)
        texts.pop(question.key, None)
        if text == BACK:
            number = max(number - 1, 0)
            continue
        if text:
            texts[question.key] = text
        number += 1


def _answer(question: Question) -> str:
    """One answer; an unreadable one is asked for again."""
    hint = f"{'required, ' if question.required else ''}such as {question.example}"
    while True:
        text = input(f"  {question.what} ({hint}) ").strip()
        try:
            if text == BACK:
                return text
            if text:
                parsed(question, text)
        except ConfigurationError as error:
            print(f"  {error}")
            continue
        if text or not question.required:
            return text


def check_rig(
    rig: Rig = None,
    output: Annotated[
        Path | None, typer.Option("--output", "-o", help="Folder for check.csv and check.md; default: no files.")
    ] = None,
    overwrite: Overwrite = False,
    period: Period = None,
    latency: Latency = None,
) -> None:
    """Print the figures that an engineer calculates by hand for a rig, and refuse a rig that cannot work.

    The figures are areas, flows, speeds, forces, reach, natural frequency and damping, the largest stable proportional
    gain of the sampled position loop with a tight and a leaking seal and on the worst plant within the rig's ranges,
    gain and phase margin, and the inner steps of the integrator.
    """
    from hydro_agents.rigs.check_table import check_to_console

    files = check_to_console(rig, output, overwrite, period, latency)
    if files:
        say(*files)
