"""Runs somebody's program on recordings whose answers it cannot see, row by row.

The program is ``detect.py`` of a folder, or any executable. It reads text from its standard input and writes to its
standard output, a line each, so that it needs no code of this project and no certain language:

1. For each recording it gets a line of JSON: ``recording``, ``every`` (s between two looks), ``columns``, and, in the
   track that knows the axis, ``axis`` with the figures of its nameplate.
2. Rows follow as CSV, in their order. An empty line asks for a look: the program answers one line of JSON, such as
   ``{"score": 0.7}``, with any of the columns of a prediction, or ``{}`` without an answer.
3. The next line of JSON begins the next recording; the end of the input ends the program.

It gets no row before it has answered the look before, so it cannot see the future.
"""

from __future__ import annotations

import contextlib
import itertools
import json
import os
import selectors
import subprocess
import sys
import time
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pandas as pd

from hydro_agents.running.jobs import Report
from hydro_env import ConfigurationError
from hydro_rig.challenge.files import PLATES, read_public
from hydro_rig.challenge.scores import OPTIONAL
from hydro_rig.recordings.simulated import heading

PROGRAM = "detect.py"
EVERY = 1.0  # s, between two looks
ANSWERS = ("score", *OPTIONAL)


class Limits(NamedTuple):
    """What a program may take."""

    seconds_per_look: float = 10.0  # of the clock, for an answer; the first look of all has START more
    start: float = 60.0
    memory: float = 4.0  # GiB of address space, where the system can limit it


LIMITS = Limits()


class Run(NamedTuple):
    """The predictions of a program, and what went wrong, a line each."""

    predictions: pd.DataFrame
    remarks: list[str]


class _GoneError(Exception):
    """The program ended, or is too slow; with the reason."""


def run_program(
    folder: Path,
    data: Path,
    split: str,
    limits: Limits = LIMITS,
    signals_only: bool = False,
    progress: Report | None = None,
) -> Run:
    """Run a program on every recording of a split.

    A program that crashes or takes too long is started again for the next recording; the rest of the present one has
    no answer. A line that is no answer counts as none.

    Args:
        folder: with ``detect.py``, or an executable of this name without its ending.
        data: the challenge; labels are not read.
        split: its name.
        limits: of time and memory.
        signals_only: whether the program gets no nameplates.
        progress: called after each recording.

    Raises:
        ConfigurationError: there is no program, or the challenge is not as it was written.
    """
    command = command_of(folder)
    plates = read_public(data, PLATES).set_index("axis", drop=False)
    recordings = read_public(data, split).groupby("recording", sort=True)
    looks: list[dict[str, Any]] = []
    remarks: list[str] = []
    program = _Program(command, folder, limits)
    try:
        for done, (number, rows) in enumerate(recordings, 1):
            head: dict[str, Any] = {"recording": int(str(number)), "every": EVERY}
            if not signals_only:
                head["axis"] = plates.loc[rows["axis"].iloc[0]].dropna().to_dict()  # the figures that the axis has
            try:
                for look in program.answers(head, rows.drop(columns=["recording", "axis"])):
                    looks.append({"recording": number, **look})
            except _GoneError as reason:
                remarks.append(f"recording {number}: {reason}; no answer from there on")
            if progress is not None:
                progress("recordings", done, len(recordings))
    finally:
        program.end()
    table = pd.DataFrame(looks, columns=["recording", "time", *ANSWERS])
    answered = [name for name in OPTIONAL if table[name].notna().any()]
    return Run(table[["recording", "time", "score", *answered]], [*remarks, *program.remarks])


def command_of(folder: Path) -> list[str]:
    """The command that starts the program of a folder.

    Raises:
        ConfigurationError: there is none.
    """
    script, binary = folder / PROGRAM, folder / Path(PROGRAM).stem
    if script.is_file():
        return [sys.executable, str(script.absolute())]
    if binary.is_file() and os.access(binary, os.X_OK):
        return [str(binary.absolute())]
    raise ConfigurationError(f"--code {folder}: has no {PROGRAM}, and no executable '{binary.name}'")


class _Program:
    """A process that answers looks; it starts when it is needed."""

    def __init__(self, command: list[str], folder: Path, limits: Limits) -> None:
        self.command, self.folder, self.limits = command, folder, limits
        self.remarks: list[str] = []
        self._process: subprocess.Popen[bytes] | None = None
        self._read_so_far = b""

    def answers(self, head: Mapping[str, Any], rows: pd.DataFrame) -> Iterator[dict[str, Any]]:
        """Give a recording to the program; its looks with their times (s)."""
        seconds = self.limits.seconds_per_look + (self.limits.start if self._process is None else 0.0)
        times = rows[heading("time")].to_numpy()
        text = rows.to_csv(index=False, header=False, lineterminator="\n", float_format="%.7g").splitlines()
        lines = [json.dumps({**head, "columns": list(rows.columns)})]
        ends = np.searchsorted(times, np.arange(EVERY, times[-1] + EVERY, EVERY) - 1e-9)
        for first, last in itertools.pairwise(np.unique([0, *ends])):
            answer = self._ask([*lines, *text[first:last], ""], seconds)
            yield {"time": float(times[last - 1]), **self._checked(answer, f"recording {head['recording']}")}
            lines, seconds = [], self.limits.seconds_per_look

    def _ask(self, lines: list[str], seconds: float) -> bytes:
        process = self._running()
        assert process.stdin is not None
        try:
            process.stdin.write("\n".join([*lines, ""]).encode())
            process.stdin.flush()
            return self._line(seconds)
        except (BrokenPipeError, EOFError):
            self.end()
            raise _GoneError(f"the program ended with code {process.returncode}") from None
        except TimeoutError:
            self.end()
            raise _GoneError(f"no answer within {seconds:g} s") from None

    def _line(self, seconds: float) -> bytes:
        """The next line of the program; what it wrote unasked after it does not count."""
        assert self._process is not None
        assert self._process.stdout is not None
        number, ends = self._process.stdout.fileno(), time.monotonic() + seconds
        with selectors.DefaultSelector() as selector:
            selector.register(number, selectors.EVENT_READ)
            while b"\n" not in self._read_so_far:
                if not selector.select(max(ends - time.monotonic(), 0.0)):
                    raise TimeoutError
                part = os.read(number, 1 << 16)
                if not part:
                    raise EOFError
                self._read_so_far += part
        line, _, more = self._read_so_far.partition(b"\n")
        self._read_so_far = b""
        if more:
            self._remark(f"'{more[:40].decode(errors='replace').strip()}' is a second answer to one look")
        return line

    def _checked(self, line: bytes, where: str) -> dict[str, Any]:
        """The columns of an answer; none if it is no answer."""
        try:
            answer = json.loads(line)
            known = {name: answer[name] for name in ANSWERS if answer.get(name) is not None}
            return known | {name: float(value) for name, value in known.items() if name not in ("alarm", "cause")}
        except (ValueError, TypeError, AttributeError):
            self._remark(f"{where}: '{line[:40].decode(errors='replace')}' is no answer")
            return {}

    def _remark(self, text: str) -> None:
        if len(self.remarks) < 3:  # the first ones tell enough
            self.remarks.append(f"{text}; such lines do not count")

    def _running(self) -> subprocess.Popen[bytes]:
        if self._process is None:
            self._read_so_far = b""
            limit = self._limit if os.name == "posix" else None
            pipe = subprocess.PIPE
            self._process = subprocess.Popen(self.command, cwd=self.folder, stdin=pipe, stdout=pipe, preexec_fn=limit)
        return self._process

    def _limit(self) -> None:
        import resource

        size = int(self.limits.memory * 2**30)
        resource.setrlimit(resource.RLIMIT_AS, (size, size))

    def end(self) -> None:
        """Close its input, wait shortly, and stop the process."""
        process, self._process = self._process, None
        if process is None:
            return
        with contextlib.suppress(BrokenPipeError, subprocess.TimeoutExpired):
            process.communicate(timeout=1.0)
        if process.poll() is None:
            process.kill()
            process.wait()
