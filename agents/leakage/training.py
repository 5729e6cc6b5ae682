"""Trains the leakage head on labelled episodes of the simulator, driven by several controllers."""

from __future__ import annotations

import hashlib
import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from pydantic import ConfigDict, Field
from torch import Tensor, nn

from agents.controllers.base import Controller, ObservationLayout
from agents.leakage.head import (
    LARGEST_WIDTH,
    SHORTEST_WINDOW,
    SIGNALS,
    HeadSettings,
    LeakageHead,
    LeakageNetwork,
    channels,
)
from agents.leakage.metrics import threshold_at_false_alarm_rate
from agents.running.cases import Cases, run_cases
from agents.running.optimiser import optimiser_tensors, restore_optimiser
from agents.running.seeds import TRAINING_SEEDS, VALIDATION_SEEDS
from agents.running.weights import load_checkpoint, require, save_checkpoint
from hydro_env import ConfigurationError, TaskConfig
from hydro_env.files import Group
from hydro_env.task.configuration import LEAKAGE_LIMIT

FALSE_ALARM_RATE = 0.01
CHECKPOINT_FILE = "head_checkpoint.safetensors"
KIND = "leakage head checkpoint"
RISE = 0.05
"""Share of the training during which the learning rate rises."""


class HeadTrainingSettings(Group):
    """Settings of the training; ``configs/agents/leakage_head.yaml`` holds those of the studies."""

    model_config = ConfigDict(allow_inf_nan=False)

    episodes: int = Field(24_000, ge=100, le=250_000, description="training episodes, over all controllers")
    validation_episodes: int = Field(8_000, ge=100, le=500_000, description="for the threshold")
    healthy_share: float = Field(0.5, gt=0.0, lt=1.0)
    lowest_healthy_flow: float = Field(0.003, gt=0.0, le=LEAKAGE_LIMIT, description="l/min at 100 bar")
    highest_flow: float = Field(5.0, gt=0.0, le=LEAKAGE_LIMIT, description="l/min at 100 bar")
    epochs: int = Field(12, ge=1, le=100_000)
    batch: int = Field(256, ge=1, le=1_000_000)
    learning_rate: float = Field(2e-3, gt=0.0, le=1.0)
    weight_decay: float = Field(1e-4, ge=0.0, le=1.0)
    size_weight: float = Field(
        1.0, ge=0.0, le=1e3, description="weight of the size error (in decades, Huber) relative to the class"
    )
    width: int = Field(48, ge=1, le=LARGEST_WIDTH)
    torch_threads: int = Field(2, ge=1, le=256)

    def check(self, config: TaskConfig) -> None:
        """Check that the leaks of the training and the window suit a task.

        Raises:
            ConfigurationError: a bound lies on the wrong side of the task's bound, or an episode is too short.
        """
        if config.steps < SHORTEST_WINDOW:
            raise ConfigurationError(
                f"leakage_head: an episode of {config.steps} control periods is its window: must have at least "
                f"{SHORTEST_WINDOW}"
            )
        healthy, faulty = config.leakage.class_bounds[0], config.leakage.faulty_range[0]
        if self.lowest_healthy_flow >= healthy:
            raise ConfigurationError(
                f"leakage_head: lowest_healthy_flow = {self.lowest_healthy_flow:g}: must be below the task's "
                f"leakage.class_bounds[0] = {healthy:g} l/min"
            )
        if self.highest_flow <= faulty:
            raise ConfigurationError(
                f"leakage_head: highest_flow = {self.highest_flow:g}: must be above the task's "
                f"leakage.faulty_range[0] = {faulty:g} l/min"
            )

    def learning_rate_at(self, share: float) -> float:
        """Learning rate when a share (0 to 1) of the training is done: a rise, then a cosine down to nearly zero."""
        factor = min(share / RISE, 1.0) * 0.5 * (1.0 + math.cos(math.pi * share))
        return self.learning_rate * max(factor, 1e-3)


@dataclass(frozen=True)
class Labelled:
    """Signals (N, 5, T) of episodes with their leak in l/min at 100 bar (N,)."""

    signals: NDArray[np.float16]
    flow_lpm: NDArray[np.float64]


def make_dataset(
    config: TaskConfig,
    controllers: Sequence[Controller],
    settings: HeadTrainingSettings,
    episodes: int,
    first_seed: int,
    progress: Callable[[int], None] | None = None,
) -> Labelled:
    """Episodes under each controller in turn; half healthy, the rest log-uniform over all faulty sizes."""
    layout = ObservationLayout.of(config)
    columns = [layout.index(name) for name in SIGNALS]
    generator = np.random.default_rng(first_seed)
    healthy_bound, faulty_low = config.leakage.class_bounds[0], config.leakage.faulty_range[0]
    low = np.where(generator.random(episodes) < settings.healthy_share, settings.lowest_healthy_flow, faulty_low)
    high = np.where(low == settings.lowest_healthy_flow, healthy_bound, settings.highest_flow)
    flow = np.exp(generator.uniform(np.log(low), np.log(high)))
    # float16 suffices: its step is far below the noise of the signals.
    signals = np.empty((episodes, len(SIGNALS), config.steps), dtype=np.float16)
    bounds = [episodes * part // len(controllers) for part in range(len(controllers) + 1)]
    for controller, start, end in zip(controllers, bounds[:-1], bounds[1:], strict=True):
        for first in range(start, end, 1024):
            last = min(first + 1024, end)
            cases = Cases(np.arange(first_seed + first, first_seed + last), flow[first:last])
            signals[first:last] = run_cases(config, controller, cases, columns, states=False).signals
            if progress is not None:
                progress(last)
    return Labelled(signals, flow)


def train_head(
    config: TaskConfig,
    controllers: Sequence[Controller],
    settings: HeadTrainingSettings,
    seed: int = 0,
    progress: Callable[[str, int, int, float], None] | None = None,
    folder: str | Path | None = None,
    resume: bool = False,
) -> LeakageHead:
    """Train a head on episodes of all controllers, and set its threshold on validation plants.

    Args:
        config: the task; the head's window is one episode.
        controllers: controllers of the training episodes.
        settings: settings of the training.
        seed: seed of data and network.
        progress: called with the phase, the amount done, the total amount, and the loss (NaN during simulation).
        folder: for ``head_checkpoint.safetensors``, written at the start and after each epoch; ``None`` writes nothing.
        resume: continue from that checkpoint; the same episodes are simulated again.

    Raises:
        ConfigurationError: settings that do not suit the task; a checkpoint that is missing, damaged or of other
            settings.
        KeyboardInterrupt: Ctrl-C; the checkpoint of the last whole epoch remains.
    """
    settings.check(config)
    torch.set_num_threads(settings.torch_threads)
    torch.manual_seed(seed)
    began = time.monotonic()
    network = LeakageNetwork(settings.width)
    fit = _Fit(network, settings, config, seed, Path(folder) / CHECKPOINT_FILE if folder is not None else None)
    if resume:
        fit.restore()
    else:
        fit.save()

    def simulated(phase: str, total: int) -> Callable[[int], None]:
        return lambda done: progress(phase, done, total, math.nan) if progress is not None else None

    # The second half of the training seeds: PPO uses the first.
    offset = len(TRAINING_SEEDS) // 2 + (seed * settings.episodes) % (len(TRAINING_SEEDS) // 4)
    first = TRAINING_SEEDS.start + offset
    if fit.epoch < settings.epochs:
        data = make_dataset(
            config, controllers, settings, settings.episodes, first, simulated("data", settings.episodes)
        )
        if fit.epoch == 0:
            _set_normalisation(network, data.signals[:: max(settings.episodes // 2000, 1)])
        fit.run(data, progress)

    count = settings.validation_episodes
    held_out = make_dataset(
        config, controllers, settings, count, VALIDATION_SEEDS.start, simulated("validation", count)
    )
    record: dict[str, Any] = {"seed": seed, "settings": settings.model_dump(mode="json")}
    layout = ObservationLayout.of(config)
    head = LeakageHead(network, HeadSettings(layout, config.steps, 0.5, record))
    probability = head.estimate_signals(held_out.signals).probability
    healthy = held_out.flow_lpm <= config.leakage.class_bounds[0]
    threshold = threshold_at_false_alarm_rate(probability[healthy], FALSE_ALARM_RATE)
    record["seconds"] = round(time.monotonic() - began, 1)
    return LeakageHead(network, HeadSettings(layout, config.steps, threshold, record))


def _set_normalisation(network: LeakageNetwork, signals: NDArray[Any]) -> None:
    with torch.no_grad():
        inputs = channels(torch.from_numpy(signals.astype(np.float32)))
        network.mean = inputs.mean(dim=(0, 2), keepdim=True)
        network.scale = 1.0 / (inputs.std(dim=(0, 2), keepdim=True) + 1e-6)


def targets(flow_lpm: NDArray[np.float64], healthy_bound: float) -> tuple[Tensor, Tensor]:
    """Targets of the network (N,): 1 for a leak above the bound, and log10 of the flow, at least that of the bound.

    The size of a leak below the bound does not matter and cannot be estimated.
    """
    label = torch.from_numpy((flow_lpm > healthy_bound).astype(np.float32))
    size = torch.from_numpy(np.log10(flow_lpm).astype(np.float32))
    return label, size.clamp(min=math.log10(healthy_bound))


def loss_of(output: Tensor, label: Tensor, size: Tensor, size_weight: float) -> Tensor:
    """Cross-entropy of the class plus the weighted Huber loss of the size, beyond 0.3 decades linear; means over N."""
    functional = nn.functional
    wrong_class = functional.binary_cross_entropy_with_logits(output[:, 0], label)
    return wrong_class + size_weight * functional.huber_loss(output[:, 1], size, delta=0.3)


@dataclass
class _Fit:
    """Epochs of gradient steps, with a checkpoint before the first epoch and after each."""

    network: LeakageNetwork
    settings: HeadTrainingSettings
    config: TaskConfig
    seed: int
    checkpoint: Path | None
    epoch: int = 0
    _data_digest: str | None = None

    def __post_init__(self) -> None:
        rate, decay = self.settings.learning_rate, self.settings.weight_decay
        self._optimiser = torch.optim.AdamW(self.network.parameters(), lr=rate, weight_decay=decay)

    def _description(self) -> dict[str, Any]:
        return {
            "seed": self.seed,
            "settings": self.settings.model_dump(mode="json"),
            "task": self.config.model_dump(mode="json"),
        }

    def restore(self) -> None:
        """Load the checkpoint."""
        if self.checkpoint is None:
            raise ConfigurationError("resume: a folder with a checkpoint is needed")
        tensors, stored = load_checkpoint(self.checkpoint, KIND)
        if any(stored.get(key) != value for key, value in self._description().items()):
            raise ConfigurationError(f"{self.checkpoint}: was made with another seed, settings or task")
        epoch, digest = stored.get("epoch"), stored.get("data")
        if type(epoch) is not int or not 0 <= epoch <= self.settings.epochs or not isinstance(digest, str | None):
            raise ConfigurationError(f"{self.checkpoint}: damaged: epoch = {str(epoch)[:30]}")
        own = {f"network.{name}": value.numpy() for name, value in self.network.state_dict().items()}
        require(tensors, own, self.checkpoint)
        self.network.load_state_dict({name.removeprefix("network."): torch.from_numpy(tensors[name]) for name in own})
        restore_optimiser(self._optimiser, tensors, str(self.checkpoint))
        self.epoch, self._data_digest = epoch, digest

    def save(self) -> None:
        """Write the checkpoint."""
        if self.checkpoint is None:
            return
        tensors = {f"network.{name}": value.numpy() for name, value in self.network.state_dict().items()}
        tensors |= optimiser_tensors(self._optimiser)
        description = {"epoch": self.epoch, "data": self._data_digest, **self._description()}
        save_checkpoint(self.checkpoint, KIND, tensors, description)

    def _check_data(self, data: Labelled) -> None:
        digest = hashlib.sha256(data.signals[:: max(len(data.signals) // 500, 1)].tobytes()).hexdigest()
        if self._data_digest not in (None, digest):
            raise ConfigurationError(f"{self.checkpoint}: was trained on episodes of other controllers; cannot resume")
        self._data_digest = digest

    def run(self, data: Labelled, progress: Callable[[str, int, int, float], None] | None) -> None:
        """Run the remaining epochs."""
        self._check_data(data)
        settings, total = self.settings, len(data.flow_lpm)
        per_epoch = math.ceil(total / settings.batch)
        label, size = targets(data.flow_lpm, self.config.leakage.class_bounds[0])
        self.network.train()
        while self.epoch < settings.epochs:
            order = np.random.default_rng([self.seed, self.epoch]).permutation(total)
            losses = []
            for number, first in enumerate(range(0, total, settings.batch)):
                share = (self.epoch * per_epoch + number) / (settings.epochs * per_epoch)
                self._optimiser.param_groups[0]["lr"] = settings.learning_rate_at(share)
                rows = order[first : first + settings.batch]
                output: Tensor = self.network(torch.from_numpy(data.signals[rows].astype(np.float32)))
                loss = loss_of(output, label[rows], size[rows], settings.size_weight)
                self._optimiser.zero_grad(set_to_none=True)
                loss.backward()
                self._optimiser.step()
                losses.append(float(loss.detach()))
            self.epoch += 1
            self.save()
            if progress is not None:
                progress("training", self.epoch, settings.epochs, float(np.mean(losses)))
        self.network.eval()
