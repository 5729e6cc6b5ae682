"""A pool that is left early cancels what is under way, and says nothing of its own; a job knows its code."""

import warnings

from joblib import Parallel, delayed

from hydro_agents.controllers.registry import make_controller
from hydro_agents.evaluation.experiments import measured
from hydro_agents.learning.tuning import cost_candidates
from hydro_agents.running import jobs
from hydro_agents.running.jobs import Job, side_by_side
from hydro_env import TaskConfig
from hydro_rig.estimation.estimator import EstimatorDetector
from hydro_rig.estimation.information import bound_of_windows
from hydro_rig.monitoring import alarm_simulation

CALLS = [delayed(abs)(-number) for number in range(50)]


def pool(calls):
    """Joblib's, as it is when calls are under way."""
    try:
        for function, arguments, _ in calls:
            yield function(*arguments)
    except GeneratorExit:
        warnings.warn("2 tasks which were still being processed by the workers have been cancelled.", stacklevel=2)
        raise


def left_early(answers):
    """Warnings of a generator that is closed after its first answer."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        assert next(answers) == 0
        answers.close()
    return len(caught)


def test_what_a_stop_cancels_is_no_warning():
    assert left_early(pool(CALLS)) == 1
    assert left_early(side_by_side(pool, CALLS)) == 0


def test_all_answers_come():
    parallel = Parallel(n_jobs=2, backend="threading", return_as="generator_unordered")
    assert sorted(side_by_side(parallel, CALLS)) == list(range(50))


def test_a_job_follows_the_code_that_it_uses(monkeypatch):
    monkeypatch.setattr(jobs, "digest_of_code", lambda *rooms: rooms)
    for job, highest in (
        (Job(cost_candidates), "hydro_agents/learning"),
        (Job(measured), "hydro_agents/evaluation"),
        (Job(measured, make_controller("pid", TaskConfig())), "hydro_agents/evaluation"),
        (Job(measured, EstimatorDetector({})), "hydro_rig/estimation"),
        (Job(bound_of_windows), "hydro_rig/estimation"),
        (Job(alarm_simulation.simulated), "hydro_rig/monitoring"),
        (Job(pool), "hydro_agents/evaluation"),  # of a user
    ):
        assert job.code == jobs.ROOMS[: jobs.ROOMS.index(highest) + 1], job
