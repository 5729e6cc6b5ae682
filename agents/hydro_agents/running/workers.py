"""Where jobs run side by side: the cores of this machine, or the workers of a Dask or Ray cluster, through joblib."""

from __future__ import annotations

import logging
import os
import socket
import subprocess
import sys
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from importlib import import_module
from signal import SIG_IGN, SIGINT, signal
from threading import Thread
from time import sleep
from typing import Any

from joblib import cpu_count, parallel_config

from hydro_env import ConfigurationError

BACKENDS = {"loky": "", "dask": "dask[distributed]", "ray": "ray"}
"""What joblib may pass jobs to, with the package that it needs; loky: processes on this machine."""

SECONDS = 30
"""A cluster must answer and have a worker within this time."""

_TRIALS = {
    "dask": f"from distributed import Client; Client(sys.argv[1], timeout={SECONDS}).close()",
    "ray": "import ray; ray.init(sys.argv[1], log_to_driver=False)",
}


@contextmanager
def workers(jobs: int | None = None, backend: str = "loky", address: str | None = None) -> Iterator[None]:
    """Run all jobs of a block on some workers; a cluster that it starts ends with the block.

    Args:
        jobs: number of jobs side by side; ``None``: one per core of this machine, or of the cluster at the address.
        backend: one of :data:`BACKENDS`.
        address: of a running cluster, such as ``scheduler:8786`` (Dask) or ``ray://head:10001``; ``None`` starts dask
            or ray on this machine.

    Raises:
        ConfigurationError: the backend is unknown or not installed, or the address does not answer.
    """
    if backend not in BACKENDS:
        raise ConfigurationError(f"--backend '{backend}': must be one of {', '.join(BACKENDS)}")
    if address is not None and backend == "loky":
        raise ConfigurationError(f"--backend loky={address}: takes no address; dask and ray do")
    with ExitStack() as stack:
        options: dict[str, Any] = {"n_jobs": jobs or cpu_count(), "initializer": _begin, "initargs": (os.getpid(),)}
        if backend != "loky":
            begin, package = {"dask": _dask, "ray": _ray}[backend], _package(backend)
            where = f"--backend {backend}" if address is None else _reached(address, backend)
            try:
                options = begin(package, jobs, address, stack)
            except ConfigurationError:
                raise
            except (OSError, RuntimeError, ValueError) as error:
                reason = (str(error).strip() or type(error).__name__).splitlines()[0]
                raise ConfigurationError(f"{where}: does not answer as {backend}: {reason}") from None
        with parallel_config(backend, **options):
            yield


def _begin(command: int) -> None:
    """Leave Ctrl-C to the process that started this worker, and end with it: one that was killed says nothing."""

    def watch() -> None:
        while os.getppid() == command:
            sleep(1.0)
        os._exit(1)

    signal(SIGINT, SIG_IGN)
    Thread(target=watch, daemon=True).start()


def _dask(distributed: Any, jobs: int | None, address: str | None, stack: ExitStack) -> dict[str, Any]:
    for name in ("shuffle", "nanny", "worker", "scheduler"):  # a cluster that ends says so in a dozen lines
        logging.getLogger(f"distributed.{name}").setLevel(logging.ERROR)
    where: Any = address
    if address is None:
        size = {"n_workers": jobs or cpu_count(), "threads_per_worker": 1}
        where = distributed.LocalCluster(**size, dashboard_address=None, silence_logs=logging.ERROR)
        stack.enter_context(where)
    client = stack.enter_context(distributed.Client(where, timeout=SECONDS))
    client.wait_for_workers(1, timeout=SECONDS)
    return {"client": client, "n_jobs": jobs or -1}


def _ray(ray: Any, jobs: int | None, address: str | None, stack: ExitStack) -> dict[str, Any]:
    own: dict[str, Any] = {}
    if address is None:
        path = os.pathsep.join(map(os.path.abspath, sys.path))  # its processes begin without it
        own = {"num_cpus": jobs or cpu_count(), "include_dashboard": False}
        own["runtime_env"] = {"env_vars": {"PYTHONPATH": path}}
    ray.init(address or "local", logging_level=logging.ERROR, log_to_driver=False, **own)
    stack.callback(ray.shutdown)
    import_module("ray.util.joblib").register_ray()
    cores = int(ray.cluster_resources().get("CPU", 0))
    if cores < (jobs or 1):
        raise ConfigurationError(f"--jobs {jobs or 1}: the Ray cluster at {address} has {cores} cores")
    return {"n_jobs": jobs or cores}


def _package(backend: str) -> Any:
    try:
        return import_module({"dask": "distributed"}.get(backend, backend))
    except ImportError:
        needs = BACKENDS[backend]
        raise ConfigurationError(f"--backend {backend}: is not installed: pip install '{needs}'") from None


def _reached(address: str, backend: str) -> str:
    """Connect and leave, in a process of its own: the clients of clusters try for minutes, or end the process.

    Returns:
        The option, for messages.

    Raises:
        ConfigurationError: the address has no port, or nobody answers there.
    """
    option = f"--backend {backend}={address}"
    host, _, port = address.rpartition("://")[2].rpartition(":")
    if not host or not port.isdecimal():
        raise ConfigurationError(f"{option}: must be HOST:PORT, such as scheduler:8786 or ray://head:10001")
    try:
        socket.create_connection((host.strip("[]"), int(port)), SECONDS).close()
        line = [sys.executable, "-c", f"import sys; {_TRIALS[backend]}", address]
        subprocess.run(line, capture_output=True, text=True, timeout=SECONDS, check=True)
    except subprocess.SubprocessError as error:
        reason = (getattr(error, "stderr", "") or f"not within {SECONDS} s").strip().splitlines()[-1]
        raise ConfigurationError(f"{option}: does not answer as {backend}: {reason}") from None
    except (OSError, OverflowError, UnicodeError) as error:
        raise ConfigurationError(f"{option}: does not answer: {error}") from None
    return option
