"""``python -m hydro_env``: the command ``hydro``, where that is not on the path."""

import sys
from importlib import import_module

if __name__ == "__main__":
    sys.argv[0] = "hydro"
    import_module("hydro_agents.commands.launcher").main()
