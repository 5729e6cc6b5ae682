"""Trains a policy with PPO on the native vector environment, resumable.

The way of the data: task → :func:`make_env` (N axes) → :func:`make_features` (inputs of the network) →
:func:`make_model` (PPO) → :func:`train_policy` (weights, log and checkpoints).
"""

import math
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import torch
from sb3_contrib import RecurrentPPO
from stable_baselines3 import PPO

from hydro_agents.controllers.base import Controller, ObservationLayout
from hydro_agents.controllers.registry import kind_of
from hydro_agents.learning.any_axis import AnyAxisFeatures
from hydro_agents.learning.checkpoint import Checkpoints, restore
from hydro_agents.learning.features import PolicyFeatures
from hydro_agents.learning.imitation import ImitatingPPO, ImitatingRecurrentPPO
from hydro_agents.learning.loading import load_controller
from hydro_agents.learning.policy import PolicyController
from hydro_agents.learning.progress import Progress, TrainingCallback, training_logger
from hydro_agents.learning.rig_gains import gain_sets
from hydro_agents.learning.settings import PPOSettings
from hydro_agents.learning.vec_env import AxisVecEnv, RigsVecEnv
from hydro_agents.running.cases import family_errors
from hydro_agents.running.seeds import LEARNING
from hydro_env import ConfigurationError, TaskConfig, task_config
from hydro_env.errors import at
from hydro_env.files import Group
from hydro_env.task.drawn_rigs import rig_tasks
from hydro_env.task.paces import periods_per_step


def make_features(config: TaskConfig, settings: PPOSettings, base: Controller | None) -> PolicyFeatures:
    """The features that a training uses.

    Raises:
        ConfigurationError: the residual form has no controller to correct, or one that is not classical.
    """
    corrected: Any = base if settings.residual else None
    if settings.residual:
        if base is None:
            raise ConfigurationError("residual: true needs a controller that the policy corrects")
        kind_of(corrected)  # the weights' file must be able to name it
    scale, memory = settings.residual_scale, settings.lstm_cells is not None  # a memory keeps what it needs
    if settings.law:
        return AnyAxisFeatures(config, corrected, scale, samples=1 if memory else None).normalised()
    features = PolicyFeatures(
        config, corrected, scale, settings.full_preview, settings.see_estimates, lags=(1,) if memory else None
    )
    return features.normalised() if settings.normalise else features


def make_env(config: TaskConfig, settings: PPOSettings, features: PolicyFeatures, seed: int) -> AxisVecEnv:
    """The axes of a training; ``practice`` may change their episodes, but not the observations.

    Raises:
        ConfigurationError: ``practice`` has no valid fields of a task, or changes the observations or the control
            period.
    """
    with at("practice"):
        practised = task_config(config, **settings.practice)
    if ObservationLayout.of(practised) != ObservationLayout.of(config):
        raise ConfigurationError(
            f"practice = {settings.practice}: must leave the control period and the names and scales of "
            "observations as they are in the task, because the policy must work there"
        )
    teacher: Controller | None = None
    if settings.teacher is not None:
        teacher = load_controller(settings.teacher, config, "teacher", gains=untuned_gains)
    leader = teacher or features.base
    if settings.family_units and leader is not None:
        measured: Any = leader
        if settings.start and features.base is None:
            measured = _start(settings.start)
            measured.features = features
        errors = family_errors(practised, measured, sensor_frame=settings.family_units == "sensor")
        practised = in_family_units(practised, errors)
    return AxisVecEnv(
        practised,
        settings.axes,
        features,
        seed,
        settings.reward_scale,
        paired=leader is not None,
        stagger=True,
        reversal_price=settings.reversal_price,
        teacher=teacher,
    )


def untuned_gains(kind: str, config: TaskConfig) -> Group:
    """Gains for any rig: a teacher on a thousand drawn rigs has no time for a choice."""
    return gain_sets(kind, config)[0]


def make_axes(
    config: TaskConfig, settings: PPOSettings, features: PolicyFeatures, seed: int
) -> AxisVecEnv | RigsVecEnv:
    """The axes of a training, of :func:`make_env`; of every rig of the settings' law, if there is one.

    The price of a reversal counts per step of the rig, as all rewards of drawn rigs do.
    """
    if settings.law is None or not isinstance(features, AnyAxisFeatures):
        return make_env(config, settings, features, seed)
    axes = settings.axes // settings.together
    tasks = rig_tasks(task_config(config, law=settings.law.model_dump()))

    def of_rig(number: int) -> AxisVecEnv:
        task = tasks[number]
        price = settings.reversal_price / periods_per_step(task)
        own = settings.model_copy(update={"axes": axes, "reversal_price": price})
        return make_env(task, own, features.moved_to(task), seed + number % settings.together * axes)

    return RigsVecEnv(of_rig, settings.together, features)


def discount(config: TaskConfig, settings: PPOSettings) -> float:
    """Discount per control period: that of the settings holds per step of the rig."""
    return math.pow(settings.discount, 1.0 / periods_per_step(config))


def in_family_units(config: TaskConfig, errors: Mapping[str, float]) -> TaskConfig:
    """The task with rewards relative to each family's mean error (m).

    The error with the largest cost, and so the cost of a failure, stays the same.
    """
    reward = config.reward
    scale = {name: error / reward.error_scale for name, error in errors.items()}
    more = max(1.0, 1.0 / min(scale.values()))
    limits = {"error_limit": more * reward.error_limit, "failure": more * reward.failure}
    return task_config(config, reward={"family_scale": scale, **limits})


def make_model(env: AxisVecEnv | RigsVecEnv, settings: PPOSettings, seed: int) -> Any:
    """A model of PPO with nearly zero output: a correction starts at the corrected controller."""
    assert env.features is not None
    hidden: Any = list(settings.hidden_sizes)
    network: dict[str, Any] = {
        "activation_fn": {"tanh": torch.nn.Tanh, "relu": torch.nn.ReLU}[settings.activation],
        "net_arch": {"pi": hidden, "vf": hidden},
        "log_std_init": settings.initial_log_standard_deviation,
    }
    if settings.start:
        network["optimizer_kwargs"] = {"eps": 1e-8}  # the gradients of a policy that is good are smaller than 1e-5
    algorithm: Any = PPO
    policy = "MlpPolicy"
    if settings.lstm_cells:
        algorithm, policy, network["lstm_hidden_size"] = RecurrentPPO, "MlpLstmPolicy", settings.lstm_cells
    if settings.teacher:
        algorithm = ImitatingRecurrentPPO if settings.lstm_cells else ImitatingPPO
    model = algorithm(
        policy,
        env,
        gamma=discount(env.features.config, settings),
        policy_kwargs=network,
        seed=seed,
        device="cpu",
        learning_rate=settings.learning_rate_at,
        n_steps=settings.steps_per_rollout,
        batch_size=settings.axes * settings.steps_per_rollout // settings.minibatches,
        n_epochs=settings.epochs,
        gae_lambda=settings.advantage_decay,
        clip_range=settings.clip_range,
    )
    if settings.teacher:
        model.imitated_steps = settings.imitated_share * settings.total_steps
    with torch.no_grad():
        model.policy.log_std.requires_grad_(False)  # the exploration follows a schedule
        model.policy.action_net.weight.mul_(0.1 if settings.residual else 1.0)
    if settings.start:
        _start(settings.start).into(model)
    return model


def _start(path: str) -> PolicyController:
    with at("start"):
        return PolicyController.load(path)


def train_policy(
    config: TaskConfig,
    settings: PPOSettings,
    base: Controller | None = None,
    seed: int = 0,
    folder: str | Path | None = None,
    resume: bool = False,
    progress: Callable[[Progress], None] | None = None,
    checkpoint_seconds: float = 20.0,
) -> PolicyController:
    """Train a new policy, or continue from a checkpoint as if there had been no interruption; returns the policy.

    Args:
        config: the task.
        settings: settings of the training.
        base: the controller that the residual form corrects.
        seed: seed of networks, exploration, plants, references and noise.
        folder: for ``checkpoint.safetensors``, ``progress.csv`` and logs of TensorBoard; ``None`` writes nothing.
        resume: continue from the checkpoint in ``folder``.
        progress: called after every update.
        checkpoint_seconds: time between checkpoints; the first is written before the first rollout.

    Raises:
        ConfigurationError: the settings are impossible, or the checkpoint is missing, damaged or of other settings.
        KeyboardInterrupt: Ctrl-C; the checkpoint holds the start of the interrupted rollout.
    """
    if resume and folder is None:
        raise ConfigurationError("resume: a folder with a checkpoint is needed")
    torch.set_num_threads(1)  # more threads cost more than these small networks gain
    features = make_features(config, settings, base)
    made_with = {
        "seed": seed,
        "settings": {**settings.model_dump(mode="json"), "total_steps": 0},  # a resumed training may be longer
        "task": config.model_dump(mode="json"),
        "features": features.describe(),
    }
    checkpoints = Checkpoints(folder, made_with, checkpoint_seconds)
    earlier = checkpoints.earlier(resume)
    env = make_axes(config, settings, features, LEARNING.training(seed, settings.axes).start)
    model = make_model(env, settings, seed)
    callback = TrainingCallback(config, settings, features, checkpoints, progress)
    model.set_logger(training_logger(folder, 0 if earlier is None else earlier.steps))
    try:
        if earlier is not None:
            if earlier.steps - settings.axes * settings.steps_per_rollout >= settings.total_steps:
                raise ConfigurationError(f"total_steps = {settings.total_steps}: {earlier.steps} are done already")
            restore(model, env, earlier)
            callback.seconds_before = earlier.seconds
        if model.num_timesteps < settings.total_steps:
            left = settings.total_steps - model.num_timesteps
            # The callback writes the log after the update.
            model.learn(left, callback, log_interval=10**9, reset_num_timesteps=False)
    except KeyboardInterrupt:
        checkpoints.write()
        raise
    finally:
        model.logger.close()
        env.close()
    record: dict[str, Any] = {"seed": seed, "steps": int(model.num_timesteps), "seconds": round(callback.seconds, 1)}
    record |= _described(model, config, settings)
    return PolicyController.from_sb3(model, features.applied(settings.applied_share), record)


def _described(model: Any, config: TaskConfig, settings: PPOSettings) -> dict[str, Any]:
    """What the weights' file tells about a training."""
    return {
        "algorithm": f"{type(model).__name__} ({type(model).__module__.split('.')[0].replace('_', '-')})",
        "control_period": config.control_period,
        "command_latency": config.command_latency_range or config.command_latency,
        "settings": settings.model_dump(mode="json"),
    }
