"""Compile everything now, a minute or two, so that every later start loads it in a second: ``make install`` ends so.

Numba keeps the machine code beside the package, or in the folder of the variable ``NUMBA_CACHE_DIR``. It holds for this
processor and this version.
"""

import contextlib
import io
import tempfile
import time

from hydro_agents.commands.application import application

COMMANDS = {
    "an axis under the shipped policy": "record --controller ppo --leakage 1 --duration 6 --output axis.csv",
    "leakage head and estimator": "diagnose axis.csv --output page",
    "identification": "identify axis.csv --rig kovari_2015 --output rig",
}
"""What is compiled, and a command that needs it."""


def main() -> None:
    """Run the commands in a folder that nobody keeps, and print how long each took."""
    with tempfile.TemporaryDirectory() as place, contextlib.chdir(place):
        for what, words in COMMANDS.items():
            began = time.perf_counter()
            command = application(words.split()[0])
            with contextlib.redirect_stdout(io.StringIO()):
                command(words.split(), standalone_mode=False)
            print(f"machine code, {what}: {time.perf_counter() - began:.1f} s", flush=True)


if __name__ == "__main__":
    main()
