"""Record of the finished phases of a study, with which an interrupted study can resume."""

from __future__ import annotations

import json
import time
from collections.abc import Callable
from pathlib import Path
from typing import TypeVar

from hydro_env import ConfigurationError
from hydro_env.files import read_json, write_whole

STATE_FILE = "state.json"
STATE_FORMAT = "hydro_env study, state 1"
Result = TypeVar("Result")


class Phases:
    """Finished phases of a study and their durations, stored in ``state.json``.

    Args:
        folder: folder of the study; the state of an earlier session is read from it.

    Raises:
        ConfigurationError: the state is damaged.
    """

    def __init__(self, folder: Path) -> None:
        self.file = folder / STATE_FILE
        self.seconds: dict[str, float] = {}
        self.done: list[str] = []
        if self.file.exists():
            try:
                state = read_json(self.file)
                if state["format"] != STATE_FORMAT:
                    raise ValueError
                self.seconds = {str(name): float(value) for name, value in state["seconds"].items()}
                self.done = [str(name) for name in state["done"]]
            except (AttributeError, KeyError, TypeError, ValueError):
                raise ConfigurationError(f"{self.file}: is not the state of a study; --overwrite begins anew") from None

    def run(self, name: str, work: Callable[[], Result]) -> Result:
        """Run a phase, and add its duration to the time of earlier sessions."""
        began = time.monotonic()
        try:
            result = work()
            self.done = [*(phase for phase in self.done if phase != name), name]
            return result
        finally:
            self.seconds[name] = round(self.seconds.get(name, 0.0) + time.monotonic() - began, 1)
            state = {"format": STATE_FORMAT, "done": self.done, "seconds": self.seconds}
            write_whole(self.file, json.dumps(state, indent=1).encode())
