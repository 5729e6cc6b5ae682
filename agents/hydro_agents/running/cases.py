"""Runs a controller on a list of independent episodes; their trajectories, and its errors on validation plants."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from hydro_agents.controllers.base import Controller, rows
from hydro_agents.running.seeds import SCALES
from hydro_env import ConfigurationError, ServoHydraulicVectorEnv, TaskConfig
from hydro_env.axes import Axes
from hydro_env.errors import at, reason
from hydro_env.plant.equations import Derived
from hydro_env.plant.states import State
from hydro_env.task.drawn_rigs import rig_tasks
from hydro_env.task.signals import POSITION
from hydro_env.types import Array, ByName, Floats, Indices, Mask, Singles

_SPOOL = State._fields.index("spool_position")
_SUPPLY_PRESSURE = State._fields.index("supply_pressure")
_SUPPLY_FLOW = Derived._fields.index("supply_flow")
_TRACES = ("position", "command", "spool", "supply_power", "reward")


class ControllerError(ConfigurationError):
    """A controller raised an exception or returned an invalid command."""


@runtime_checkable
class TrueStateController(Protocol):
    """An object that acts on true states instead of observations, such as the best found; not a controller."""

    def begin(self, axes: Axes) -> None:
        """Prepare for the axes whose episodes begin."""
        ...


@dataclass(frozen=True)
class Cases:
    """A list of N independent episodes, each with its seed, leak and reference family. All arrays (N,).

    Example:
        >>> import numpy as np
        >>> from hydro_agents.running.cases import Cases
        >>> cases = Cases(np.arange(4), leakage_flow_lpm=np.full(4, 0.5), families=np.full(4, "step"))
        >>> len(cases), cases.describe(2)
        (4, 'seed 2, reference step, leak 0.5 l/min')
    """

    seeds: Indices
    leakage_flow_lpm: Floats | None = None  # None: drawn
    families: NDArray[np.str_] | None = None  # None: drawn
    parameters: Mapping[str, Mapping[str, float | str]] | None = None  # of every plant, as the option of reset
    faults: Mapping[str, Floats] | None = None  # magnitudes by name, each (N,)

    def __len__(self) -> int:
        return len(self.seeds)

    def part(self, first: int, last: int) -> "Cases":
        """The cases from ``first`` to before ``last``."""
        chosen = slice(first, last)
        return Cases(
            self.seeds[chosen],
            rows(self.leakage_flow_lpm, chosen),
            rows(self.families, chosen),
            self.parameters,
            self.faults and {name: sizes[chosen] for name, sizes in self.faults.items()},
        )

    def chunks(self, size: int) -> "list[Cases]":
        """The cases in parts of at most ``size``."""
        return [self.part(first, first + size) for first in range(0, len(self), size)]

    @property
    def options(self) -> ByName:
        """What the cases fix, as the options of ``reset``."""
        fixed = {
            "leakage_flow_lpm": self.leakage_flow_lpm,
            "reference": None if self.families is None else self.families.tolist(),
            "parameters": self.parameters or None,
            "faults": self.faults or None,
        }
        return {name: value for name, value in fixed.items() if value is not None}

    def describe(self, case: int) -> str:
        """Seed, reference and leak of one case, for messages."""
        parts = [f"seed {self.seeds[case]}"]
        if self.families is not None:
            parts.append(f"reference {self.families[case]}")
        if self.leakage_flow_lpm is not None:
            parts.append(f"leak {self.leakage_flow_lpm[case]:g} l/min")
        return ", ".join(parts)


@dataclass(frozen=True)
class Rollout:
    """One episode of each case; N cases, T control periods; values at the T samples after the first.

    A case that fails (``terminated``) keeps the values of its last sample and gets no further reward.
    """

    time: Floats  # (T,), s
    position: Singles  # (N, T), m, true
    reference: Singles  # (N, T), m
    command: Singles  # (N, T), as limited, −1…1
    spool: Singles  # (N, T), true
    supply_power: Singles  # (N, T), W; flow that the valve draws, times supply pressure
    reward: Singles  # (N, T)
    failed_at: Indices  # (N,), step of the failure, −1 for none
    position_bias: Floats  # (N,), m; the sensor reads the true position plus this
    signals: Singles | None  # (N, S, T), chosen columns of the observation
    leakage_flow_lpm: Floats  # (N,), at the end


def run_cases(
    config: TaskConfig, controller: Controller, cases: Cases, signal_columns: Sequence[int] | Indices | None = None
) -> Rollout:
    """Run one episode of every case with a controller, all of them together.

    Args:
        config: the task.
        controller: the controller.
        cases: the episodes; the seed of each case draws all quantities that the case does not fix.
        signal_columns: columns of the observation to keep.

    Raises:
        ConfigurationError: the task draws from several rigs, or an episode cannot begin.
        ControllerError: the controller has no ``predict``, raised an exception, or did not return finite commands (N,
            1) with a state; the message names the case.

    Example:
        >>> import numpy as np
        >>> from hydro_agents.controllers.registry import make_controller
        >>> from hydro_agents.running.cases import Cases, run_cases
        >>> from hydro_env import TaskConfig
        >>> task = TaskConfig(episode_duration=0.5)
        >>> run = run_cases(task, make_controller("pid", task), Cases(np.arange(4)))
        >>> run.position.shape, run.failed_at.tolist()  # -1: no failure
        ((4, 100), [-1, -1, -1, -1])
    """
    check_predict(controller)
    if config.law and config.law.count > 1:
        raise ConfigurationError("law: a run is on one rig; rig_tasks(config) lists those of the law")
    rig = rig_tasks(config)[0]  # the task itself if it draws none
    count, steps = len(cases), rig.steps
    # NEXT_STEP shows the last sample of an episode before its axis restarts.
    env = ServoHydraulicVectorEnv(count, config, autoreset_mode="NextStep", info=False)
    with at("the run cannot begin"):
        observation, _ = env.reset(seed=cases.seeds.tolist(), options=cases.options)
    axes, memory = env.axes, None
    if isinstance(controller, TrueStateController):
        controller.begin(axes)
    traces = {name: np.zeros((count, steps), np.float32) for name in _TRACES}
    reference = axes.reference[:, 1 : steps + 1].astype(np.float32)
    signals = None
    if signal_columns is not None:
        signals = np.zeros((steps, count, len(signal_columns)), np.float32)
    failed_at = np.full(count, -1)
    flow = axes.column("leak_flow").copy()
    bias = axes.column("bias")[:, POSITION].copy()
    for step in range(steps):
        alive = failed_at < 0
        if signals is not None:
            signals[step] = observation[:, signal_columns]
            signals[step, ~alive] = signals[step - 1, ~alive]
        started = np.full(count, step == 0)
        action, memory = _act(controller, observation, memory, started, alive, cases, step * rig.control_period)
        observation, rewards, terminated, _, _ = env.step(action)
        state = axes.state
        now = {
            "position": axes.column("position"),
            "command": axes.column("command"),
            "spool": state[:, _SPOOL],
            "supply_power": state[:, _SUPPLY_PRESSURE] * axes.derived()[:, _SUPPLY_FLOW],
            "reward": rewards,
        }
        for name, trace in traces.items():  # a failed axis keeps its values, while its reference continues
            trace[:, step] = np.where(alive, now[name], 0.0 if name == "reward" else trace[:, step - 1])
        flow = np.where(alive, axes.column("leak_flow"), flow)
        failed_at[alive & terminated] = step
    env.close()
    return Rollout(
        time=rig.control_period * np.arange(1, steps + 1, dtype=float),
        reference=reference,
        failed_at=failed_at,
        position_bias=bias,
        signals=None if signals is None else signals.transpose(1, 2, 0),
        leakage_flow_lpm=flow,
        **traces,
    )


def check_predict(controller: Any) -> None:
    """Check that an object is a controller.

    Raises:
        ControllerError: the object has no method ``predict``, or is a class.
    """
    if isinstance(controller, type):
        raise ControllerError(f"{controller.__name__} is a class; a controller must be an instance of it")
    if not callable(getattr(controller, "predict", None)):
        what = type(controller).__name__
        raise ControllerError(f"{what} has no method predict(observation, state, episode_start, deterministic)")
    scaling = getattr(controller, "get_vec_normalize_env", lambda: None)()  # of stable-baselines3
    if scaling and scaling.norm_obs:
        raise ControllerError("VecNormalize scales its observations, predict does not: PolicyController.from_sb3 does")


def _act(
    controller: Controller, observation: Singles, memory: Any, started: Mask, alive: Mask, cases: Cases, time: float
) -> tuple[Array, Any]:
    """Commands (N, 1) of the controller, checked; an axis that has failed gets 0."""
    when = f"in a batch of {len(cases)} from {cases.describe(0)}, at {time:.3f} s"
    fault = "failed"
    try:
        answer = controller.predict(observation, memory, started, True)
        fault = "returned no pair of commands and state"
        commands, memory = answer
        action = np.asarray(commands, float)
    except (Exception, SystemExit) as error:  # sys.exit() in a controller must not end the command as if all were well
        raise ControllerError(f"{when}: predict {fault}: {reason(error)}") from error
    if action.shape != (len(cases), 1):
        raise ControllerError(f"{when}: predict returned commands of shape {action.shape}, must be ({len(cases)}, 1)")
    bad = np.flatnonzero(alive & ~np.isfinite(action[:, 0]))
    if len(bad):
        raise ControllerError(f"{cases.describe(bad[0])}, at {time:.3f} s: predict returned {action[bad[0], 0]}")
    return np.where(alive[:, None], action, 0.0), memory


def family_errors(
    config: TaskConfig, controller: Controller, plants: int = 16, sensor_frame: bool = False
) -> dict[str, float]:
    """Mean absolute tracking error (m) of a controller in each family of references, on training plants.

    The error is that of the true position, or, with ``sensor_frame``, of the position with the bias of its sensor.
    """
    families = [name for name, weight in config.references.weights.items() if weight > 0.0]
    seeds = np.tile(SCALES.take(plants, SCALES.count - plants), len(families))
    run = run_cases(config, controller, Cases(seeds, families=np.repeat(families, plants)))
    position: Array = run.position
    if sensor_frame:
        position = position + run.position_bias[:, None]
    errors = np.abs(position - run.reference).mean(axis=1).reshape(len(families), plants).mean(axis=1)
    return dict(zip(families, errors.tolist(), strict=True))
