"""The command ``hydro``: one short file per command."""

import os

# Threads of OpenBLAS wait actively for each other: on small matrices, beside other work, one is ten times faster.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
