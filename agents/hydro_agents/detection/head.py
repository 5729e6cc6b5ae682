"""The leakage head: from 2 to 8 s of measured signals to leak, size, other faults, and "outside the training".

It works under any operation of the axis, because it reads only measured signals: beside any controller, ``predict``
takes the same observations. A small network evaluates the flow balance of the window
(:mod:`hydro_agents.detection.balance`) and statistics of its motion (:mod:`hydro_agents.detection.features`).
"""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from pydantic import ConfigDict, Field

from hydro_agents.controllers.base import Observation, as_batch
from hydro_agents.detection.damaged_signals import stuck_sensors
from hydro_agents.detection.detector import SIGNALS, MeasuredColumns
from hydro_agents.detection.features import CHANGE, FEATURES, LABELS, SPREAD, STILL, features_of
from hydro_agents.detection.intervals import GROUPS, SIZES, WIDTHS, groups, intervals, quantiles
from hydro_agents.detection.sheet import RIG_FEATURES, leak_scale, rig_features, sheet_of
from hydro_agents.running.weights import load_weights, save_weights
from hydro_env import ConfigurationError, TaskConfig
from hydro_env.files import Group, validate
from hydro_env.task.sensors import SENSORS, SPOOL
from hydro_env.types import Array, ByName, Floats, Indices, Mask, Singles

KIND = "leakage head"

SHORTEST_WINDOW, LONGEST_WINDOW = 50, 1_000_000  # observations; fewer carry no information

LARGEST_WIDTH, LAYERS = 1024, 3

OUTSIDE, OUTPUTS = len(LABELS), len(LABELS) + 4  # the logit of a disturbance; three numbers for the quantiles
UPDATES_PER_WINDOW = 16  # number of new estimates of predict per window; between two estimates it repeats the last one

SMALLEST_FLOW, LARGEST_FLOW = 0.01, 100.0
"""In the rig's unit of leaks (:func:`~hydro_agents.detection.sheet.leak_scale`); smaller leaks count as none: an
interval that begins there begins at 0. No answer is larger."""

BATCH = 512  # windows that are read together
LARGEST_INPUT = 8.0  # limit of a feature, in standard deviations from its mean in training


class LeakageEstimate(NamedTuple):
    """Estimate of the head, each (N,); NaN until a whole window of observations is known.

    The five probabilities are independent answers, because a leak may occur together with another fault.
    """

    probability: Floats  # of a leak past the piston, 0 to 1
    flow_lpm: Floats  # its size, l/min at 100 bar
    low_lpm: Floats  # 90 % interval of the size
    high_lpm: Floats
    external_leak: Floats  # probability of a leak past the rod seal
    valve_fault: Floats  # of null shift, worn edges, changed flow or hysteresis
    sensor_fault: Floats  # of offset, gain, freeze or drop-out
    return_line: Floats  # of raised tank pressure
    outside: Floats  # the answer does not count: 1: unlike the training, or a stuck sensor; 2: at rest


AT_REST = 2.0  # of ``outside``: the axis does not move

BESIDE_STUCK_SENSOR = {
    "probability": 0.5,
    "low_lpm": 0.0,
    "high_lpm": LARGEST_FLOW,
    "sensor_fault": 1.0,
    "outside": 1.0,
}
"""The answer with a stuck sensor: the sensor is faulty, and the leak is unknown."""


class HeadSettings(Group):
    """Settings of inference: what the JSON beside the weights holds, besides the names of signals and features."""

    model_config = ConfigDict(extra="ignore", allow_inf_nan=False)

    task: TaskConfig  # observations, and data sheet of the axis
    window: int = Field(ge=SHORTEST_WINDOW, le=LONGEST_WINDOW)  # observations, as ``predict`` reads
    longest: int = Field(ge=SHORTEST_WINDOW, le=LONGEST_WINDOW)  # observations
    threshold: float = Field(ge=0.0, le=1.0)  # probability of a leak: 1 % false alarms in validation
    width: int = Field(ge=2, le=LARGEST_WIDTH)  # of the network
    training: ByName

    @property
    def law(self) -> ByName | None:
        """The law of the rigs of the training; ``None``: it has served one rig."""
        return self.training.get("settings", {}).get("law")


def check_sensors(config: TaskConfig, needed: Sequence[str] = SENSORS) -> None:
    """Check that a rig has the sensors that a head needs.

    Raises:
        ConfigurationError: it lacks one.
    """
    if absent := [name for name in needed if not getattr(config.sensors, name).fitted]:
        raise ConfigurationError(
            f"leakage head: reads {', '.join(absent)}, but this rig has no such sensor; hydro diagnose reads the leak "
            "without it"
        )


class HeadState(NamedTuple):
    """Memory of the head; no call changes its argument."""

    history: tuple[Singles, ...]  # measured columns (N, C), at most a window of them, newest last
    seen: Indices  # observations since the start of each axis's episode, (N,)
    answer: Floats  # the last estimate, (N, fields of LeakageEstimate)


def tensors_like(width: int, inputs: int = len(FEATURES)) -> dict[str, Singles]:
    """Zeros of the names, shapes and types of a head's tensors."""
    sizes = (inputs, width, width // 2, OUTPUTS)
    shapes = {
        "mean": (inputs,),
        "scale": (inputs,),
        "whitener": (inputs, inputs),
        "limit": (2,),  # of the distance from the training, and of the logit of a disturbance
        "widths": (WIDTHS - 1,),
        "changing": (1,),
        "widening": (GROUPS, len(SIZES), 2),
        "thresholds": (len(LABELS),),
    }
    for layer in range(LAYERS):
        shapes |= {f"weight_{layer}": (sizes[layer + 1], sizes[layer]), f"bias_{layer}": (sizes[layer + 1],)}
    return {name: np.zeros(shape, np.float32) for name, shape in shapes.items()}


def standardised(features: Singles, mean: Array, scale: Array) -> Singles:
    """Inputs of the network, (N, F)."""
    return np.clip((features - mean) * scale, -LARGEST_INPUT, LARGEST_INPUT)


def probabilities(output: Floats) -> Floats:
    """Probability of each label, (N, labels)."""
    return 1.0 / (1.0 + np.exp(-output[:, : len(LABELS)]))


class LeakageHead:
    """The trained network and its settings.

    ``predict`` processes one step at a time, with the signature of a controller; ``estimate_windows`` takes whole
    windows of signals in SI units.

    Example:
        >>> import numpy as np
        >>> from hydro_agents.detection.detector import measured_run
        >>> from hydro_agents.detection.head import LeakageHead
        >>> from hydro_agents.learning.loading import shipped
        >>> from hydro_agents.running.cases import Cases
        >>> from hydro_agents.running.folders import pretrained_folder
        >>> head = LeakageHead.load(pretrained_folder() / "leakage_head")
        >>> task = head.settings.task
        >>> cases = Cases(np.arange(2), np.array([0.01, 1.0]), np.full(2, "multi_sine"))
        >>> signals, _ = measured_run(task, shipped("pid", task), cases)
        >>> leak = head.estimate_windows(signals)
        >>> (leak.probability > head.settings.threshold).tolist()
        [False, True]
    """

    def __init__(self, tensors: Mapping[str, Array], settings: HeadSettings) -> None:
        self.tensors = {name: np.asarray(values, np.float32) for name, values in tensors.items()}
        self.settings = settings
        self._measured = MeasuredColumns.of(settings.task)
        self.rows, self.columns, scale = self._measured  # a rig may lack the spool sensor
        self.scale = np.ones(len(SIGNALS))
        self.scale[self.rows] = scale
        self.sheet = sheet_of(settings.task, self.for_any_axis)
        self.leak_scale = leak_scale(settings.task)
        self.rig = rig_features(settings.task) if self.for_any_axis else np.empty(0, np.float32)
        self.interval = max(settings.window // UPDATES_PER_WINDOW, 1)

    @property
    def for_any_axis(self) -> bool:
        """Whether it was trained on drawn rigs."""
        return self.settings.law is not None

    def moved_to(self, config: TaskConfig) -> "LeakageHead":
        """A head for any axis on the rig of another task, with windows of the same durations.

        It reads a rig without a spool sensor as well.

        Raises:
            ConfigurationError: the head serves the rig of its training alone, or the rig lacks a sensor.
        """
        if not self.for_any_axis:
            raise ConfigurationError("moved_to: must be a leakage head for any axis")
        check_sensors(config, SENSORS[:SPOOL])
        times = self.settings.task.control_period / config.control_period
        sizes = self.settings.window, self.settings.longest
        window, longest = (max(round(size * times), SHORTEST_WINDOW) for size in sizes)
        return LeakageHead(self.tensors, self.settings.changed(task=config, window=window, longest=longest))

    def predict(
        self,
        observation: Observation,
        state: HeadState | None = None,
        episode_start: Mask | None = None,
        deterministic: bool = True,
    ) -> tuple[Floats, HeadState]:
        """The fields of :class:`LeakageEstimate`, (9,) or (N, 9), and the memory for the next call.

        They are NaN until a whole window of observations is known, and are then updated :data:`UPDATES_PER_WINDOW`
        times per window. The arguments are those of a controller (:class:`~hydro_agents.controllers.base.Controller`).
        """
        batch, single = as_batch(observation, state)
        if state is None:
            nothing = np.full((len(batch), len(LeakageEstimate._fields)), np.nan)
            state = HeadState((), np.zeros(len(batch), np.int64), nothing)
        seen, answer = state.seen + 1, state.answer.copy()
        if episode_start is not None:
            seen[episode_start], answer[episode_start] = 1, np.nan
        history = (*state.history, np.asarray(batch[:, self.columns], np.float32))[-self.settings.window :]
        late = seen - self.settings.window
        due = (late >= 0) & (late % self.interval == 0)
        if due.any():
            window = np.stack(history)[:, due].transpose(1, 2, 0)
            answer[due] = np.column_stack(self.estimate_windows(self._measured.si(window)))
        return (answer[0] if single else answer), HeadState(history, seen, answer)

    def estimate_windows(self, signals: Array) -> LeakageEstimate:
        """Estimate from SIGNALS, (N, 5, T), in SI units; NaN where a sample is lost or a sensor absent.

        If the windows are longer than those of the training, the head reads their end.

        Raises:
            ConfigurationError: the shape is wrong, or the windows are too short.
        """
        shape = np.shape(signals)
        if len(shape) != 3 or shape[1] != len(SIGNALS) or shape[2] < self.settings.window:
            raise ConfigurationError(
                f"leakage head: signals have shape {shape}: must be (N, {len(SIGNALS)}, T) with T of at least "
                f"{self.settings.window}"
            )
        signals = signals[:, :, -self.settings.longest :]
        answers = np.empty((len(signals), len(LeakageEstimate._fields)))
        for first in range(0, len(signals), BATCH):
            part = np.asarray(signals[first : first + BATCH], np.float64)
            answer = answers[first : first + BATCH]
            answer[:] = self.judge(features_of(part, self.sheet))
            stuck = stuck_sensors(part, self.settings.task).any(axis=1)
            for name, value in BESIDE_STUCK_SENSOR.items():
                answer[stuck, LeakageEstimate._fields.index(name)] = value
        return LeakageEstimate(*answers.T)

    def judge(self, features: Singles) -> Floats:
        """Fields of :class:`LeakageEstimate`, (N, 9), from the features of windows (N, F)."""
        tensors = self.tensors
        rig = np.tile(self.rig, (len(features), 1))  # empty in a head for one rig
        inputs = standardised(np.concatenate([features, rig], axis=1), tensors["mean"], tensors["scale"])
        output = self.outputs(inputs)
        probability = probabilities(output)
        sizes = self._sizes(output, features)
        strangeness = np.sqrt(np.sum((inputs @ tensors["whitener"]) ** 2, axis=1))
        farthest, most_disturbed = tensors["limit"]
        outside = np.maximum(strangeness - farthest, output[:, OUTSIDE] - most_disturbed) > 0.0
        # At rest a shifted or worn valve looks like a leak; the estimator tells them apart, or says that it cannot.
        outside = np.where(features[:, SPREAD] < STILL, AT_REST, 1.0 * outside)
        return np.column_stack([probability[:, 0], sizes, probability[:, 1:], outside]).astype(np.float64)

    def _sizes(self, output: Floats, features: Singles) -> Floats:
        """The leak and the ends of its interval, l/min at 100 bar, (N, 3), from the outputs of the network."""
        tensors = self.tensors
        found = quantiles(output)
        group = groups(found, features[:, CHANGE], tensors["widths"], tensors["changing"][0])
        chosen = (group[:, None] == np.arange(GROUPS)).astype(np.float32)
        distance = (chosen @ tensors["widening"].reshape(GROUPS, -1)).reshape(-1, len(SIZES), 2)
        sizes = 10.0 ** np.clip(intervals(found, distance), np.log10(SMALLEST_FLOW), np.log10(LARGEST_FLOW))
        sizes[:, 1] = np.where(sizes[:, 1] <= 1.05 * SMALLEST_FLOW, 0.0, sizes[:, 1])
        if self.leak_scale != 1.0:
            sizes = sizes * self.leak_scale
        return sizes

    def outputs(self, inputs: Singles) -> Floats:
        """Outputs of the network, (N, OUTPUTS), from standardised features."""
        values = inputs
        for layer in range(LAYERS):
            values = values @ self.tensors[f"weight_{layer}"].T + self.tensors[f"bias_{layer}"]
            if layer < LAYERS - 1:
                values = np.maximum(values, 0.0)
        return values.astype(np.float64)

    def save(self, path: str | Path) -> Path:
        """Write weights and settings; see :func:`hydro_agents.running.weights.save_weights`."""
        settings = {
            "task": self.settings.task.model_dump(mode="json"),
            "signals": list(SIGNALS),
            "features": [*FEATURES, *(RIG_FEATURES if self.for_any_axis else ())],
        }
        others = self.settings.model_dump(mode="json", exclude=set(settings))
        return save_weights(path, KIND, self.tensors, settings | others)

    @classmethod
    def load(cls, path: str | Path) -> "LeakageHead":
        """Read what ``save`` wrote.

        Raises:
            ConfigurationError: missing, damaged or foreign files.
        """
        tensors, settings = load_weights(path, KIND)
        stored = validate(HeadSettings, settings, path)
        known = FEATURES if stored.law is None else FEATURES + RIG_FEATURES
        if settings.get("signals") != list(SIGNALS) or settings.get("features") != list(known):
            raise ConfigurationError(f"{path}: was trained on other signals or features than this version reads")
        if stored.longest < stored.window:
            raise ConfigurationError(f"{path}: longest = {stored.longest}: must be at least window = {stored.window}")
        like = tensors_like(stored.width, len(known))
        for name, zeros in like.items():
            if name not in tensors or tensors[name].shape != zeros.shape or not np.isfinite(tensors[name]).all():
                raise ConfigurationError(f"{path}: tensor '{name}': must be finite, of shape {zeros.shape}")
        return cls({name: tensors[name] for name in like}, stored)
