"""The command ``hydro``: simulate the axis, train controllers, evaluate them, or run a whole study."""

import contextlib
import inspect
import os
import re
import signal
import sys
import warnings
from importlib import import_module
from importlib.util import find_spec
from typing import Annotated, Any, NoReturn

import typer
from typer.core import TyperGroup

from hydro_agents.running.console import discard_output
from hydro_env import HydroError, __version__
from hydro_env.folders import page

# Some versions of typer use click, others their own copy of it; this line works with both.
_UsageError: type[Any] = typer.BadParameter.__mro__[1]
_formatwarning: Any = warnings.formatwarning


class _Commands(TyperGroup):
    """A group of commands; after a signal it ends with one line."""

    def invoke(self, ctx: Any) -> Any:
        try:
            return super().invoke(ctx)
        except KeyboardInterrupt as stop:  # typer would end the program without a message
            number = stop.args[0] if stop.args else signal.SIGINT
            _end(128 + number, "; ".join(["stopped", *getattr(stop, "__notes__", [])]))


HELP = """A hydraulic servo axis whose piston seal may leak: simulate it, learn to control it, detect the leak.

Begin with `hydro study` (the whole job; it soon says how many minutes it takes on your machine), or with
`hydro check-rig` (the figures of an axis, half a minute). Leaks are in l/min at 100 bar across the piston, as in
practice: up to 0.03 is healthy, 1 to 4 is severe."""

GROUPS = {
    "Controllers": {
        "study": "hydro_agents.commands.study:study",
        "train": "hydro_agents.commands.study:train",
        "evaluate": "hydro_agents.commands.evaluate:evaluate",
    },
    "A rig": {
        "new-rig": "hydro_agents.commands.rig:new_rig",
        "check-rig": "hydro_agents.commands.rig:check_rig",
        "record": "hydro_rig.commands.recording:record",
        "identify": "hydro_rig.commands.recording:identify",
        "export": "hydro_rig.commands.export:export",
        "rehearse": "hydro_rig.commands.export:rehearse",
    },
    "The leak": {
        "diagnose": "hydro_rig.commands.diagnosing:diagnose",
        "leak-test": "hydro_rig.commands.diagnosing:leak_test",
        "watch": "hydro_rig.commands.diagnosing:watch",
        "trend": "hydro_rig.commands.diagnosing:trend",
    },
}
"""All commands under the headings of the help: by name the module and its function."""


def application(only: str = "") -> typer.Typer:
    """The whole application, or one with a single command: the modules of the others are not loaded."""
    app = typer.Typer(
        name="hydro",
        cls=_Commands,
        no_args_is_help=True,
        rich_markup_mode="markdown",
        pretty_exceptions_enable=False,
        add_completion=False,
        context_settings={"help_option_names": ["-h", "--help"]},
        help=HELP,
    )
    app.callback()(common)
    for heading, commands in GROUPS.items():
        for name, place in commands.items():
            module, _, function = place.partition(":")
            if only == name or (not only and find_spec(module.split(".")[0])):
                command = getattr(import_module(module), function)
                text = re.sub(r"docs/(\w+\.md)", lambda found: page(found[1]), inspect.getdoc(command) or "")
                app.command(name, rich_help_panel=heading, help=text)(command)
    return app


def _print_version(wanted: bool) -> None:
    if wanted:
        typer.echo(f"hydro_env {__version__}")
        raise typer.Exit


def common(
    version: Annotated[
        bool, typer.Option("--version", callback=_print_version, is_eager=True, help="Print the version and exit.")
    ] = False,
) -> None:
    """Options of all commands."""


def main() -> None:
    """Entry point: one line and exit code 2 for an error that the user can correct; 128 + number after a signal."""
    _prepare_streams()
    warnings.formatwarning = _warning
    for name in ("SIGTERM", "SIGHUP"):
        number = getattr(signal, name, None)
        if number and signal.getsignal(number) == signal.SIG_DFL:  # nohup stays nohup
            signal.signal(number, _stop)
    try:
        known = {name for commands in GROUPS.values() for name in commands}
        app = application(next((word for word in sys.argv[1:2] if word in known), ""))
        code = app(standalone_mode=False, prog_name="hydro")
        sys.exit(code if isinstance(code, int) else 0)
    except SystemExit as stop:
        if isinstance(stop.__context__, BrokenPipeError):  # typer's answer to `hydro --help | head -1`
            discard_output()
            sys.exit(141)
        raise
    except _UsageError as error:
        if type(error).__name__ == "NoArgsIsHelpError":  # the user typed `hydro` alone
            error.show()
            sys.exit(2)
        message = error.format_message().replace("Value error, ", "").replace("Input should", "must").rstrip(".")
        command = error.ctx.command_path if error.ctx else "hydro"
        _end(2, f"{message}; see {command} --help")
    except HydroError as error:
        _end(2, str(error))
    except (KeyboardInterrupt, typer.Abort):  # before a command had begun
        sys.exit(130)
    except BrokenPipeError:  # the reader has closed the pipe, as in `hydro check-rig | head -1`
        discard_output()
        sys.exit(141)
    except OSError as error:
        discard_output()
        _end(2, f"{error.filename}: {error.strerror}" if error.filename else str(error.strerror or error))
    except MemoryError:
        _end(2, "not enough memory for this size")
    finally:
        for number in (signal.SIGINT, signal.SIGTERM):  # while the workers end, nothing is left to keep
            signal.signal(number, signal.SIG_DFL)


def _prepare_streams() -> None:
    """Escape characters that the terminal cannot show; replace a closed stream by an empty one."""
    if not sys.stdin:
        sys.stdin = open(os.devnull, encoding="utf-8")  # noqa: SIM115
    for name in ("stdout", "stderr"):
        stream = getattr(sys, name)
        if not stream:
            setattr(sys, name, open(os.devnull, "w", encoding="utf-8"))  # noqa: SIM115
        elif hasattr(stream, "reconfigure"):
            stream.reconfigure(errors="backslashreplace")


def _warning(message: object, category: type[Warning], *place: Any, **line: Any) -> str:
    """A warning of this project as one line, without the place in its code."""
    return f"hydro: {message}\n" if category is UserWarning else _formatwarning(message, category, *place, **line)


def _stop(number: int, frame: object) -> None:
    """End the program; finished work is kept as after Ctrl-C."""
    raise KeyboardInterrupt(number)


def _end(code: int, message: str) -> NoReturn:
    """End with a message on standard error, without characters that would move a cursor and without endless words."""
    short = re.sub(r"(\S{200})\S{300,}", r"\1…", message)
    shown = "\n".join(
        "".join(letter if letter.isprintable() else ascii(letter)[1:-1] for letter in line)
        for line in re.split(r"\n(?=  )", short)  # a list of mistakes has one indented line each
    )
    with contextlib.suppress(OSError):
        print(f"hydro: {shown}", file=sys.stderr)
    sys.exit(code)


if __name__ == "__main__":
    main()
