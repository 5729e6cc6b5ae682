"""Where jobs run side by side: the cores of this machine, or the workers of a Dask or Ray cluster, through joblib."""

from __future__ import annotations

import logging
import os
import re
import socket
import subprocess
import sys
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from importlib import import_module
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

_PORT = re.compile(r"(?:(?P<scheme>\w+)://)?(?P<host>[^/:\s]+|\[[^]\s]+\]):(?P<port>\d+)")


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
    if address is not None and not BACKENDS[backend]:
        raise ConfigurationError(f"--backend {backend}={address}: takes no address; dask and ray do")
    with ExitStack() as stack:
        begin = {"loky": _loky, "dask": _dask, "ray": _ray}[backend]
        options = begin(jobs, address, stack)
        with parallel_config(backend, **options):
            yield


def _loky(jobs: int | None, address: str | None, stack: ExitStack) -> dict[str, Any]:
    del address, stack
    return {"n_jobs": jobs or cpu_count()}


def _dask(jobs: int | None, address: str | None, stack: ExitStack) -> dict[str, Any]:
    distributed = _package("distributed", "dask")
    for name in ("distributed.shuffle", "distributed.nanny", "distributed.worker", "distributed.scheduler"):
        logging.getLogger(name).setLevel(logging.ERROR)  # a cluster that ends says so in a dozen lines
    if address is None:
        count = jobs or cpu_count()
        address = stack.enter_context(
            distributed.LocalCluster(
                n_workers=count, threads_per_worker=1, dashboard_address=None, silence_logs=logging.ERROR
            )
        )
    else:
        _reach(address, "dask")
    try:
        client = stack.enter_context(distributed.Client(address, timeout=SECONDS))
        client.wait_for_workers(1, timeout=SECONDS)
    except TimeoutError:
        raise ConfigurationError(
            f"--backend dask={address}: the Dask cluster has no worker after {SECONDS} s"
        ) from None
    except (OSError, ValueError) as error:
        raise ConfigurationError(f"--backend dask={address}: is no Dask scheduler: {_first_line(error)}") from None
    return {"client": client, "n_jobs": jobs or -1}


def _ray(jobs: int | None, address: str | None, stack: ExitStack) -> dict[str, Any]:
    ray = _package("ray", "ray")
    quiet: dict[str, Any] = {"logging_level": logging.ERROR, "log_to_driver": False}
    if address is not None:
        _reach(address, "ray")
    try:
        if address is None:
            path = os.pathsep.join(map(os.path.abspath, sys.path))  # its processes begin without it
            ray.init(
                "local",
                num_cpus=jobs or cpu_count(),
                include_dashboard=False,
                runtime_env={"env_vars": {"PYTHONPATH": path}},
                **quiet,
            )
        else:
            ray.init(address, **quiet)
    except (ConnectionError, RuntimeError, ValueError) as error:
        where = f"--backend ray={address}" if address is not None else "--backend ray"
        raise ConfigurationError(f"{where}: Ray did not begin: {_first_line(error)}") from None
    stack.callback(ray.shutdown)
    import_module("ray.util.joblib").register_ray()
    cores = int(ray.cluster_resources().get("CPU", 0))
    if cores < (jobs or 1):
        raise ConfigurationError(f"--jobs {jobs or 1}: the Ray cluster at {address} has {cores} cores")
    return {"n_jobs": jobs or cores}


def _package(name: str, backend: str) -> Any:
    try:
        return import_module(name)
    except ImportError:
        needs = BACKENDS[backend]
        raise ConfigurationError(f"--backend {backend}: is not installed: pip install '{needs}'") from None


def _reach(address: str, backend: str) -> None:
    """Connect and leave, in a process of its own: the clients of clusters try for minutes, or end the process.

    Raises:
        ConfigurationError: the address has no port, or nobody answers there.
    """
    place, found = f"--backend {backend}={address}", _PORT.fullmatch(address)
    if found is None:
        raise ConfigurationError(f"{place}: must be HOST:PORT, such as scheduler:8786 or ray://head:10001")
    try:
        socket.create_connection((found["host"].strip("[]"), int(found["port"])), SECONDS).close()
        line = [sys.executable, "-c", f"import sys; {_TRIALS[backend]}", address]
        trial = subprocess.run(line, capture_output=True, text=True, timeout=SECONDS, check=False)
    except (OSError, OverflowError, UnicodeError) as error:
        raise ConfigurationError(f"{place}: does not answer: {_first_line(error)}") from None
    except subprocess.TimeoutExpired:
        raise ConfigurationError(f"{place}: does not answer as {backend} within {SECONDS} s") from None
    if trial.returncode:
        reason = (trial.stderr.strip() or "no reason given").splitlines()[-1]
        raise ConfigurationError(f"{place}: does not answer as {backend}: {reason}")


def _first_line(error: BaseException) -> str:
    return (str(error).strip() or type(error).__name__).splitlines()[0]
