"""``hydro warm-up``: machine code of everything, made once."""

from __future__ import annotations

import contextlib
import io
import tempfile
import time
from pathlib import Path
from typing import Any

from hydro_agents.commands.options import say

PARTS = {
    "an axis under the shipped policy": "record --controller ppo --leakage 1 --duration 6 --output axis.csv",
    "leakage head and estimator": "diagnose axis.csv --output page",
    "identification": "identify axis.csv --rig kovari_2015 --output rig",
}
"""What is compiled, and a command that needs it."""


def warm_up() -> None:
    """Compile everything now, for an image or an installer: a minute or two; every later start loads it in a second.

    Numba keeps the machine code beside the installed package, or in the folder of the variable `NUMBA_CACHE_DIR`. It
    holds for this processor and this version.
    """
    from hydro_agents.commands.application import application
    from hydro_env.task.kernel import step_axes

    with tempfile.TemporaryDirectory() as place, contextlib.chdir(place):
        for what, command in PARTS.items():
            began = time.perf_counter()
            words = command.split()
            run: Any = application(words[0])
            with contextlib.redirect_stdout(io.StringIO()):
                run(words, standalone_mode=False)
            say(f"{what}: {time.perf_counter() - began:.1f} s")
    say(f"machine code: {Path(step_axes.dispatcher.stats.cache_path or 'kept nowhere, no folder can be written')}")
