"""The command ``hydro``: one short file per command."""

import os

# OpenBLAS threads busy-wait for each other. With small matrices and other work running, one thread is ten times faster.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
