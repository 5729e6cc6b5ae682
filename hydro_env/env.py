"""The Gymnasium environment of one servo axis."""

from importlib.util import find_spec
from typing import Any

import gymnasium as gym
import numpy as np
from numpy.typing import NDArray

from hydro_env.arguments import numbers, shown, whole_number
from hydro_env.axes import COLUMN, AxesState
from hydro_env.common import AxisEnvironment, Info
from hydro_env.errors import ConfigurationError
from hydro_env.plant.parameters import PlantParameters
from hydro_env.rendering import AxisRenderer
from hydro_env.task.configuration import Given, task_config
from hydro_env.task.record import FAILURES
from hydro_env.task.reference_signals import REFERENCE_FAMILIES
from hydro_env.task.rewards import REWARD_TERMS
from hydro_env.types import ByName, Singles
from hydro_env.units import resistance_from_flow

Observation = Singles
_FLOW, _CLASS, _POSITION, _VELOCITY, _REFERENCE = (
    COLUMN[name] for name in ("leak_flow", "leak_class", "position", "velocity", "reference")
)
_FAMILY, _FAILURE, _REWARD, _STEP, _FAULTY, _RIG = (
    COLUMN[name] for name in ("reference_family", "failure", "reward", "step", "faulty", "rig")
)
_TERMS = tuple(enumerate(REWARD_TERMS, COLUMN["costs"]))
_FIRST = np.zeros(1, np.int64)
RENDER_MODES = ("human", "rgb_array")  # with pygame
FRAMES_PER_SECOND = 50.0  # of a window


class ServoHydraulicEnv(AxisEnvironment, gym.Env[Observation, Singles]):
    """A hydraulic cylinder positions a load; its piston seal may leak, and the controller cannot see the leak.

    ## Description

    A servo valve meters oil into an asymmetric cylinder that moves a mass against a spring (the test rig of Kovari
    2015, Table 1). In each control period (5 ms) the controller computes a command from the measured signals; it
    reaches the valve 1 ms after sampling (or after a latency that is drawn: ``command_latency_range``). Every episode
    draws a new leakage past the piston, new values of the parameters that are not known exactly, an initial position
    and a reference.

    ## Action Space

    | index | action | min | max | unit |
    |---|---|---|---|---|
    | 0 | valve command; ±1 is ±10 V, + extends | −1 | 1 | 10 V |

    Finite values outside are clipped, like in the valve drive. NaN and other shapes are errors.

    ## Observation Space

    A ``Box`` of ``float32``; each entry is the measured value (SI) divided by a fixed scale. ``observation_names``,
    ``observation_units`` and ``observation_scale`` list them: ``observation * observation_scale`` is SI. With
    drawn rigs (``rig="drawn"``) the entries are others, in units of the rig: docs/drawn_rigs.md.

    | index | observation | scale | unit | min, max |
    |---|---|---|---|---|
    | 0 | reference | 0.1 | m | ±3 |
    | 1–4 | preview: reference in 5, 10, 20, 40 ms minus reference now | 0.01 | m | ±40 |
    | 5 | position | 0.1 | m | ±3 |
    | 6 | velocity estimate (filtered difference of position) | 0.1 | m/s | ±20 |
    | 7, 8 | pressure of chamber a (bore), b (rod) | 50 bar | Pa | ±8 |
    | 9 | spool position | 1 | full stroke | ±1 |
    | 10 | previous command | 1 | 10 V | ±1 |
    | 11 | tracking error, reference minus measured position | 0.01 | m | ±50 |
    | 12 | leaky integral of that error (time constant 0.5 s, limited to ±10 mm s) | 0.001 | m s | ±10 |

    Signals carry the noise, bias, delay and 16-bit steps of the rig's transducers.

    ## Rewards

    The sum of three terms, none above zero, in every control period; ``info["reward_terms"]`` holds their values. The
    error is that of the true position, so the bias of the sensor counts (``reward={"frame": "sensor"}`` leaves it out).

    | term | value |
    |---|---|
    | ``tracking`` | −(size of the error) / 10 mm, at least −5 |
    | ``effort`` | −0.05 (change of command)² |
    | ``failure`` | −250, once |

    ## Starting State

    At rest at a random position inside the range of the references: pressures, spool and supply in equilibrium. The
    position sensor reads the reference there, apart from noise; its bias (up to ±80 µm) shifts the true position.
    ``start="actual"`` puts the axis itself on the reference.

    ## Episode End

    ``terminated``: the piston hits an end stop faster than 50 mm/s, a pressure exceeds the rating of 250 bar, or the
    state leaves the range in which the model holds (``info["failure"]`` names the cause). ``truncated``: after 2 s.

    ## Arguments

    | argument of ``gym.make`` | meaning |
    |---|---|
    | ``task`` | name in ``configs/tasks``, or a YAML file |
    | ``rig`` | name in ``configs/rigs``, or a YAML file of a rig; references, sensors and reward follow |
    | ``rig="drawn"`` | every episode has another rig (docs/drawn_rigs.md); ``law={"split": "test"}`` changes the law |
    | a field of :class:`TaskConfig` | for example ``control_period=0.002``, ``leakage={"healthy_share": 0.5}`` |
    | ``config`` | the whole task: a :class:`TaskConfig`, a mapping, or the same as ``task`` |
    | ``render_mode`` | ``"rgb_array"``, or ``"human"`` for a window in real time |
    | ``info`` | ``True``; ``False`` for none; ``"flat"`` for numbers only, as array libraries need them |

    ``reset(options={...})`` fixes parts of the next episode:

    | option | value |
    |---|---|
    | ``leakage_flow_lpm`` | l/min at 100 bar across the piston, 0 to 20 |
    | ``reference`` | name of a family; or an array in m, one value per control period, whose last value is repeated |
    | ``parameters`` | of the rig: ``{"load": {"mass": 80.0}}`` |
    | ``initial_position`` | m, as the sensor measures it |
    | ``rig`` | number of a drawn rig |
    | ``faults`` | ``{"valve_null_shift": 0.01}``; names and units: :data:`hydro_env.task.faults.FAULTS` |

    ``info`` tells what the controller must not know; it serves evaluation alone:

    | entry | meaning |
    |---|---|
    | ``leakage_flow_lpm``, ``leakage_resistance`` | the leak now, l/min at 100 bar and Pa s/m³ |
    | ``leakage_class`` | 0 healthy, 1 incipient, 2 moderate, 3 severe |
    | ``position``, ``velocity``, ``reference``, ``tracking_error`` | true values, SI |
    | ``tip_position`` | of the second mass, if a rig of the task has one |
    | ``reference_family`` | name of the kind of reference |
    | ``failure`` | why the episode was terminated; ``"none"`` until then |
    | ``reward_terms`` | the three terms of the reward |
    | ``faults`` | size now of each fault besides the leak |
    | ``rig`` | number of the rig, if rigs are drawn |

    With ``info="flat"``, family and failure are indices, and the terms are called ``reward_tracking`` and so on.

    ``get_state()`` and ``set_state(state)`` save and restore everything, random numbers included: two continuations
    from the same state are equal bit for bit.

    ## Example

    ```pycon
    >>> import gymnasium as gym
    >>> import hydro_env
    >>> env = gym.make("ServoHydraulic-v0")
    >>> observation, info = env.reset(seed=1, options={"leakage_flow_lpm": 1.0})
    >>> observation, reward, terminated, truncated, info = env.step([0.2])
    >>> observation.shape, info["leakage_class"], sorted(info["reward_terms"])
    ((13,), 2, ['effort', 'failure', 'tracking'])

    ```

    ## Version History

    * v0: first version. Since version 0.2 of the package an episode begins where a controller that reads the biased
      sensor would hold the axis (``start="actual"`` restores the old start); the changelog lists all changes.
    """

    metadata: ByName = {"render_modes": list(RENDER_MODES) if find_spec("pygame") else [], "render_fps": 50}

    def __init__(
        self, config: Given = None, render_mode: str | None = None, info: bool | str = True, **overrides: Any
    ) -> None:
        if render_mode not in (None, *RENDER_MODES):
            raise ConfigurationError(f"render_mode = {shown(render_mode)}: must be 'human', 'rgb_array' or None")
        self._set_up(task_config(config, **overrides), 1, None, info)
        self.observation_space = self._axes.observation_space
        self.action_space = self._axes.action_space
        self.render_mode = render_mode
        self._renderer: AxisRenderer | None = None
        # Wrappers that record or show each step use this rate: real time, like the window.
        self.metadata = {**self.metadata, "render_fps": round(1.0 / self.rigs[0].control_period)}
        self._task = self.rigs[0]  # of the present episode

    def reset(self, *, seed: int | None = None, options: ByName | None = None) -> tuple[Observation, Info]:
        """Begin an episode; see the class for ``options``.

        Raises:
            ConfigurationError: an option is unknown or impossible.
        """
        super().reset(seed=None if seed is None else whole_number("seed", seed, 0))
        self._axes.options.set(options, _FIRST)
        if seed is not None or not self._seeded:
            self._axes.seed(0, self.np_random)
            self._seeded = True
        self._begin(_FIRST)
        self._task = self.rigs[int(self._axes.numbers[0, _RIG])]
        self._history = []
        self._record_frame()
        return self._axes.observation[0].copy(), self._info(self._axes.numbers[0].tolist())

    def step(self, action: Singles) -> tuple[Observation, float, bool, bool, Info]:
        """Advance one control period with a command in [−1, 1], shape (1,).

        Raises:
            ConfigurationError: the action is NaN, infinite or of wrong type or shape, or ``reset`` was not called.
        """
        command = numbers(action)
        if command is None or command.shape != (1,) or not abs(command[0]) < np.inf:
            raise ConfigurationError(f"action = {shown(action)}: must be finite, of shape (1,), such as [0.5]")
        self._require_begun("step")
        self._axes.step(command)
        if self.render_mode:
            self._record_frame()
        row = self._axes.numbers[0].tolist()
        return (
            self._axes.observation[0].copy(),
            row[_REWARD],
            row[_FAILURE] != 0.0,
            row[_STEP] >= self._task.steps,
            self._info(row),
        )

    def set_state(self, state: AxesState) -> None:
        """Continue from a state of :meth:`get_state`, bit for bit like the environment that returned it.

        Raises:
            ConfigurationError: ``state`` is not a state, has several axes, or belongs to another task.
        """
        super().set_state(state)
        self._task = self.rigs[int(self._axes.numbers[0, _RIG])]

    def __getstate__(self) -> ByName:
        """Content of a copy or a pickle: everything except the window or canvas, which the copy creates again."""
        return {**self.__dict__, "_renderer": None}

    @property
    def parameters(self) -> PlantParameters:
        """The physical parameters of the present episode, leakage included (hidden from the controller)."""
        self._require_begun("parameters")
        return self._axes.parameters(0)

    def _info(self, row: list[float]) -> Info:
        if self._info_kind is False:
            return {}
        flow, position, reference = row[_FLOW], row[_POSITION], row[_REFERENCE]
        terms = {}
        for index, name in _TERMS:  # three times as fast as a comprehension
            terms[name] = -row[index]
        info = {
            "leakage_resistance": resistance_from_flow(flow),
            "leakage_flow_lpm": flow,
            "leakage_class": int(row[_CLASS]),
            "position": position,
            "velocity": row[_VELOCITY],
            "reference": reference,
            "tracking_error": reference - position,
            "reference_family": REFERENCE_FAMILIES[int(row[_FAMILY])],
            "failure": FAILURES[int(row[_FAILURE])],
            "reward_terms": terms,
            "faults": {name: float(size[0]) for name, size in self._axes.faults().items()} if row[_FAULTY] else {},
        }
        if self.config.law:
            info["rig"] = int(row[_RIG])
        if self._axes.has_tip:
            info["tip_position"] = float(self._axes.tip_position()[0])
        if self._info_kind == "flat":
            info |= {"reference_family": int(row[_FAMILY]), "failure": int(row[_FAILURE])}
            del info["reward_terms"], info["faults"]
            info |= {f"fault_{name}": float(size[0]) for name, size in self._axes.drawn_faults().items()}
            info |= {f"reward_{name}": value for name, value in terms.items()}
            return {name: np.asarray(value)[()] for name, value in info.items()}  # NumPy's numbers have a dtype
        return info

    def _record_frame(self) -> None:
        """Add the present position to the drawn curve; a window shows some of them, in real time."""
        if not self.render_mode:
            return
        row = self._axes.numbers[0]
        self._history.append((row[_POSITION], row[_REFERENCE]))
        if self.render_mode == "human" and row[_STEP] % self._periods_per_frame() == 0:
            self.render()

    def _periods_per_frame(self) -> int:
        return max(round(1.0 / (FRAMES_PER_SECOND * self._task.control_period)), 1)

    def render(self) -> NDArray[np.uint8] | None:
        """Draw the axis: an image (height, width, 3) with ``"rgb_array"``, a window with ``"human"``."""
        if not self.render_mode:
            gym.logger.warn("render() draws nothing without a render_mode; give one to gym.make")
            return None
        self._require_begun("render")
        if not self._renderer:
            self._renderer = AxisRenderer(self.render_mode)
        return self._renderer.draw(self._axes, self._history, self._periods_per_frame() * self._task.control_period)

    def close(self) -> None:
        """Close the window, if there is one; may be called more than once."""
        if self._renderer:
            self._renderer.close()
            self._renderer = None
        self._axes.close()
