"""What is seen while work runs: lines as they are, the time that is left, and no output that ends the work."""

import io
from unittest import mock

import pytest

from hydro_agents.running.console import PlainConsole, ProgressDisplay

NOTE = "12,345 steps/s, mean reward -0.1234 [v2]"
PHASE = "leakage head, training"


@pytest.fixture(autouse=True)
def variables(monkeypatch):
    """The variables that tell a program what its terminal can do."""
    for name in ("FORCE_COLOR", "COLUMNS", "TTY_COMPATIBLE", "TTY_INTERACTIVE"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setenv("TERM", "xterm")


def test_off_a_terminal_lines_come_at_once_and_as_they_are(monkeypatch):
    monkeypatch.setenv("FORCE_COLOR", "1")
    file = io.StringIO()
    with ProgressDisplay(PlainConsole(file=file, width=80, color_system=None)) as display:
        display.update(PHASE, 0, 2_000_000)
        display.update(PHASE, 2_000_000, 2_000_000, NOTE)
        display.say("written: a[/b]c/results[v2]/:smile:")
    assert file.getvalue().splitlines() == [
        f"{PHASE}:   0 %, 0 of 2,000,000",
        f"{PHASE}: 100 %, 2,000,000 of 2,000,000, {NOTE}",
        "written: a[/b]c/results[v2]/:smile:",
    ]


@pytest.mark.parametrize("error", [OSError(28, "No space left on device"), BrokenPipeError()])
def test_work_goes_on_when_nobody_listens(error, monkeypatch):
    monkeypatch.setattr(stream := io.StringIO(), "write", mock.Mock(side_effect=error))
    with ProgressDisplay(PlainConsole(file=stream)) as display:
        display.say("one")
        display.update("work", 1, 2)
        display.say("two")
