"""What is seen while work runs: lines that fit, the time that is left, and no output that ends the work."""

import io
import re

import pytest

from hydro_agents.running.console import PlainConsole, ProgressDisplay

NOTE = "12,345 steps/s, mean reward -0.1234 [v2]"
PHASE = "leakage head, training"
LONG = "tracking, Flow linearisation with the mended PID and a name that is too long for any line at all"


class Terminal(io.StringIO):
    def isatty(self):
        return True


class Clock:
    def __init__(self):
        self.now = 100.0

    def __call__(self):
        return self.now


@pytest.fixture(autouse=True)
def variables(monkeypatch):
    """The variables that tell a program what its terminal can do."""
    for name in ("FORCE_COLOR", "COLUMNS", "TTY_COMPATIBLE", "TTY_INTERACTIVE"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setenv("TERM", "xterm")


def display_on(file, width=80, clock=None):
    console = PlainConsole(file=file, width=width, color_system=None)
    return ProgressDisplay(console, clock=clock or Clock())


def shown(file):
    with display_on(file) as display:
        display.update(PHASE, 0, 2_000_000)
        display.update(PHASE, 2_000_000, 2_000_000, NOTE)
        display.say("written: a[/b]c/results[v2]/:smile:")
    return file.getvalue()


def visible(text):
    """Lines as a terminal shows them, without what moves the cursor."""
    return [line for line in re.split(r"[\r\n]+", re.sub(r"\x1b\[[0-9;?]*[A-Za-z]", "", text)) if line.strip()]


@pytest.mark.parametrize("width", [60, 80])
@pytest.mark.parametrize("file", [Terminal, io.StringIO])
def test_every_line_fits_and_shows_share_and_time(file, width):
    written, clock = file(), Clock()
    with display_on(written, width, clock) as display:
        for done in range(7):
            display.update(LONG, done, 12, NOTE)
            clock.now += 60.0
    lines = visible(written.getvalue())
    assert max(map(len, lines)) <= width
    last = [line for line in lines if line.startswith(LONG[:8])][-1]
    if file is Terminal:
        assert "50 %" in last
        assert "0:06:00" in last  # six more pieces, a minute each
        assert last.count("━") + last.count("╸") == (10 if width == 80 else 5)


@pytest.mark.parametrize("name", ["", "TERM", "FORCE_COLOR"])
def test_where_the_cursor_cannot_move_lines_come_at_once_and_as_they_are(name, monkeypatch):
    monkeypatch.setenv(*{"TERM": ("TERM", "dumb")}.get(name, ("FORCE_COLOR", "1" if name else "")))
    assert visible(shown(Terminal() if name == "TERM" else io.StringIO())) == [
        f"{PHASE}:   0 %, at work for 0.0 s, 0 of 2,000,000",
        f"{PHASE}: 100 %, {NOTE}, 2,000,000 of 2,000,000"[:80],
        "written: a[/b]c/results[v2]/:smile:",
    ]


def left(*updates, total):
    """What a reminder says of the remaining time after some updates (time, pieces done), s after the first of them."""
    written, clock = io.StringIO(), Clock()
    display = display_on(written, clock=clock)
    display.update("done", 1, 1)  # a reminder is about what is still at work
    for time, done in updates:
        clock.now = 100.0 + time
        display.update("work", done, total)
    display.remind()
    return visible(written.getvalue())[-1]


def test_the_remaining_time_follows_from_the_rate_of_the_phase():
    assert left((0, 0), (20, 0), total=100) == "work:   0 %, at work for 20.0 s, 0 of 100", "no rate yet"
    # Imports and compilation come before the first piece: they are no part of the rate.
    assert left((0, 0), (17, 1), (37, 3), total=100) == "work:   3 %, 16 min 10 s left, 3 of 100"
    # A resumed phase counts what it does itself.
    assert left((0, 80), (3, 81), (63, 84), total=100) == "work:  84 %, 5 min 20 s left, 84 of 100"
    assert left((0, 0), (100, 1), (200, 15), total=15) == "work: 100 %, 15 of 15"


class Full(io.StringIO):
    def write(self, text):
        raise OSError(28, "No space left on device")


class Closed(io.StringIO):
    def write(self, text):
        raise BrokenPipeError


def test_work_goes_on_when_nobody_listens():
    for stream in (Full(), Closed()):
        with ProgressDisplay(PlainConsole(file=stream)) as display:
            display.say("one")
            display.update("work", 1, 2)
            display.say("two")
