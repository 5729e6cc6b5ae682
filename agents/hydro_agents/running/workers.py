"""Where jobs run side by side: the cores of this machine, or the workers of a Dask cluster, through joblib."""

from __future__ import annotations

import logging
import subprocess
import sys
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from importlib import import_module
from typing import Any

from joblib import cpu_count, parallel_config

from hydro_env import ConfigurationError

BACKENDS = ("loky", "dask")
"""What joblib may pass jobs to; loky: processes on this machine."""

SECONDS = 30
"""A cluster must answer and have a worker within this time."""


@contextmanager
def workers(jobs: int | None = None, backend: str = "loky", address: str | None = None) -> Iterator[None]:
    """Run all jobs of a block on some workers; a cluster that it starts ends with the block.

    Args:
        jobs: number of jobs side by side; ``None``: one per core of this machine, or of the cluster at the address.
        backend: one of :data:`BACKENDS`.
        address: of a running Dask cluster, such as ``scheduler:8786``; ``None`` starts one on this machine.

    Raises:
        ConfigurationError: the backend is unknown or not installed, or the address does not answer.
    """
    if backend not in BACKENDS:
        raise ConfigurationError(f"--backend '{backend}': must be one of {', '.join(BACKENDS)}")
    if address is not None and backend == "loky":
        raise ConfigurationError(f"--backend loky={address}: takes no address; dask does")
    with ExitStack() as stack:
        options: dict[str, Any] = {"n_jobs": jobs or cpu_count()}
        if backend == "dask":
            try:
                options = {"client": _client(jobs, address, stack), "n_jobs": jobs or -1}
            except (OSError, RuntimeError, ValueError) as error:
                reason = (str(error).strip() or type(error).__name__).splitlines()[0]
                where = "" if address is None else f"={address}"
                raise ConfigurationError(f"--backend dask{where}: does not answer as dask: {reason}") from None
        with parallel_config(backend, **options):
            yield


def _client(jobs: int | None, address: str | None, stack: ExitStack) -> Any:
    """Connect to a Dask cluster that has a worker; without an address start one."""
    try:
        distributed = import_module("distributed")
    except ImportError:
        raise ConfigurationError("--backend dask: is not installed: pip install 'dask[distributed]'") from None
    for name in ("shuffle", "nanny", "worker", "scheduler"):  # a cluster that ends says so in a dozen lines
        logging.getLogger(f"distributed.{name}").setLevel(logging.ERROR)
    where: Any = address
    if address is not None:
        _try_out(address)
    else:
        size = {"n_workers": jobs or cpu_count(), "threads_per_worker": 1}
        where = distributed.LocalCluster(**size, dashboard_address=None, silence_logs=logging.ERROR)
        stack.enter_context(where)
    client = stack.enter_context(distributed.Client(where, timeout=SECONDS))
    client.wait_for_workers(1, timeout=SECONDS)
    return client


def _try_out(address: str) -> None:
    """Connect and leave, in a process of its own: beside a port that says nothing, Dask waits without an end."""
    line = [sys.executable, "-c", "import sys; from distributed import Client; Client(sys.argv[1]).close()", address]
    try:
        subprocess.run(line, capture_output=True, text=True, timeout=SECONDS, check=True)
    except subprocess.TimeoutExpired:
        raise OSError(f"not within {SECONDS} s") from None
    except subprocess.CalledProcessError as error:
        raise OSError(error.stderr.strip().splitlines()[-1]) from None
