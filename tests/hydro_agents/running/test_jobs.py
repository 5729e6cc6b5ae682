"""Jobs give the same bits wherever they run; finished ones stay when others are killed; a job knows its code."""

import os
import signal
import warnings
from pathlib import Path

import numpy as np
import pytest
from joblib import effective_n_jobs, parallel_config
from refusal import refused

from hydro_agents.controllers.registry import make_controller
from hydro_agents.evaluation.robustness_protocol import tracked
from hydro_agents.learning.trials import costs_of
from hydro_agents.running import jobs
from hydro_agents.running.jobs import JOBS_FOLDER, Job, answers_of, run_here, run_jobs, workers
from hydro_env import TaskConfig


def root(_, number, fatal):
    """The root of a number, and how many jobs this one may start; the worker of the number 3 can die."""
    if number == 3 and fatal:
        os.kill(os.getpid(), signal.SIGKILL)
    return {"root": np.array([np.sqrt(number)]), "jobs": np.array([effective_n_jobs(None)])}


def roots(fatal=False):
    return {str(number): Job(root, None, (number, fatal), digest="a root") for number in range(8)}


def bits(results):
    return {key: result.metrics["root"].tobytes() for key, result in sorted(results.items())}


@pytest.fixture(scope="module")
def expected():
    return run_jobs(roots(), None, None)


def test_workers_give_the_same_bits_and_a_job_starts_no_others(expected, monkeypatch):
    here = os.pathsep.join([str(Path(__file__).parent), os.environ.get("PYTHONPATH", "")])
    monkeypatch.setenv("PYTHONPATH", here)
    with workers(2), warnings.catch_warnings():
        warnings.simplefilter("error")
        assert effective_n_jobs(None) == 2
        found = run_jobs(roots(), None, None)
        answers = answers_of(roots())  # those that are left early end without a word
        next(answers)
        next(answers)
        answers.close()
    assert bits(found) == bits(expected)
    assert {result.metrics["jobs"].item() for result in found.values()} == {1}


def test_the_cluster_of_a_block_runs_the_jobs_and_stays(expected):
    distributed = pytest.importorskip("distributed")
    options = {"n_workers": 2, "threads_per_worker": 1, "processes": False, "dashboard_address": None}
    with distributed.LocalCluster(**options) as cluster, distributed.Client(cluster) as client:
        with parallel_config("dask", client=client):
            assert effective_n_jobs(None) == 2
            found = run_jobs(roots(), None, None)
        assert client.submit(abs, -2).result() == 2
    assert bits(found) == bits(expected)


def test_a_job_that_is_run_here_is_kept_in_a_folder_and_read_from_there(tmp_path):
    job = roots()["4"]
    run_here(job, tmp_path)
    (file,) = (tmp_path / JOBS_FOLDER).iterdir()
    before = file.stat().st_mtime_ns
    assert run_here(job, tmp_path)["root"] == run_here(job, None)["root"] == 2.0
    assert file.stat().st_mtime_ns == before


def test_after_a_killed_worker_finished_results_are_not_computed_again(tmp_path, expected):
    with workers(2), refused("a worker process was killed .*--resume and a smaller --jobs"):
        run_jobs({**roots(), "3": roots(fatal=True)["3"]}, tmp_path, None)
    kept = {file: file.stat().st_mtime_ns for file in (tmp_path / JOBS_FOLDER).iterdir()}
    assert kept
    found = run_jobs(roots(), tmp_path, None)
    assert {file: file.stat().st_mtime_ns for file in kept} == kept
    assert bits(found) == bits(expected)
    for file in (tmp_path / JOBS_FOLDER).iterdir():  # damaged
        file.write_bytes(file.read_bytes()[:60])
    assert bits(run_jobs(roots(), tmp_path, None)) == bits(expected)


def test_a_job_of_the_rig_package_follows_its_code_too(monkeypatch):
    estimator = pytest.importorskip("hydro_rig.estimation.estimator").EstimatorDetector()
    monkeypatch.setattr(jobs, "digest_of_code", lambda *packages: packages)
    for job in (Job(costs_of), Job(tracked, make_controller("pid", TaskConfig())), Job(root)):
        assert job.code == ("hydro_agents",), job
    assert Job(tracked, estimator).code == ("hydro_agents", "hydro_rig")
