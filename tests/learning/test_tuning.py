"""The search for gains lowers the cost and is reproducible."""

from agents.learning.tuning import tune_pid
from hydro_env import TaskConfig


def test_search_improves_and_repeats():
    config = TaskConfig(episode_duration=0.5)
    costs = []
    gains, cost = tune_pid(config, plants=42, generations=6, population=2, progress=lambda n, c, g: costs.append(c))
    assert costs[-1] < costs[0]
    assert cost <= costs[-1]
    again, repeated = tune_pid(config, plants=42, generations=6, population=2)
    assert again == gains
    assert repeated == cost
