"""Trains the leakage head on labelled episodes of the simulator, driven by several controllers."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from pydantic import Field
from torch import Tensor, nn

from agents.controllers.base import Controller, ObservationLayout
from agents.leakage.head import SIGNALS, HeadSettings, LeakageHead, LeakageNetwork, channels
from agents.leakage.metrics import threshold_at_false_alarm_rate
from agents.running.cases import Cases, run_cases
from agents.running.optimiser import optimiser_tensors, restore_optimiser
from agents.running.seeds import TRAINING_SEEDS, VALIDATION_SEEDS
from agents.running.weights import load_weights, require, save_weights
from hydro_env import ConfigurationError, TaskConfig
from hydro_env.files import Group

FALSE_ALARM_RATE = 0.01
CHECKPOINT_KIND = "leakage head checkpoint"


class HeadTrainingSettings(Group):
    """Settings of the training; ``configs/agents/leakage_head.yaml`` holds the ones that are used."""

    episodes: int = Field(24_000, ge=100, description="training episodes, over all controllers")
    validation_episodes: int = Field(8_000, ge=100, description="for the threshold")
    healthy_share: float = Field(0.5, gt=0.0, lt=1.0)
    lowest_healthy_flow: float = Field(0.003, gt=0.0, description="l/min at 100 bar")
    highest_flow: float = Field(5.0, gt=0.0, description="l/min at 100 bar")
    epochs: int = Field(12, ge=1)
    batch: int = Field(256, ge=1)
    learning_rate: float = Field(2e-3, gt=0.0)
    weight_decay: float = Field(1e-4, ge=0.0)
    size_weight: float = Field(1.0, ge=0.0, description="of the size error (in decades, Huber) beside the class")
    width: int = Field(48, ge=1, le=4096)
    torch_threads: int = Field(2, ge=1)


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
        config: the task; an episode is the head's window.
        controllers: that produce the data.
        settings: of the training.
        seed: of data and network.
        progress: called with the phase, how much of it is done, of how much, and the loss (NaN while simulating).
        folder: where ``head_checkpoint.safetensors`` and ``.json`` go after each epoch; ``None`` writes nothing.
        resume: go on from that checkpoint; the episodes are simulated again, which gives the same.

    Raises:
        ConfigurationError: a checkpoint is missing or of other settings.
        KeyboardInterrupt: Ctrl-C; the checkpoint of the last whole epoch stays.
    """
    torch.set_num_threads(settings.torch_threads)
    torch.manual_seed(seed)
    began = time.monotonic()
    network = LeakageNetwork(settings.width)
    fit = _Fit(network, settings, config, seed, Path(folder) / "head_checkpoint" if folder is not None else None)
    if resume:
        fit.restore()

    def simulated(phase: str, total: int) -> Callable[[int], None]:
        return lambda done: progress(phase, done, total, math.nan) if progress is not None else None

    # The far half of the training seeds: PPO uses the near one.
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


class _Fit:
    """Epochs of gradient steps with a checkpoint after each."""

    def __init__(
        self,
        network: LeakageNetwork,
        settings: HeadTrainingSettings,
        config: TaskConfig,
        seed: int,
        checkpoint: Path | None,
    ) -> None:
        self.network = network
        self.settings = settings
        self.config = config
        self.seed = seed
        self.checkpoint = checkpoint
        self.epoch = 0
        self._optimiser = torch.optim.AdamW(
            network.parameters(), lr=settings.learning_rate, weight_decay=settings.weight_decay
        )

    def _description(self) -> dict[str, Any]:
        return {
            "seed": self.seed,
            "settings": self.settings.model_dump(mode="json"),
            "task": self.config.model_dump(mode="json"),
        }

    def restore(self) -> None:
        """Take up the checkpoint."""
        if self.checkpoint is None:
            raise ConfigurationError("resume: a folder with a checkpoint is needed")
        tensors, stored = load_weights(self.checkpoint, CHECKPOINT_KIND)
        if any(stored.get(key) != value for key, value in self._description().items()):
            raise ConfigurationError(f"{self.checkpoint}.json: was made with another seed, settings or task")
        own = {f"network.{name}": value.numpy() for name, value in self.network.state_dict().items()}
        require(tensors, own, self.checkpoint)
        self.network.load_state_dict({name.removeprefix("network."): torch.from_numpy(tensors[name]) for name in own})
        restore_optimiser(self._optimiser, tensors, str(self.checkpoint))
        self.epoch = int(stored["epoch"])

    def _save(self) -> None:
        if self.checkpoint is None:
            return
        tensors = {f"network.{name}": value.numpy() for name, value in self.network.state_dict().items()}
        tensors |= optimiser_tensors(self._optimiser)
        save_weights(self.checkpoint, CHECKPOINT_KIND, tensors, {"epoch": self.epoch, **self._description()})

    def run(self, data: Labelled, progress: Callable[[str, int, int, float], None] | None) -> None:
        """The epochs that are left; the learning rate rises over the first twentieth and falls along a cosine."""
        settings = self.settings
        healthy_bound = self.config.leakage.class_bounds[0]
        per_epoch = math.ceil(len(data.flow_lpm) / settings.batch)
        label = torch.from_numpy((data.flow_lpm > healthy_bound).astype(np.float32))
        size = torch.from_numpy(np.log10(data.flow_lpm).astype(np.float32))
        classify, measure = nn.BCEWithLogitsLoss(), nn.HuberLoss(delta=0.3)
        self.network.train()
        while self.epoch < settings.epochs:
            order = np.random.default_rng([self.seed, self.epoch]).permutation(len(data.flow_lpm))
            losses = []
            for number, first in enumerate(range(0, len(order), settings.batch)):
                share = (self.epoch * per_epoch + number) / (settings.epochs * per_epoch)
                factor = min(share / 0.05, 1.0) * 0.5 * (1.0 + math.cos(math.pi * share))
                self._optimiser.param_groups[0]["lr"] = settings.learning_rate * max(factor, 1e-3)
                rows = order[first : first + settings.batch]
                output: Tensor = self.network(torch.from_numpy(data.signals[rows].astype(np.float32)))
                # Below the healthy bound the size is of no interest and cannot be seen.
                wanted = size[rows].clamp(min=math.log10(healthy_bound))
                loss = classify(output[:, 0], label[rows]) + settings.size_weight * measure(output[:, 1], wanted)
                self._optimiser.zero_grad(set_to_none=True)
                loss.backward()
                self._optimiser.step()
                losses.append(float(loss.detach()))
            self.epoch += 1
            self._save()
            if progress is not None:
                progress("training", self.epoch, settings.epochs, float(np.mean(losses)))
        self.network.eval()
