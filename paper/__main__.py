"""``python -m paper``: the same as ``hydro reproduce``."""

import sys

from hydro_agents.commands.launcher import main

sys.argv[1:1] = ["reproduce"]
main()
