"""Workers of every backend give the same bits, also when one is killed; what cannot begin says so in one line."""

import importlib.util
import os
import signal
import socket
from pathlib import Path

import numpy as np
import pytest
from command_line import assert_one_clear_line, hydro
from joblib import effective_n_jobs
from refusal import refused

from hydro_agents.running import jobs as running
from hydro_agents.running import workers as places
from hydro_agents.running.jobs import Job, run_jobs
from hydro_agents.running.workers import workers

PACKAGES = {"loky": "joblib", "dask": "distributed", "ray": "ray"}
installed = [
    pytest.param(name, marks=pytest.mark.skipif(not importlib.util.find_spec(package), reason=f"{package}: none here"))
    for name, package in PACKAGES.items()
]


def root(_, number, folder, fatal):
    """The root of a number; the worker of a fatal one dies as often as it says."""
    before = len(list(Path(folder).iterdir()))
    if number == 3 and before < fatal:
        (Path(folder) / str(before)).touch()
        os.kill(os.getpid(), signal.SIGKILL)
    return {"root": np.array([np.sqrt(number)])}


def roots(folder, fatal=0):
    return {str(number): Job(root, None, (number, str(folder), fatal)) for number in range(8)}


@pytest.mark.parametrize("backend", installed)
def test_a_killed_worker_changes_no_bit(backend, tmp_path, monkeypatch):
    here = os.pathsep.join([str(Path(__file__).parent), os.environ.get("PYTHONPATH", "")])
    monkeypatch.setenv("PYTHONPATH", here)
    expected, _ = run_jobs(roots(tmp_path), None, None, None)
    with workers(2, backend):
        assert effective_n_jobs(None) == 2
        found, _ = run_jobs(roots(tmp_path, fatal=1), None, None, None, at_once=True)
    assert [path.name for path in tmp_path.iterdir()] == ["0"]  # one was killed
    assert {key: result.metrics["root"].tobytes() for key, result in found.items()} == {
        key: result.metrics["root"].tobytes() for key, result in expected.items()
    }


def test_workers_that_are_killed_again_and_again_end_the_command(tmp_path):
    with workers(2), refused(r"killed 4 times .*give a smaller --jobs"):
        run_jobs(roots(tmp_path, fatal=99), None, None, None, at_once=True)
    assert len(list(tmp_path.iterdir())) == running.MOST_KILLED + 1


def nested(_, number):
    """How many jobs a job may start."""
    return {"jobs": np.array([effective_n_jobs(None)])}


def test_all_cores_are_the_default_and_a_job_starts_no_others(monkeypatch):
    with workers(2):
        found, _ = run_jobs({str(number): Job(nested, None, (number,)) for number in range(4)}, None, None, None)
    assert [result.metrics["jobs"].item() for result in found.values()] == [1, 1, 1, 1]
    monkeypatch.setattr(places, "cpu_count", lambda: 64)
    for wanted, jobs in ((None, 64), (3, 3)):
        with workers(wanted):
            assert effective_n_jobs(None) == jobs


def test_a_worker_with_other_code_is_refused(monkeypatch):
    monkeypatch.setattr(running, "digest_of_code", lambda *rooms: "another")
    with workers(2), refused("has another version of hydro_env"):
        run_jobs({str(number): Job(nested, None, (number,)) for number in range(4)}, None, None, None)


COMMANDS = ("study", "evaluate", "alarms", "train pid", "trend data", "record")


@pytest.mark.parametrize(
    ("command", "options", "words"),
    [
        *((command, "--backend slurm", "--backend 'slurm': must be one of loky, dask, ray") for command in COMMANDS),
        ("evaluate", "--backend loky=head:1", "--backend loky=head:1: takes no address; dask and ray do"),
        ("evaluate", "--jobs 0", "--jobs"),
    ],
)
def test_every_long_command_has_the_options(command, options, words):
    assert_one_clear_line(hydro(*command.split(), *options.split()), words)


@pytest.mark.parametrize("backend", ["dask", "ray"])
def test_what_is_not_installed_is_named(backend, monkeypatch):
    def missing(name):
        raise ModuleNotFoundError(name)

    monkeypatch.setattr(places, "import_module", missing)
    needed = f"--backend {backend}: is not installed: pip install '{backend}"
    assert_one_clear_line(hydro("evaluate", "--backend", backend), needed)


@pytest.mark.parametrize("backend", ["dask", "ray"])
def test_an_address_that_does_not_answer_ends_the_command(backend, monkeypatch):
    pytest.importorskip(PACKAGES[backend])
    line = ("evaluate", "--backend")
    assert_one_clear_line(hydro(*line, f"{backend}=scheduler"), f"--backend {backend}=scheduler: must be HOST:PORT")
    with socket.create_server(("127.0.0.1", 0)) as silent:
        place = f"{backend}=127.0.0.1:{silent.getsockname()[1]}"
        monkeypatch.setattr(places, "SECONDS", 3)
        failed = f"--backend {place}: does not answer"
        assert_one_clear_line(hydro(*line, place), f"{failed} as {backend}: not within 3 s")
    assert_one_clear_line(hydro(*line, place), failed)


def test_a_running_cluster_is_used_and_stays(tmp_path):
    distributed = pytest.importorskip("distributed")
    options = {"n_workers": 2, "threads_per_worker": 1, "dashboard_address": None}
    with distributed.LocalCluster(**options) as cluster, distributed.Client(cluster) as client:
        address = cluster.scheduler_address.removeprefix("tcp://")
        with workers(None, "dask", address):
            assert effective_n_jobs(None) == 2
            found, _ = run_jobs(roots(tmp_path), None, None, None, at_once=True)
        assert client.submit(abs, -2).result() == 2
    assert len(found) == 8
