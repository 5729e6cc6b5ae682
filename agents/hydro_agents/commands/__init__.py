"""The command ``hydro``: commands about the same thing share a file."""

import os

# OpenBLAS threads busy-wait for each other. With small matrices and other work running, one thread is ten times faster.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
