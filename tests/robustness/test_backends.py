"""Other backends of joblib give the same bits: Ray and Dask, where they are installed."""

import os

import pandas as pd
import pytest
from command_line import ROOT
from joblib import parallel_config
from small_protocol import small

from hydro_agents.evaluation.participants import participants
from hydro_agents.evaluation.runner import run

# Processes of either backend start without this one's search path.
SEARCHED = os.pathsep.join([str(ROOT), os.environ.get("PYTHONPATH", "")])
CONDITIONS = {"plain": {}, "late": {"task": {"command_latency": 0.004}}}


@pytest.fixture
def alone():
    protocol = small(conditions=CONDITIONS)
    return protocol, run(protocol, participants({"PID": "pid"}, protocol), jobs=1)


def runs_as(alone, folder):
    protocol, expected = alone
    results = run(protocol, participants({"PID": "pid"}, protocol), folder)
    pd.testing.assert_frame_equal(results.part("tracking"), expected.part("tracking"), check_exact=True)
    again = run(protocol, participants({"PID": "pid"}, protocol), folder)
    assert again.reused == len(list((folder / "jobs").iterdir())) > 2
    pd.testing.assert_frame_equal(again.part("tracking"), expected.part("tracking"), check_exact=True)


def test_ray(alone, tmp_path):
    ray = pytest.importorskip("ray")
    from ray.util.joblib import register_ray

    ray.init(num_cpus=2, include_dashboard=False, runtime_env={"env_vars": {"PYTHONPATH": SEARCHED}})
    try:
        register_ray()
        with parallel_config(backend="ray", n_jobs=2):
            runs_as(alone, tmp_path)
    finally:
        ray.shutdown()


def test_dask(alone, tmp_path, monkeypatch):
    distributed = pytest.importorskip("distributed")
    monkeypatch.setenv("PYTHONPATH", SEARCHED)
    with (
        distributed.LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=None) as cluster,
        distributed.Client(cluster),
        parallel_config(backend="dask"),
    ):
        runs_as(alone, tmp_path)
