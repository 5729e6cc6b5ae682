"""What is seen while work runs: bars that keep their length, lines elsewhere, and no output that ends the work."""

import io

from agents.running.console import PlainConsole, ProgressDisplay

NOTE = "12,345 steps/s, mean reward -0.1234 [v2]"


def shown(width=None):
    text = io.StringIO()
    console = PlainConsole(file=text, force_terminal=width is not None, width=width or 80, color_system=None)
    with ProgressDisplay(console) as display:
        display.update("leakage head, training", 0, 2_000_000)
        display.update("leakage head, training", 2_000_000, 2_000_000, NOTE)
        display.say("written: a[/b]c/results[v2]/:smile:")
    return text.getvalue()


def test_the_bar_keeps_its_length_at_80_columns():
    last = [line for line in shown(80).splitlines() if "100 %" in line][-1]
    assert last.count("━") == 20
    assert NOTE not in last
    assert NOTE[:12] in last
    assert NOTE in [line for line in shown(140).splitlines() if "100 %" in line][-1]


def test_off_a_terminal_lines_come_at_once_and_as_they_are():
    lines = shown().splitlines()
    assert lines[0] == "leakage head, training:   0 % (0 of 2,000,000)"
    assert lines[1] == f"leakage head, training: 100 % (2,000,000 of 2,000,000) {NOTE}"
    assert lines[2] == "written: a[/b]c/results[v2]/:smile:"


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
