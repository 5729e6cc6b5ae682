"""Trains the leakage head on windows of simulated axes: in many kinds of operation, with leaks and other faults."""

import math
import time
from collections.abc import Callable, Sequence
from itertools import pairwise
from pathlib import Path

import numpy as np
import torch
from torch import Tensor, nn

from hydro_agents.controllers.base import Controller
from hydro_agents.detection.dataset import LabelledWindows, training_jobs
from hydro_agents.detection.detector import threshold_at_false_alarm_rate
from hydro_agents.detection.features import CHANGE, FEATURES, LABELS, SPREAD, STILL
from hydro_agents.detection.head import (
    OUTPUTS,
    OUTSIDE,
    SMALLEST_FLOW,
    HeadSettings,
    LeakageHead,
    probabilities,
    standardised,
    tensors_like,
)
from hydro_agents.detection.intervals import COVERAGE, GROUPS, WIDTHS, distances, groups, quantiles
from hydro_agents.detection.training_settings import HeadTrainingSettings
from hydro_agents.running.jobs import run_jobs
from hydro_agents.running.seeds import HEAD_TRAINING, THRESHOLDS
from hydro_env import ConfigurationError, TaskConfig
from hydro_env.types import Arrays, Floats, Singles

NEVER_VARIED, INVALID = 1e-5, FEATURES.index("invalid features")
RIDGE = 0.05  # added to the covariance of the standardised features before inversion

WEIGHT_DECAY = 1e-3
SIZE_WEIGHT = 4.0  # of the size's error in the loss, relative to the classes

FALSE_ALARM_RATE = 0.01

CHANGING_SHARE = 0.15  # share of the windows that are treated as windows with a changing leak
OUTSIDE_RATE = 0.01  # share of undisturbed validation windows that each of the two limits of "outside" marks

Progress = Callable[[str, int, int, str], None]  # of phase, amount done, total amount, and a note


def make_network(width: int, inputs: int = len(FEATURES), dropout: float = 0.0) -> nn.Sequential:
    """The network: from features to the outputs of a head."""
    layers = []
    for before, after in pairwise((inputs, width, width // 2, OUTPUTS)):
        layers += [nn.Linear(before, after), nn.ReLU(), nn.Dropout(dropout)]
    return nn.Sequential(*layers[:-2])


def network_tensors(network: nn.Sequential) -> Arrays:
    """Weights and biases of a network, under the names of a head's tensors."""
    tensors = {}
    for number, layer in enumerate(layer for layer in network if isinstance(layer, nn.Linear)):
        for name, values in layer.named_parameters():
            tensors[f"{name}_{number}"] = values.detach().numpy().copy()
    return tensors


def train_head(
    config: TaskConfig,
    controllers: Sequence[Controller],
    settings: HeadTrainingSettings,
    seed: int = 0,
    progress: Progress | None = None,
    folder: Path | None = None,
) -> LeakageHead:
    """Train a head, and set its thresholds and intervals on validation plants.

    Args:
        config: the task; the head's shortest window is one episode.
        controllers: controllers of the axes in a part of the runs; the other runs have other kinds of operation. Drawn
            rigs have controllers for any axis instead.
        settings: settings of the training.
        seed: seed of data and network.
        progress: called as the work goes on; the note of the training is its loss.
        folder: keeps the simulated windows, and gives those that it has; ``None`` keeps none.

    Raises:
        ConfigurationError: the settings do not suit the task, or a run failed.
    """
    settings.check(config)
    torch.set_num_threads(1)  # more threads cost more than this small network gains
    began = time.monotonic()
    tell = progress or (lambda *_: None)

    def windows(phase: str, split: str, episodes: int, first_seed: int) -> LabelledWindows:
        jobs = training_jobs(config, controllers, settings, split, episodes, first_seed)
        found = run_jobs(jobs, folder, lambda _, done, total: tell(phase, done, total, ""))
        for result in found.values():
            if result.error:
                raise ConfigurationError(result.error)
        return LabelledWindows.joined([LabelledWindows(**found[key].metrics) for key in jobs])

    data = windows("data", "training", settings.episodes, HEAD_TRAINING.training(seed, settings.episodes).start)
    validation = windows("validation", "validation", settings.validation_episodes, THRESHOLDS.first)
    head = calibrated(fitted(data, settings, seed, tell), config, settings, validation)
    head.settings.training.update(seed=seed, seconds=round(time.monotonic() - began, 1))
    return head


def loss_of(output: Tensor, labels: Tensor, size: Tensor) -> Tensor:
    """Cross-entropy of the labels, and the pinball losses of the 5, 50 and 95 % quantiles of the size; means over N.

    The last label is that of a disturbed window.
    """
    functional = nn.functional
    wrong_label = functional.binary_cross_entropy_with_logits(output[:, : OUTSIDE + 1], labels, reduction="none")
    middle, below, above = output[:, -3:].unbind(1)
    found = torch.stack([middle - functional.softplus(below - 2.0), middle, middle + functional.softplus(above - 2.0)])
    shares = torch.tensor([[0.5 * (1.0 - COVERAGE)], [0.5], [0.5 * (1.0 + COVERAGE)]])
    error = size - found
    pinball = torch.maximum(shares * error, (shares - 1.0) * error)
    return wrong_label.sum(dim=1).mean() + SIZE_WEIGHT * pinball.sum(dim=0).mean()


def fitted(data: LabelledWindows, settings: HeadTrainingSettings, seed: int, progress: Progress) -> Arrays:
    """The tensors of a head whose network has learned from the windows, without thresholds and intervals."""
    features = data.features
    torch.manual_seed(seed)
    network = make_network(settings.width, features.shape[1], settings.dropout)
    optimiser = torch.optim.AdamW(network.parameters(), lr=settings.learning_rate, weight_decay=WEIGHT_DECAY)
    tensors = tensors_like(settings.width, features.shape[1]) | statistics_of(features)
    inputs = torch.from_numpy(standardised(features, tensors["mean"], tensors["scale"]))
    labels = torch.from_numpy(np.column_stack([data.labels, (data.disturbance >= 1.0).astype(np.float32)]))
    size = torch.from_numpy(size_target(data.size))
    total = len(inputs)
    per_epoch = math.ceil(total / settings.batch)
    for epoch in range(settings.epochs):
        order = np.random.default_rng([seed, epoch]).permutation(total)
        losses = []
        for number, first in enumerate(range(0, total, settings.batch)):
            share = (epoch * per_epoch + number) / (settings.epochs * per_epoch)
            optimiser.param_groups[0]["lr"] = settings.learning_rate_at(share)
            rows = order[first : first + settings.batch]
            loss = loss_of(network(inputs[rows]), labels[rows], size[rows])
            optimiser.zero_grad(set_to_none=True)
            loss.backward()
            optimiser.step()
            losses.append(float(loss.detach()))
        progress("training", epoch + 1, settings.epochs, f"loss {np.mean(losses):.4f}")
    return tensors | network_tensors(network)


def statistics_of(features: Singles) -> dict[str, Singles]:
    """The tensors that standardise and whiten the features of the training windows, (N, F)."""
    mean, deviation = features.mean(axis=0), features.std(axis=0)
    # What never varied cannot be judged: a rig's file may know a range where the law draws none.
    judged = (deviation > NEVER_VARIED) | (np.arange(len(deviation)) == INVALID)
    scale = np.where(judged, 1.0 / (deviation + 1e-3), 0.0).astype(np.float32)
    covariance = np.cov(standardised(features, mean, scale).T) + RIDGE * np.eye(len(mean))
    whitener = np.linalg.cholesky(np.linalg.inv(covariance)).astype(np.float32)
    return {"mean": mean, "scale": scale, "whitener": whitener}


def size_target(size: Floats) -> Singles:
    """log10 of the leak, but of at least the smallest one that counts."""
    return np.log10(np.maximum(size, SMALLEST_FLOW)).astype(np.float32)


def calibrated(
    tensors: Arrays, config: TaskConfig, settings: HeadTrainingSettings, windows: LabelledWindows
) -> LeakageHead:
    """The head with thresholds, intervals and the bound of "outside" from validation windows.

    The head does not answer at rest, so windows there do not count. Thresholds and intervals come from those with the
    task's own sensors and a laminar leak. The threshold of a leak gives 1 % false alarms among healthy axes without
    other faults; the threshold of any other label gives 1 % among axes without it. Intervals:
    :mod:`hydro_agents.detection.intervals`.
    """
    windows = windows.part((windows.disturbance == 0.0) & (windows.features[:, SPREAD] >= STILL))
    inputs = standardised(windows.features, tensors["mean"], tensors["scale"])
    head = LeakageHead(
        tensors,
        HeadSettings(
            task=config,
            window=config.steps,
            longest=settings.longest_window(config),
            threshold=0.5,
            width=settings.width,
            training={"settings": settings.model_dump(mode="json")},
        ),
    )
    output = head.outputs(inputs)
    strange = np.column_stack([np.linalg.norm(inputs @ tensors["whitener"], axis=1), output[:, OUTSIDE]])
    tensors["limit"] = np.quantile(strange, 1.0 - OUTSIDE_RATE, axis=0).astype(np.float32)
    windows, output = windows.part(windows.usual), output[windows.usual]
    clean = windows.plain & (windows.labels[:, 0] == 0.0)
    probability = probabilities(output)
    for label in range(len(LABELS)):
        without = clean if label == 0 else windows.labels[:, label] == 0.0
        tensors["thresholds"][label] = threshold_at_false_alarm_rate(probability[without, label], FALSE_ALARM_RATE)
    found, size = quantiles(output), size_target(windows.size)
    tensors["widths"] = np.quantile(found[:, 2] - found[:, 0], np.arange(1, WIDTHS) / WIDTHS).astype(np.float32)
    tensors["changing"][0] = np.quantile(windows.features[:, CHANGE], 1.0 - CHANGING_SHARE)
    group = groups(found, windows.features[:, CHANGE], tensors["widths"], tensors["changing"][0])
    for number in range(GROUPS):
        tensors["widening"][number] = distances(found, size, group == number)
    return LeakageHead(tensors, head.settings.changed(threshold=min(float(tensors["thresholds"][0]), 1.0)))
