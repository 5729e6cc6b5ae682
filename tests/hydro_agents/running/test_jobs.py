"""A pool that is left early cancels what is under way, and says nothing of its own."""

import warnings

from joblib import Parallel, delayed

from hydro_agents.running.jobs import side_by_side

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
