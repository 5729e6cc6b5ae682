"""Rows of memory, start-up and inference, and of the shares of the time of a step and of a PPO iteration."""

from __future__ import annotations

import os
import statistics
import tempfile
import time
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import torch

from benchmarks.kernel_rows import BareKernel
from benchmarks.table import Case, Extent, Row, UnavailableError, fresh_process, one_row, rate, time_in
from benchmarks.training_rows import TRAININGS, default_study, native_model
from hydro_agents.detection.head import LeakageHead
from hydro_agents.detection.monitor import MonitoredController
from hydro_agents.learning.policy import PolicyController
from hydro_agents.running.folders import pretrained_folder
from hydro_env import ENVIRONMENT_ID, ServoHydraulicEnv, ServoHydraulicVectorEnv

MEMORY_AXES = 65_536
_RESIDENT_CODE = """
import gymnasium, numpy as np, hydro_env
def resident():
    with open("/proc/self/statm") as file:
        return int(file.read().split()[1]) * __import__("resource").getpagesize()
def run(count):
    env = gymnasium.make_vec("{env_id}", num_envs=count, threads=1)
    env.reset(seed=0)
    for _ in range(3):
        env.step(np.zeros((count, 1), dtype=np.float32))
    return env
small = run(8)
before = resident()
large = run({count})
print((resident() - before) / {count})
"""
_FIRST_STEP_CODE = f"""
import gymnasium, hydro_env
env = gymnasium.make("{ENVIRONMENT_ID}")
env.reset(seed=0)
env.step(env.action_space.sample())
"""


def array_bytes(env: ServoHydraulicVectorEnv) -> int:
    """Bytes of all NumPy arrays that a vector environment holds, views not counted."""
    values = [value for owner in (env, env.axes, env.axes.options) for value in vars(owner).values()]
    values += [part for value in values if isinstance(value, tuple) for part in value]
    sizes = {id(array): array.nbytes for array in values if isinstance(array, np.ndarray) and array.base is None}
    return sum(sizes.values())


def memory_cases(extent: Extent, count: int = MEMORY_AXES) -> list[Case]:
    """Memory per axis of a vector environment with ``count`` axes."""

    def arrays() -> float:
        env = ServoHydraulicVectorEnv(count)
        env.reset(seed=0)
        size = array_bytes(env) / count
        env.close()
        return size

    def resident() -> float:
        if not Path("/proc/self/statm").exists():
            raise UnavailableError("not measured: this system has no /proc")
        return float(fresh_process(_RESIDENT_CODE.format(env_id=ENVIRONMENT_ID, count=count))[1])

    name, size = "arrays of one axis", f"N = {count:,}"
    growth = "growth of resident memory per axis"
    return [
        one_row(name, "bytes", arrays, 1, note=size),
        one_row(growth, "bytes", resident, extent.runs, name, f"{size}, fresh process"),
    ]


def start_cases(extent: Extent) -> list[Case]:
    """Import, and time to the first step with an empty and with a filled cache of machine code; fresh processes."""
    folder = tempfile.TemporaryDirectory(prefix="hydro-benchmark-")

    def process(name: str, code: str, against: str = "") -> Case:
        return one_row(name, "s", lambda: fresh_process(code)[0], extent.runs, against)

    def first_step(cache: str) -> float:
        return fresh_process(_FIRST_STEP_CODE, {"NUMBA_CACHE_DIR": cache})[0]

    def cold() -> float:
        with tempfile.TemporaryDirectory(prefix="hydro-benchmark-") as empty:
            return first_step(empty)

    def warm() -> float:
        if not os.listdir(folder.name):
            first_step(folder.name)
        return first_step(folder.name)

    own, note = "import hydro_env", "with its imports, without the start of the interpreter"
    filled, anew = "first step, warm cache", "everything compiled again"
    return [
        process("python, nothing imported", "pass"),
        process("import gymnasium", "import gymnasium", "python, nothing imported"),
        process(own, own, "import gymnasium"),
        one_row(f"{own}, by -X importtime", "s", lambda: import_time("hydro_env"), extent.runs, note=note),
        one_row(filled, "s", warm, extent.runs, own, "import, gym.make, reset, step"),
        one_row("first step, cold cache", "s", cold, min(3, extent.runs), filled, anew),
    ]


def import_time(module: str) -> float:
    """Seconds of the import of a module, including its own imports, by ``python -X importtime``."""
    text = fresh_process(f"import {module}", None, "-X", "importtime")[2]
    line = next(line for line in text.splitlines() if line.rsplit("|", 1)[-1].strip() == module)
    return 1e-6 * int(line.split("|")[1])


def inference_cases(extent: Extent) -> list[Case]:
    """Time from observation to command on one axis, with and without the leakage head."""
    policy = PolicyController.load(pretrained_folder() / "policy")
    head = LeakageHead.load(pretrained_folder() / "leakage_head")
    monitored = MonitoredController(policy, head)
    env = gym.make(ENVIRONMENT_ID)
    env.reset(seed=0)
    observations = [env.step(np.zeros(1, dtype=np.float32))[0] for _ in range(256)]
    period = 1e3 * policy.features.layout.control_period
    env.close()

    def case(name: str, controller: Any, after: Callable[[Any], Any], calls: int) -> Case:
        def measure(run: int) -> Sequence[float]:
            memory, times = None, []
            for number in range(head.settings.window + calls):  # the head's window fills first
                began = time.perf_counter()
                _, memory = controller.predict(observations[number % 256], memory)
                if number >= head.settings.window:
                    after(memory)
                    times.append(1e3 * (time.perf_counter() - began))
            late = float(np.quantile(times, 0.999))
            return statistics.median(times), late, 100.0 * late / period

        note = f"{calls:,} calls, one axis, at every control period"
        late = f"{name}: 99.9th percentile"
        rows = Row(f"{name}: median", "ms", note=note), Row(late, "ms"), Row(late, f"% of {period:g} ms")
        return Case(rows, measure, extent.runs)

    return [
        case("policy", policy, lambda memory: None, extent.calls),
        case("policy and leakage head", monitored, monitored.estimate, extent.calls // 10),
    ]


VECTOR_SIZE = 1024
ENDLESS: dict[str, Any] = {"episode_duration": 3600.0, "references": {"weights": {"sine": 1.0}}}


def profile_cases(extent: Extent) -> list[Case]:
    """A single step, a vector step, a PPO iteration."""
    return [*_single_cases(extent), *_vector_cases(extent), _iteration_case(extent)]


def _timed(extent: Extent, whole: str, *parts: tuple[str, Callable[[], Callable[[], Any]], str]) -> list[Case]:
    """Time in µs of calls (name, function that prepares the call, note); the later ones are parts of the first."""

    def measure(make: Callable[[], Callable[[], Any]]) -> float:
        call = make()

        def work() -> int:
            for _ in range(100):
                call()
            return 100

        return 1e6 / rate(work, extent.seconds)

    names = [f"{whole.partition(',')[0]}: {part}" if part else whole for part, _, _ in parts]
    return [
        one_row(name, "µs", partial(measure, make), extent.runs, whole if part else "", note)
        for name, (part, make, note) in zip(names, parts, strict=True)
    ]


def _step(env: Any) -> Callable[[], Any]:
    env.reset(seed=0)
    action = np.zeros(env.action_space.shape, dtype=np.float32)
    return lambda: env.step(action)


def _compiled_step(axes: Any, count: int) -> Callable[[], Any]:
    """The compiled step of started axes; their clock is stopped, so no episode ends."""
    command, clock = np.zeros(count), axes.column("step")

    def call() -> None:
        clock[:] = 0.0
        axes.step(command)

    return call


def _single_cases(extent: Extent) -> list[Case]:
    def begun() -> ServoHydraulicEnv:
        env = ServoHydraulicEnv(**ENDLESS)
        env.reset(seed=0)
        return env

    def info() -> Callable[[], Any]:
        env = begun()
        return partial(env._info, env.axes.numbers[0].tolist())

    return _timed(
        extent,
        "single step, gym.make",
        ("", lambda: _step(gym.make(ENVIRONMENT_ID, **ENDLESS)), ""),
        ("without Gymnasium's wrappers", lambda: _step(begun()), ""),
        ("compiled step and its call", lambda: _compiled_step(begun().axes, 1), "physics, sensors, reward"),
        ("integrator and its call", lambda: BareKernel(1, 1).advance, ""),
        ("info", info, ""),
    )


def _vector_cases(extent: Extent) -> list[Case]:
    def env(info: bool, threads: int | None = 1) -> ServoHydraulicVectorEnv:
        return ServoHydraulicVectorEnv(VECTOR_SIZE, info=info, threads=threads)

    def compiled() -> Callable[[], Any]:
        bare = env(False)
        bare.reset(seed=0)
        return _compiled_step(bare.axes, VECTOR_SIZE)

    return _timed(
        extent,
        f"vector step, N = {VECTOR_SIZE:,}, 1 thread",
        ("", lambda: _step(env(True)), "restarts of ended axes included"),
        ("with as many threads as cores", lambda: _step(env(True, None)), ""),
        ("without info", lambda: _step(env(False)), ""),
        ("compiled step", compiled, "physics, sensors, reward, observation"),
        ("integrator", lambda: BareKernel(VECTOR_SIZE, 1).advance, ""),
    )


PARTS = {
    "environment: compiled step": "of both: the axes and, with paired rewards, their twins",
    "environment: features and controllers": "history, the controller below the policy, the twins' controller",
    "environment: rest": "restarts, infos, copies",
    "inference": "actor and critic on one observation per axis",
    "collection: rest": "rollout buffer, advantages, bookkeeping of stable-baselines3",
    "update: minibatches": "gathering samples from the buffer",
    "update: forward": "actor and critic",
    "update: backward": "",
    "update: optimiser": "Adam and the limit of the gradient's norm",
    "update: rest": "losses, logging",
}


def _iteration_case(extent: Extent) -> Case:
    settings = default_study()
    ppo = settings.ppo
    size = ppo.axes * ppo.steps_per_rollout

    def measure(run: int) -> Sequence[float]:
        model, env = native_model(settings, ppo)
        model.learn(size)
        iterations = max(2, extent.training_steps // (4 * size))
        functions = (
            (env, "step", "environment"),
            (env.env.axes, "step", "compiled step"),
            (env, "_inputs", "features"),
            (model.policy, "forward", "inference"),
            (model, "train", "update"),
            (model.rollout_buffer, "_get_samples", "minibatches"),
            (model.policy, "evaluate_actions", "forward"),
            (torch.Tensor, "backward", "backward"),
            (torch.nn.utils, "clip_grad_norm_", "optimiser"),
            (model.policy.optimizer, "step", "optimiser"),
        )
        with time_in(*functions) as seconds:
            began = time.perf_counter()
            model.learn(iterations * size)
            total = time.perf_counter() - began
        env.close()
        inside = [seconds["compiled step"], seconds["features"]]
        update = [seconds[name] for name in ("minibatches", "forward", "backward", "optimiser")]
        collecting, updating = seconds["environment"], seconds["update"]
        values = [total, *inside, collecting - sum(inside), seconds["inference"]]
        values += [total - collecting - seconds["inference"] - updating, *update, updating - sum(update)]
        return [1e3 * value / iterations for value in values]

    whole = "PPO iteration"
    note = f"{ppo.axes} axes × {ppo.steps_per_rollout} steps, {ppo.minibatches} minibatches, {ppo.epochs} epochs"
    rows = [Row(whole, "ms", note=note)]
    rows += [Row(f"{whole}: {part}", "ms", whole, remark) for part, remark in PARTS.items()]
    return Case(tuple(rows), measure, TRAININGS)
