"""Trains PPO of stable-baselines3 on the native vector environment, resumable; and what every training needs."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from functools import cache
from pathlib import Path
from typing import Any, cast

import torch
from sb3_contrib import RecurrentPPO
from stable_baselines3 import PPO
from stable_baselines3.common.on_policy_algorithm import OnPolicyAlgorithm

from hydro_agents.controllers.base import ClassicalController, Controller, ObservationLayout
from hydro_agents.controllers.registry import kind_of
from hydro_agents.learning.checkpoint import (
    CHECKPOINT_FILE,
    Checkpoint,
    TrainingCallback,
    load,
    restore,
    save,
    session,
)
from hydro_agents.learning.features import PolicyFeatures, periods_per_step
from hydro_agents.learning.policy import PolicyController
from hydro_agents.learning.privileged import AsymmetricPolicy
from hydro_agents.learning.progress import Progress, training_logger
from hydro_agents.learning.settings import PPOSettings, RecurrentPPOSettings, TrainingSettings
from hydro_agents.learning.vec_env import AxisVecEnv
from hydro_agents.running.cases import family_errors, validation_errors
from hydro_agents.running.seeds import LEARNING
from hydro_env import ConfigurationError, TaskConfig
from hydro_env.task.configuration import task_config

ACTIVATIONS = {"tanh": torch.nn.Tanh, "relu": torch.nn.ReLU}


def make_features(config: TaskConfig, settings: TrainingSettings, base: Controller | None) -> PolicyFeatures:
    """The features that a training uses.

    Raises:
        ConfigurationError: the residual form has no controller to correct, or one that is not classical.
    """
    corrected: ClassicalController | None = None
    if settings.residual:
        if base is None:
            raise ConfigurationError("residual: true needs a controller that the policy corrects")
        corrected = cast(ClassicalController, base)
        kind_of(corrected)  # the weights' file must be able to name it
    options = (settings.residual_scale, settings.see_correction, settings.full_preview, settings.see_estimates)
    lags = (1,) if isinstance(settings, RecurrentPPOSettings) else None  # it remembers what it needs
    features = PolicyFeatures(config, corrected, *options, lags=lags)
    return features.normalised() if settings.normalise else features


def make_env(config: TaskConfig, settings: TrainingSettings, features: PolicyFeatures, seed: int) -> AxisVecEnv:
    """The axes of a training; ``practice`` may change their episodes, but not the observations.

    Its ``randomisation`` changes single parameters; the task's ranges of the others stay.

    Raises:
        ConfigurationError: ``practice`` has no valid fields of a task, or changes the observations or the control
            period.
    """
    practice = dict(settings.practice)
    if isinstance(ranges := practice.get("randomisation"), Mapping):
        practice["randomisation"] = config.model_dump()["randomisation"] | dict(ranges)
    try:
        practised = task_config(config, **practice)
    except ConfigurationError as error:
        raise ConfigurationError(f"practice: {error}") from None
    if ObservationLayout.of(practised) != ObservationLayout.of(config):
        raise ConfigurationError(
            f"practice = {settings.practice}: must leave the control period and the names and scales of "
            "observations as they are in the task, because the policy must work there"
        )
    paired = settings.residual and settings.paired
    if settings.family_units and features.base is not None:
        errors = family_errors(practised, features.base, sensor_frame=settings.family_units == "sensor")
        practised = in_family_units(practised, errors)
    told, scale = isinstance(settings, PPOSettings) and settings.told_critic, settings.reward_scale
    return AxisVecEnv(practised, settings.axes, features, seed, scale, paired, True, told, settings.prices)


def discount(config: TaskConfig, settings: TrainingSettings) -> float:
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


def make_model(env: AxisVecEnv, settings: PPOSettings, seed: int) -> OnPolicyAlgorithm:
    """A PPO model with nearly zero initial output: a correction starts at the corrected controller."""
    assert env.features is not None
    own: dict[str, Any] = {"actor_inputs": env.features.size} if settings.told_critic else {}
    algorithm: Any = PPO
    policy: Any = AsymmetricPolicy if settings.told_critic else "MlpPolicy"
    if isinstance(settings, RecurrentPPOSettings):
        algorithm, policy, own = RecurrentPPO, "MlpLstmPolicy", {"lstm_hidden_size": settings.lstm_cells}
    model: OnPolicyAlgorithm = algorithm(
        policy,
        env,
        learning_rate=settings.learning_rate_at,
        n_steps=settings.steps_per_rollout,
        batch_size=settings.axes * settings.steps_per_rollout // settings.minibatches,
        n_epochs=settings.epochs,
        gamma=discount(env.features.config, settings),
        gae_lambda=settings.advantage_decay,
        clip_range=settings.clip_range,
        ent_coef=settings.entropy_weight,
        policy_kwargs={
            "net_arch": {"pi": list(settings.hidden_sizes), "vf": list(settings.hidden_sizes)},
            "log_std_init": settings.initial_log_standard_deviation,
            "activation_fn": ACTIVATIONS[settings.activation],
            **own,
        },
        seed=seed,
        device="cpu",
    )
    model.policy.get_parameter("log_std").requires_grad_(False)  # the exploration follows a schedule
    with torch.no_grad():
        model.policy.get_parameter("action_net.weight").mul_(0.1 if settings.residual else 1.0)
    return model


def train_ppo(
    config: TaskConfig,
    settings: PPOSettings,
    base: Controller | None,
    seed: int = 0,
    folder: str | Path | None = None,
    resume: bool = False,
    progress: Callable[[Progress], None] | None = None,
    checkpoint_seconds: float = 20.0,
    check: Callable[[PolicyController, int, float], bool] | None = None,
) -> PolicyController:
    """Train a new policy, or continue from a checkpoint as if there had been no interruption.

    Args:
        config: the task.
        settings: settings of the training.
        base: the controller that the residual form corrects.
        seed: seed of networks, exploration, plants, references and noise.
        folder: for ``checkpoint.safetensors``, ``progress.csv`` and logs of TensorBoard; ``None`` writes nothing.
        resume: continue from the checkpoint in ``folder``.
        progress: called after every rollout.
        checkpoint_seconds: time between checkpoints; the first is written before the first rollout.
        check: called between rollouts with the present policy, the number of steps and the seconds of training
            (without its own); true ends the training early.

    Returns:
        The trained policy.

    Raises:
        ConfigurationError: the settings are impossible, or the checkpoint is missing, damaged or of other settings.
        KeyboardInterrupt: Ctrl-C; the checkpoint holds the start of the interrupted rollout.
    """
    torch.set_num_threads(settings.torch_threads)
    features = make_features(config, settings, base)
    made_with = {
        "seed": seed,
        "settings": {**settings.model_dump(mode="json"), "total_steps": 0},  # a resumed training may be longer
        "task": config.model_dump(mode="json"),
        "features": features.describe(),
    }
    place = Path(folder) if folder is not None else None
    checkpoint = _earlier(place, resume, made_with)
    done, seconds = (checkpoint.steps, checkpoint.seconds) if checkpoint is not None else (0, 0.0)
    env = make_env(config, settings, features, LEARNING.training(seed, settings.axes).start)
    model = make_model(env, settings, seed)
    model.set_logger(training_logger(place, done))

    def current() -> PolicyController:
        return PolicyController.from_sb3(model, features)

    callback = TrainingCallback(
        settings,
        seconds,
        progress,
        None if place is None else lambda taken: save(taken, place, made_with),
        checkpoint_seconds,
        lambda passed: check is not None and check(current(), int(model.num_timesteps), passed),
        _validation(config, base if settings.residual else None, current),
    )
    with session(model, env, callback):
        if checkpoint is not None and place is not None:
            restore(model, env, checkpoint, place / CHECKPOINT_FILE)
        if done < settings.total_steps:
            # The callback writes the log after the update.
            model.learn(settings.total_steps - done, callback, log_interval=10**9, reset_num_timesteps=False)
    record = training_record(type(model).__name__, env, seed, int(model.num_timesteps), callback.seconds, settings)
    return PolicyController.from_sb3(model, features, record)


def _earlier(place: Path | None, resume: bool, made_with: Mapping[str, Any]) -> Checkpoint | None:
    """The checkpoint of a training that is resumed; that of another one in the folder is removed."""
    if place is None:
        if resume:
            raise ConfigurationError("resume: a folder with a checkpoint is needed")
        return None
    if resume:
        return load(place, made_with)
    (place / CHECKPOINT_FILE).unlink(missing_ok=True)
    return None


def _validation(
    config: TaskConfig, corrected: Controller | None, current: Callable[[], PolicyController]
) -> Callable[[], dict[str, float]]:
    """A function that gives the errors of the present policy, and of the controller that it corrects, mm."""
    base_error = cache(lambda: validation_errors(config, corrected)[0] if corrected is not None else math.nan)

    def validation() -> dict[str, float]:
        mean, worst, failures = validation_errors(config, current())
        beside = {"base_mean_error_mm": base_error(), "error_to_corrected": mean / base_error()}
        return {"mean_error_mm": mean, "worst_error_mm": worst, "failures": failures, **beside}

    return validation


def training_record(
    algorithm: str, env: AxisVecEnv, seed: int, steps: int, seconds: float, settings: TrainingSettings
) -> dict[str, Any]:
    """The record of a training for the JSON file of the weights."""
    practised = env.env.config
    return {
        "algorithm": f"{algorithm} ({'stable-baselines3' if algorithm in ('PPO', 'SAC') else 'sb3-contrib'})",
        "seed": seed,
        "steps": steps,
        "seconds": round(seconds, 1),
        "control_period": practised.control_period,
        "command_latency": practised.command_latency_range or practised.command_latency,
        "settings": settings.model_dump(mode="json"),
    }
