"""What algorithms reach as they come: stable-baselines3 and sb3-contrib, with their own settings, on the environment.

    python -m benchmarks.baselines [--algorithms PPO SAC] [--steps 1000000] [--seeds 5] [--jobs 2] [--folder FOLDER]

Each trains on ``gym.make("ServoHydraulic-v0")``, nothing underneath, and is judged deterministically on 600 test
episodes; the curve is that of 120 validation episodes. SAC and TQC get 0.3 of the steps, CrossQ 0.05. Beside them stand
controllers. The folder keeps finished trainings; its ``baselines_STEPS.json`` holds algorithm → seed → curve and
returns. Report: task, version, steps, algorithm and settings, seeds, return with its standard deviation over episodes,
interquartile mean over seeds and episodes with its interval, error relative to flow linearisation, failures.
"""

import json
import sys
import time
from collections.abc import Iterator, Mapping
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import torch
from joblib import Parallel, delayed
from sb3_contrib import TQC, CrossQ, RecurrentPPO
from scipy.stats import trim_mean
from stable_baselines3 import PPO, SAC
from stable_baselines3.common.env_util import make_vec_env

from benchmarks import command_line
from hydro_agents.controllers.base import Controller
from hydro_agents.learning.loading import load_controller
from hydro_agents.running.cases import Cases, run_cases
from hydro_agents.running.seeds import EVALUATION, LEARNING, LEARNING_CURVE
from hydro_agents.running.text import markdown
from hydro_env import TaskConfig, __version__
from hydro_env.files import read_json, write_text
from hydro_env.types import Floats

ALGORITHMS: Mapping[str, tuple[Any, str, float]] = {  # with the policy, and the share of the steps
    "PPO": (PPO, "MlpPolicy", 1.0),
    "RecurrentPPO": (RecurrentPPO, "MlpLstmPolicy", 1.0),
    "SAC": (SAC, "MlpPolicy", 0.3),
    "TQC": (TQC, "MlpPolicy", 0.3),
    "CrossQ": (CrossQ, "MlpPolicy", 0.05),  # its networks of 1024 neurons take ten times as long
}
BESIDE = ("pid", "flow_linearising", "ppo")  # as shipped
POINTS = 10  # of a curve
RESAMPLES = 2000


class Zero:
    """A valve that stays closed."""

    def predict(self, observation: Any, *memory: Any, **options: Any) -> tuple[Any, None]:
        """No command, (N, 1)."""
        del memory, options
        return np.zeros((len(observation), 1), np.float32), None


def judged(controller: Controller, cases: Cases) -> dict[str, Any]:
    """Return and mean error (mm) of every episode, and the number of failures."""
    run = run_cases(TaskConfig(), controller, cases)
    errors = 1e3 * np.abs(run.position - run.reference).mean(axis=1)
    return {
        "returns": run.reward.sum(axis=1).round(3).tolist(),
        "errors_mm": errors.round(4).tolist(),
        "failures": int((run.failed_at >= 0).sum()),
    }


def train(name: str, seed: int, steps: int, file: Path) -> None:
    """Write what a training learned, and when, to a file, if there is none yet."""
    if file.exists():
        return
    torch.set_num_threads(1)
    kind, policy, share = ALGORITHMS[name]
    start = LEARNING.training(seed, 1000)[0]
    model = kind(policy, make_vec_env("ServoHydraulic-v0", seed=start), seed=seed, device="cpu")
    curve, began = [], time.perf_counter()
    while model.num_timesteps < share * steps:  # whole rollouts, as the algorithm comes
        model.learn(max(1, round(share * steps / POINTS)), reset_num_timesteps=False)
        seen = judged(model, Cases(np.array(LEARNING_CURVE.take(120))))
        curve.append([model.num_timesteps, float(np.mean(seen["returns"]))])
        print(f"{name}, seed {seed}: {curve[-1][0]} periods, return {curve[-1][1]:.2f}", flush=True)
    seconds = round(time.perf_counter() - began)
    judgement = judged(model, Cases(np.array(EVALUATION.take(600))))
    write_text(file, json.dumps({"curve": curve, "seconds": seconds, **judgement}))


def interquartile(returns: Floats) -> str:
    """Interquartile mean of returns (seeds, episodes), with its interval over both."""
    seeds, episodes = returns.shape
    draw = np.random.default_rng(0).integers
    means = []
    for _ in range(RESAMPLES):
        chosen = returns[draw(0, seeds, seeds)][:, draw(0, episodes, episodes)]
        means.append(trim_mean(chosen, 0.25, axis=None))
    low, high = np.quantile(means, [0.025, 0.975])
    return f"{trim_mean(returns, 0.25, axis=None):.2f} ({low:.2f} to {high:.2f})"


def summary(found: Mapping[str, Mapping[str, Any]]) -> Iterator[list[str]]:
    """One row per participant."""
    unit = np.mean(found["flow_linearising"]["-"]["errors_mm"])
    for name, by_seed in found.items():
        returns = np.array([one["returns"] for one in by_seed.values()])
        errors = [np.mean(one["errors_mm"]) for one in by_seed.values()]
        failures = sum(one["failures"] for one in by_seed.values())
        cells = [f"{returns.mean():.2f} ± {returns.std():.2f}", interquartile(returns), f"{np.mean(errors) / unit:.2f}"]
        yield [name, str(len(by_seed)), *cells, str(failures)]


def main() -> None:
    """Train what is missing, write the JSON, and print the table."""
    folder = Path("results/baselines")
    given = command_line(__doc__, algorithms=ALGORITHMS, steps=1_000_000, seeds=5, jobs=1, folder=folder)
    if min(given.steps, given.seeds, given.jobs) < 1:
        sys.exit("--steps, --seeds and --jobs: must be at least 1")
    jobs = []
    for seed, name in product(range(given.seeds), given.algorithms):
        jobs.append(delayed(train)(name, seed, given.steps, given.folder / f"{name}_{given.steps}_{seed}.json"))
    Parallel(given.jobs)(jobs)
    test = Cases(np.array(EVALUATION.take(600)))
    beside: dict[str, Controller] = {"zero": Zero()}
    beside |= {name: load_controller(name, TaskConfig(), name) for name in BESIDE}
    found: dict[str, dict[str, Any]] = {name: {"-": judged(one, test)} for name, one in beside.items()}
    for file in sorted(given.folder.glob(f"*_{given.steps}_*.json")):  # of earlier calls as well
        name, _, seed = file.stem.split("_")
        found.setdefault(name, {})[seed] = read_json(file)
    facts = {"version": __version__, "task": TaskConfig().model_dump(mode="json"), "steps": given.steps}
    write_text(given.folder / f"baselines_{given.steps}.json", json.dumps(facts | {"found": found}))
    header = ("", "seeds", "return ± sd over episodes", "interquartile mean (95 %)", "error ÷ flow linearisation's")
    print(markdown((*header, "failures"), list(summary(found))))


if __name__ == "__main__":
    main()
