"""Speed of the environments and of PPO on this machine, with Gymnasium's own environments beside them.

Run: python benchmarks/speed.py
Every figure is the median of several runs in this process; compare ratios, not absolute numbers of another day.
"""

import statistics
import time

import gymnasium as gym
import numpy as np

import hydro_env  # noqa: F401  (registers the environment)
from agents.controllers import PIDGains
from agents.learning.training import PPOSettings, train_ppo
from agents.paths import config_folder
from agents.study import StudySettings, machine_description, package_versions

REPEATS = 5


def single(name: str, steps: int = 20_000) -> float:
    """Steps per second of one environment through gym.make, resets included."""
    env = gym.make(name)
    env.reset(seed=0)
    action = env.action_space.sample() * 0
    began = time.perf_counter()
    for _ in range(steps):
        _, _, terminated, truncated, _ = env.step(action)
        if terminated or truncated:
            env.reset()
    seconds = time.perf_counter() - began
    env.close()
    return steps / seconds


def vector(name: str, count: int, **options: object) -> float:
    """Environment steps per second through gym.make_vec, autoreset included."""
    env = gym.make_vec(name, num_envs=count, **options)
    env.reset(seed=0)
    env.action_space.seed(0)
    actions = env.action_space.sample()
    actions = actions * 0.1 if actions.dtype.kind == "f" else actions
    actions = actions.astype(env.action_space.dtype)
    steps = max(400, 400 * 1024 // count)
    env.step(actions)
    began = time.perf_counter()
    for _ in range(steps):
        env.step(actions)
    seconds = time.perf_counter() - began
    env.close()
    return count * steps / seconds


def ppo(steps: int = 1_000_000) -> float:
    """Steps per second of stable-baselines3 PPO end to end with the settings of the study."""
    study = StudySettings.from_yaml(config_folder() / "studies" / "default.yaml")
    settings = PPOSettings(**study.ppo.model_dump() | {"total_steps": steps})
    gains: PIDGains = study.base_pid or study.pid
    began = time.perf_counter()
    policy = train_ppo(study.task, settings, gains)
    return policy.training["steps"] / (time.perf_counter() - began)


def main() -> None:
    """Measure in turn, print one table."""
    np.seterr(all="ignore")
    print(machine_description(), package_versions(), sep="\n")
    rows = {
        "one axis, gym.make": lambda: single("ServoHydraulic-v0"),
        "Pendulum-v1, gym.make": lambda: single("Pendulum-v1"),
        "CartPole-v1, gym.make": lambda: single("CartPole-v1"),
    }
    for mode in ("NextStep", "SameStep"):
        rows[f"1024 axes, {mode}"] = lambda mode=mode: vector("ServoHydraulic-v0", 1024, autoreset_mode=mode)
    rows["1024 CartPole-v1, native vector"] = lambda: vector("CartPole-v1", 1024)
    single("ServoHydraulic-v0", 10)
    results: dict[str, list[float]] = {name: [] for name in rows}
    for _ in range(REPEATS):
        for name, measure in rows.items():
            results[name].append(measure())
    results["PPO, end to end"] = [ppo() for _ in range(3)]
    print(f"\n{'steps per second':34s} {'median':>12s}  lowest–highest")
    for name, values in results.items():
        print(f"{name:34s} {statistics.median(values):12,.0f}  {min(values):,.0f}–{max(values):,.0f}")


if __name__ == "__main__":
    main()
