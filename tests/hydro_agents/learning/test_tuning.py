"""Tuning lowers the cost, repeats and resumes bit-equal; what cannot be made or fails is a bad candidate."""

import numpy as np
import pytest
import yaml
from proportional import Constant
from refusal import refused

from hydro_agents.commands.study import train
from hydro_agents.controllers import PID, PIDGains
from hydro_agents.controllers.registry import make_controller
from hydro_agents.learning import tuning
from hydro_agents.learning.trials import JUDGED, REFUSED, costs_of, mean_logarithm, resting_cases, tuning_cases
from hydro_agents.learning.tuning import Search, tune
from hydro_agents.running.cases import run_cases
from hydro_agents.running.jobs import JOBS_FOLDER
from hydro_env import TaskConfig
from hydro_env.files import read_yaml
from hydro_env.plant.analysis import speed_limits
from hydro_env.task.configuration import task_config

SHORT = TaskConfig(episode_duration=0.3)
SMALL = Search(PIDGains(), evaluations=6, cases=7, population=6)


@pytest.fixture(autouse=True)
def short_rest(monkeypatch):
    """Short resting cases: the tests ask how the search goes, not what it finds."""
    monkeypatch.setattr(tuning, "REST", 1.6)


def test_the_search_improves_the_cost(tmp_path):
    seen = []
    search = SMALL._replace(evaluations=18, separable=True)  # alike on every processor
    best = tune("pid", [SHORT], search, tmp_path, seen.append)
    assert [one.evaluations for one in seen] == [6, 12, 18]
    assert seen[-1].cost < seen[0].cost
    assert (seen[-1].gains, seen[-1].cost) == (best.gains, best.cost)
    assert best.cost == min(costed["costs"].min() for costed in kept(tmp_path).values())


def kept(folder):
    """The costs of the generations that a folder keeps, by the names of their files."""
    return {file.name: dict(np.load(file)) for file in (folder / JOBS_FOLDER).iterdir()}


def test_of_several_tasks_the_geometric_mean_counts():
    tasks = [SHORT, TaskConfig(episode_duration=0.3, control_period=0.01)]
    best = tune("pid", tasks, SMALL)
    found = []
    for number, task in enumerate(tasks):
        still, pid = task_config(task, episode_duration=tuning.REST), [PID(best.gains, task)]
        cases = tuning_cases(task, 7, number), resting_cases(number)
        found += [*mean_logarithm([costs_of(task, cases[0], pid), costs_of(still, cases[1], pid, JUDGED)], cases)]
    assert best.cost == pytest.approx(np.exp(np.mean(found)))


def test_a_stopped_search_goes_on_bit_equal_and_another_one_begins_anew(tmp_path):
    search = SMALL._replace(evaluations=18, separable=True)  # alike on every processor
    whole = tune("pid", [SHORT], search, tmp_path / "whole")

    def stop(best):
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        tune("pid", [SHORT], search, tmp_path / "parts", stop)
    assert len(kept(tmp_path / "parts")) == 1
    assert tune("pid", [SHORT], search, tmp_path / "parts") == whole
    np.testing.assert_equal(kept(tmp_path / "parts"), kept(tmp_path / "whole"))
    longer = TaskConfig(episode_duration=0.4)
    for task, other in ((SHORT, SMALL._replace(seed=1)), (SHORT, SMALL._replace(cases=14)), (longer, SMALL)):
        before = len(kept(tmp_path / "whole"))
        tune("pid", [task], other, tmp_path / "whole")
        assert len(kept(tmp_path / "whole")) == before + 1


def test_costs_are_error_and_price_of_the_same_cases_for_every_candidate():
    cases = tuning_cases(SHORT, 14)
    pid = PID(PIDGains(proportional=200.0), SHORT)
    costs = costs_of(SHORT, cases, [pid, Constant(), pid])
    run = run_cases(SHORT, pid, cases)
    error = np.abs(run.reference.astype(float) - run.position - run.position_bias[:, None]).mean(axis=1)
    changes = np.diff(run.command.astype(float), axis=1) ** 2
    price = 3e-3 * np.mean(speed_limits(SHORT.plant)) * changes.sum(axis=1) / SHORT.steps
    np.testing.assert_array_equal(costs[0], costs[2])
    assert (costs[0] >= error + price - 1e-8).all()  # the first change is not in the run
    np.testing.assert_allclose(costs[0], error + price, atol=2e-6)
    logarithm = mean_logarithm([costs], [cases])[0]
    means = [costs[0][cases.families == name].mean() for name in dict.fromkeys(cases.families)]
    assert logarithm == pytest.approx(np.mean(np.log(means)))


def test_an_oscillation_at_rest_costs_although_it_hardly_shows_while_the_axis_moves():
    task = TaskConfig(episode_duration=0.6)
    calm, stiff = (PID(PIDGains(proportional=gain), task) for gain in (400.0, 1500.0))
    resting = resting_cases()
    assert set(resting.families) == {"pause", "creep", "staircase"}
    moving = costs_of(task, tuning_cases(task, 14), [calm, stiff]).mean(axis=1)
    still = costs_of(TaskConfig(episode_duration=5.0), resting, [calm, stiff], judged=1.5).mean(axis=1)
    assert moving[1] < 10.0 * moving[0]
    assert still[1] > 100.0 * still[0]


def test_a_candidate_that_is_refused_or_fails_costs_much_and_disturbs_no_other():
    cases = tuning_cases(SHORT, 7)
    costs = costs_of(SHORT, cases, [None, Constant(None), Constant(np.nan), Constant()])
    assert (costs[:3] == REFUSED).all()
    np.testing.assert_array_equal(costs[3], costs_of(SHORT, cases, [Constant()] * 4)[3])


def test_an_axis_that_fails_pays_the_stroke_until_the_end():
    config = TaskConfig(
        episode_duration=0.5,
        plant={"cylinder": {"stroke": 0.06}, "load": {"spring_stiffness": 0.0}},
        randomisation={},
        references={"largest_amplitude": 0.01},
        failure={"end_stop_speed": 0.01},
        initial_position_range=(0.0, 0.0),
    )
    cases = tuning_cases(config, 1)
    failing, resting = costs_of(config, cases, [Constant(1.0), Constant()])[:, 0]
    run = run_cases(config, Constant(1.0), cases)
    periods = run.failed_at[0] + 1
    assert 0 < periods < config.steps
    error = np.abs(run.reference[0, :periods].astype(float) - run.position[0, :periods] - run.position_bias[0]).sum()
    first_change = 3e-3 * np.mean(speed_limits(config.plant))
    paid = (error + 0.06 * (config.steps - periods)) / config.steps
    assert paid <= failing < paid + 1.1 * first_change / config.steps
    assert resting < failing


def test_the_command_tunes_and_resumes(tmp_path):
    kind, study, folder = "pid", tmp_path / "study.yaml", tmp_path / "out"
    study.write_text(yaml.safe_dump({"task": {"episode_duration": 0.3}, "controllers": {"PID": {"kind": "pid"}}}))
    train(kind, folder, study, steps=14)
    assert not (folder / JOBS_FOLDER).exists()
    make_controller(kind, TaskConfig(), read_yaml(folder / f"{kind}.yaml"))
    with refused("nothing to resume"):
        train(kind, folder, study, steps=14, resume=True)
