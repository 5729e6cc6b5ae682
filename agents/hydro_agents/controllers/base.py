"""The one interface of all controllers: ``predict(observation, state, episode_start, deterministic)``."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from operator import attrgetter
from typing import Any, NamedTuple, Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from hydro_env import ConfigurationError, PlantParameters, TaskConfig
from hydro_env.files import Group
from hydro_env.plant.analysis import speed_limits
from hydro_env.task.configuration import preview_count
from hydro_env.task.signals import observation_layout
from hydro_env.types import Array, Floats, Mask, Singles

Observation = NDArray[np.floating[Any]]

MOVING = 0.04  # estimated speed, as a fraction of full speed, from which an axis moves; below it may be noise


class Controller(Protocol):
    """Turns measured signals into commands; the same signature as a stable-baselines3 model.

    ``predict`` takes one observation (n,) or a batch (N, n) and returns commands (1,) or (N, 1) and the controller's
    state (its memory). One rule applies: **predict never changes the state that it is given**; it returns a new one. A
    caller may keep any state and continue from it again, with the same results bit for bit.

    Example:
        >>> import numpy as np
        >>> from hydro_agents.controllers import ObservationLayout
        >>> from hydro_env import TaskConfig
        >>> class Proportional:
        ...     def __init__(self, config):
        ...         self.layout = ObservationLayout.of(config)
        ...     def predict(self, observation, state=None, episode_start=None, deterministic=True):
        ...         error = self.layout.si(observation, "tracking_error")  # m
        ...         return (50.0 * error[:, None]).astype(np.float32), state
        >>> action, _ = Proportional(TaskConfig()).predict(np.zeros((4, 13)))
        >>> action.shape
        (4, 1)
    """

    def predict(
        self, observation: Observation, state: Any = None, episode_start: Mask | None = None, deterministic: bool = True
    ) -> tuple[Singles, Any]:
        """Commands for the observations, and the state for the next call.

        Args:
            observation: (n,) or (N, n), as the environment scales it.
            state: the state that the previous call returned; ``None`` in the first call.
            episode_start: (N,), true if an episode begins with this observation; the state of that axis is reset.
            deterministic: without exploration noise.

        Returns:
            Commands as fractions of 10 V (the environment limits them to [−1, 1]), and the new state.
        """
        ...


@dataclass(frozen=True)
class ObservationLayout:
    """Layout of an observation: names, scales (SI units per 1), and the control period (s).

    Example:
        >>> import numpy as np
        >>> from hydro_agents.controllers import ObservationLayout
        >>> from hydro_env import TaskConfig
        >>> layout = ObservationLayout.of(TaskConfig())
        >>> layout.index("position"), layout.preview_times
        (5, (0.005, 0.01, 0.02, 0.04))
        >>> layout.si(np.full((1, 13), 0.5), "pressure_a")  # Pa
        array([2500000.])
    """

    names: tuple[str, ...]
    scale: tuple[float, ...]
    control_period: float

    @classmethod
    def of(cls, config: TaskConfig) -> "ObservationLayout":
        """The layout of a task's observations."""
        if config.law:
            raise ConfigurationError("law: a controller is made for one rig; rig_tasks(config) lists those of the law")
        names, _, scale, _ = observation_layout(config)
        return cls(names, tuple(scale.tolist()), config.control_period)

    def index(self, name: str) -> int:
        """Column of a signal.

        Raises:
            ConfigurationError: the observation holds no such signal.
        """
        if name not in self.names:
            raise ConfigurationError(f"the observation holds no '{name}'; it holds: {', '.join(self.names)}")
        return self.names.index(name)

    def si(self, observation: Observation, name: str) -> Floats:
        """A signal in SI units from a batch of observations (N, n)."""
        column = self.index(name)
        return observation[:, column].astype(np.float64) * self.scale[column]

    def speed_at_start(self, observation: Observation, full_speed: float) -> Floats:
        """Measured speed of axes that a controller takes over, m/s, (N,); 0 for those that rest but for noise."""
        speed = self.si(observation, "velocity_estimate")
        return np.where(np.abs(speed) > MOVING * full_speed, speed, 0.0)

    def needs(self, names: Sequence[str], reader: str) -> None:
        """Check that the observation holds the signals that a controller reads.

        Raises:
            ConfigurationError: the rig lacks a sensor.
        """
        absent = [name for name in names if name not in self.names]
        if absent:
            has_none = "and this rig has no such sensor; a PID needs the position alone"
            raise ConfigurationError(f"{reader}: reads {', '.join(absent)}, {has_none}")

    @property
    def preview_times(self) -> tuple[float, ...]:
        """Times in s by which the previews look ahead: whole control periods, which their names may not be."""
        prefix, period = "reference_preview_", self.control_period
        named = [1e-3 * float(name[len(prefix) : -len("ms")]) for name in self.names if name.startswith(prefix)]
        return tuple(shown_time(time, period) for time in named)

    def previews(self, observation: Observation) -> Floats:
        """Future reference minus present reference, m, shape (N, previews)."""
        columns = [i for i, name in enumerate(self.names) if name.startswith("reference_preview_")]
        return observation[:, columns].astype(np.float64) * np.array(self.scale)[columns]


def shown_time(time: float, period: float) -> float:
    """Time ahead, s, of the sample that an observation shows for a nominal time: the nearest whole period."""
    shown = preview_count(time, period) * period
    return time if abs(shown - time) < 1e-9 else shown


def check_layout(layout: ObservationLayout, config: TaskConfig) -> None:
    """Check that weights fit a task: its observations begin with those of the training; further ones are not read.

    Raises:
        ConfigurationError: names, scales or control period differ.
    """
    here, known = ObservationLayout.of(config), len(layout.names)
    if layout != replace(here, names=here.names[:known], scale=here.scale[:known]):
        raise ConfigurationError(
            "was trained on other observations (names, scales or control period) than those of this task"
        )


def as_batch(observation: Observation, memory: Any = None) -> tuple[Observation, bool]:
    """The observation as a batch (N, n), and whether it was a single one.

    Raises:
        ConfigurationError: the memory is that of another number of axes.
    """
    array = observation if hasattr(observation, "ndim") else np.asarray(observation)
    batch, single = (array[None], True) if array.ndim == 1 else (array, False)
    if (axes := _axes_of(memory)) not in (None, len(batch)):
        raise ConfigurationError(f"state: is that of {axes} axes, and the observations are those of {len(batch)}")
    return batch, single


def _axes_of(memory: Any) -> int | None:
    """Number of axes of a memory; ``None`` if it holds no array."""
    if isinstance(memory, tuple):
        return next((axes for part in memory if (axes := _axes_of(part)) is not None), None)
    return len(memory) if isinstance(memory, np.ndarray) and memory.ndim else None


def surely_zero(array: Any) -> bool:
    """Whether all elements are zero, for shortcuts that change no result.

    Always false while an export records the operations: a recorded shortcut would be valid for these data only.
    """
    return isinstance(array, np.ndarray) and not array.any()


# Classical controllers: a class of gains, and a class made from gains and task ---------------------------------------

Memory = TypeVar("Memory", bound=NamedTuple)


class ClassicalController:
    """A controller that is tuned, not trained; :data:`~hydro_agents.controllers.registry.CONTROLLERS` lists them.

    The task gives it the knowledge of an engineer: the layout of the observations, the control period, the latency, and
    the data sheet of the rig (``config.plant``). It does not know the plant that an episode draws. Its memory is a
    ``NamedTuple`` of arrays whose first axis counts the N axes. A subclass defines :meth:`act`, which reads the gains
    at each call: the exported code lets them change while the machine runs.
    """

    estimate_names: tuple[str, ...] = ()  # of the values of estimates

    def __init__(self, gains: Any, config: TaskConfig) -> None:
        self.gains, self.config, self.layout = gains, config, ObservationLayout.of(config)

    def predict(
        self, observation: Observation, state: Any = None, episode_start: Mask | None = None, deterministic: bool = True
    ) -> tuple[Singles, Any]:
        """Commands for the observations; see :class:`Controller`."""
        batch, single = as_batch(observation, state)
        command, state = self.act(batch, state, episode_start)
        command = np.clip(command, -1.0, 1.0)
        action = command.astype(np.float32)[:, None]
        return (action[0] if single else action), state

    def act(self, batch: Observation, state: Any, episode_start: Mask | None) -> tuple[Floats, Any]:
        """Commands before their limits, (N,), for a batch of observations, and the new memory."""
        raise NotImplementedError

    def estimates(self, memory: Any) -> Singles:
        """What the controller estimates, (N, estimates), numbers of order 1."""
        raise NotImplementedError


def gain(
    default: float,
    search: tuple[float, float],
    unit: str,
    description: str,
    low: float = 0.0,
    high: float = 1e9,
    logarithmic: bool = False,
    needs: str = "",
) -> Any:
    """A field of a class of gains, within ``low`` and ``high``, that tuning searches between two values.

    ``needs`` is the parameter of the plant, ``group.field``, without which the gain has no effect and tuning leaves it
    alone.
    """
    extra: Any = {"unit": unit, "range": (low, high), "search": search, "logarithmic": logarithmic, "needs": needs}
    return Field(default, ge=low, le=high, description=f"{unit}; {description}", json_schema_extra=extra)


log_gain = partial(gain, logarithmic=True)  # tuning searches over its logarithm


def search_space(gains: type[Group], plant: PlantParameters) -> dict[str, tuple[float, float, bool]]:
    """The fields that tuning searches on a plant: lower bound, upper bound, and whether over the logarithm.

    Bounds of a command per speed (s/m) are those of the paper's rig; on a faster rig they are lower.
    """
    space, slower = {}, max(speed_limits(PlantParameters())) / max(speed_limits(plant))
    for name, info in gains.model_fields.items():
        extra: Any = info.json_schema_extra or {}
        if "search" in extra and (not extra["needs"] or attrgetter(extra["needs"])(plant) != 0.0):
            factor = slower if extra["unit"] == "s/m" else 1.0
            low, high = extra["search"]
            space[name] = (factor * low, factor * high, extra["logarithmic"])
    return space


def rows(memory: Any, axes: Array | slice) -> Any:
    """Some rows of a memory: arrays, nested in named tuples; ``None`` stays."""
    if isinstance(memory, tuple):
        return type(memory)(*(rows(part, axes) for part in memory))
    return None if memory is None else memory[axes]


def restarted(memory: Memory | None, fresh: Memory, episode_start: Mask | None) -> Memory:
    """The memory, with ``fresh`` for the axes at the start of an episode; ``None``: for all axes."""
    if memory is None:
        return fresh
    if episode_start is None or not np.any(episode_start):
        return memory
    started = np.asarray(episode_start, bool)
    pairs = zip(memory, fresh, strict=True)
    return type(memory)(*(np.where(started.reshape(-1, *[1] * (a.ndim - 1)), b, a) for a, b in pairs))
