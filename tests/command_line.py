"""The command line in this process (fast) and in one of its own (signals, pipes, encodings), for tests."""

import contextlib
import io
import os
import signal
import subprocess
import sys
from pathlib import Path
from typing import NamedTuple
from unittest import mock

from hydro_agents.commands import application

ROOT = Path(__file__).parents[1]
COMMAND = (sys.executable, "-m", "hydro_agents.commands.application")


class Answer(NamedTuple):
    """What a command printed, and its exit code."""

    returncode: int
    stdout: str
    stderr: str


def hydro(*arguments, columns=120):
    """Run ``hydro`` in this process; an exception that it lets through fails the test."""
    out, errors, code = io.StringIO(), io.StringIO(), 0
    given, numbers = sys.argv, (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
    handlers = {number: signal.getsignal(number) for number in numbers}
    sys.argv = ["hydro", *map(str, arguments)]
    try:
        with (
            contextlib.redirect_stdout(out),
            contextlib.redirect_stderr(errors),
            mock.patch.dict(os.environ, COLUMNS=str(columns)),
        ):
            application.main()
    except SystemExit as stop:
        code = int(stop.code or 0)
    finally:
        sys.argv = given
        for number, handler in handlers.items():
            signal.signal(number, handler)
    return Answer(code, out.getvalue(), errors.getvalue())


def done(*arguments):
    """Run ``hydro`` in this process; it must succeed."""
    answer = hydro(*arguments)
    assert answer.returncode == 0, answer.stderr
    return answer


def environment(**variables):
    """Variables of a process that runs this checkout."""
    return {
        **os.environ,
        "PYTHONPATH": os.pathsep.join([str(ROOT), str(ROOT / "agents")]),
        "PYTHONUNBUFFERED": "1",
        "COLUMNS": "120",
        **variables,
    }


def hydro_process(*arguments, text=True, **variables):
    """Run ``hydro`` in a process of its own."""
    line = [*COMMAND, *map(os.fsdecode, map(os.fsencode, map(str, arguments)))]
    return subprocess.run(line, capture_output=True, text=text, check=False, env=environment(**variables), cwd=ROOT)


def own_lines(text):
    """Lines of what was printed, without the notice that something is compiled."""
    return [line for line in text.splitlines() if line.strip() and not line.startswith("hydro_env: compiling")]


def assert_one_clear_line(answer, *parts):
    """Exit code 2, and one line that holds the parts."""
    assert answer.returncode == 2, answer.stderr
    lines = own_lines(answer.stderr)
    assert len(lines) == 1, answer.stderr
    assert lines[0].startswith("hydro: ")
    for part in parts:
        assert part in lines[0], lines[0]
