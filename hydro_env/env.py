"""The Gymnasium environment of one servo axis."""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import gymnasium as gym
import numpy as np
from numpy.typing import NDArray

from hydro_env.axes import Axes, failure_name
from hydro_env.errors import ConfigurationError
from hydro_env.plant.parameters import PlantParameters
from hydro_env.specification import PlainSpec
from hydro_env.task.configuration import REFERENCE_FAMILIES, TaskConfig, task_config
from hydro_env.task.record import Record
from hydro_env.units import resistance_from_flow

if TYPE_CHECKING:
    from hydro_env.rendering import AxisRenderer

Observation = NDArray[np.float32]
REWARD_TERMS = ("tracking", "effort", "failure")
_COLUMN = {name: index for index, name in enumerate(Record._fields)}
_LEAK, _POSITION, _REFERENCE, _VELOCITY = (_COLUMN[name] for name in ("leak_flow", "position", "reference", "velocity"))
_FAMILY, _FAILURE, _COST = (_COLUMN[name] for name in ("reference_family", "failure", "cost_tracking"))
_FIRST = np.zeros(1, dtype=np.int64)


class ServoHydraulicEnv(PlainSpec, gym.Env[Observation, NDArray[np.float32]]):
    """A hydraulic cylinder positions a load; its piston seal may leak, and the controller cannot see it.

    ## Description

    A servo valve meters oil into an asymmetric cylinder that moves a mass against a spring (the test rig of
    Kovari 2015, Table 1). The command of each control period (5 ms) comes from the signals that the rig measures; it
    reaches the valve 1 ms after they were sampled. In every episode the leakage past the piston is drawn anew,
    together with the parameters of the rig that are not known exactly, the initial position and the reference to be
    followed.

    ## Action Space

    | index | action | min | max | unit |
    |---|---|---|---|---|
    | 0 | valve command; ±1 is ±10 V, + extends | −1 | 1 | 10 V |

    Finite values outside are limited, as the valve drive does. NaN and other shapes are errors.

    ## Observation Space

    A ``Box`` of ``float32``; each entry is the measured value (SI) over a fixed scale. ``observation_names``,
    ``observation_units`` and ``observation_scale`` list them: ``observation * observation_scale`` is SI.

    | index | observation | scale | unit |
    |---|---|---|---|
    | 0 | reference | 0.1 | m |
    | 1–4 | preview: reference in 5, 10, 20, 40 ms minus reference now | 0.01 | m |
    | 5 | position | 0.1 | m |
    | 6 | velocity estimate (filtered difference of position) | 0.1 | m/s |
    | 7, 8 | pressure of chamber a (bore), b (rod) | 50 bar | Pa |
    | 9 | spool position | 1 | full stroke |
    | 10 | previous command | 1 | 10 V |
    | 11 | tracking error, reference minus measured position | 0.01 | m |
    | 12 | leaky integral of that error (time constant 0.5 s, limited to ±10 mm s) | 0.001 | m s |

    Signals carry the noise, bias, delay and 16-bit steps of the rig's transducers.

    ## Rewards

    The sum of named terms, each at most zero; their values stand in ``info["reward_terms"]``: ``tracking``
    (−|error|/10 mm, at most 5), ``effort`` (−0.05 (change of command)²), ``failure`` (−250, once).

    ## Starting State

    At rest at a random position inside the range of the references: pressures, spool and supply in equilibrium.

    ## Episode End

    ``terminated``: an end stop is met faster than 50 mm/s, or a pressure exceeds the rating of 250 bar, or the
    state leaves the range in which the model holds (``info["failure"]`` names it). ``truncated``: after 2 s.

    ## Arguments

    ``config``: YAML file, mapping or :class:`TaskConfig`; every field of ``TaskConfig`` may also be given as a
    keyword, ``gym.make("ServoHydraulic-v0", control_period=0.002, leakage={"healthy_share": 0.5})``.
    ``render_mode``: ``"rgb_array"`` or ``"human"``.

    ``reset(options=...)`` fixes parts of the next episode: ``leakage_resistance`` (Pa s/m³) or ``leakage_flow_lpm``
    (l/min at 100 bar), ``reference`` (array in m, one value per control period, or the name of a family),
    ``parameters`` (``{"load": {"mass": 80.0}}``), ``initial_position`` (m). With ``persist: True`` they also hold for
    the automatic resets that follow.

    ``info`` (for the judge, not for the controller): ``leakage_resistance``, ``leakage_flow_lpm``, ``leakage_class``
    (0 healthy, 1 incipient, 2 moderate, 3 severe), ``position``, ``velocity``, ``reference``, ``tracking_error`` (SI),
    ``reference_family``, ``failure``, ``reward_terms``.

    ## Version History

    * v0: first version.
    """

    metadata: dict[str, Any] = {"render_modes": ["human", "rgb_array"], "render_fps": 50}

    def __init__(
        self,
        config: TaskConfig | Mapping[str, Any] | str | Path | None = None,
        render_mode: str | None = None,
        **overrides: Any,
    ) -> None:
        if render_mode is not None and render_mode not in self.metadata["render_modes"]:
            raise ConfigurationError(f"render_mode = {render_mode!r}: must be 'human', 'rgb_array' or None")
        self.config = task_config(config, **overrides)
        self.render_mode = render_mode
        self._axes = Axes(self.config, 1)
        self.observation_space = self._axes.observation_space
        self.action_space = self._axes.action_space
        self.observation_names = self._axes.observation_names
        self.observation_units = self._axes.observation_units
        self.observation_scale = self._axes.scale
        self._size = len(self.observation_names)
        self._reward = np.zeros(1)
        self._terminated = np.zeros(1, dtype=np.bool_)
        self._truncated = np.zeros(1, dtype=np.bool_)
        self._class_bounds = [bound * (1 + 1e-9) for bound in self.config.leakage.class_bounds]
        self._seeded = False
        self._begun = False
        self._history: list[tuple[float, float]] = []
        self._renderer: AxisRenderer | None = None

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Begin an episode; see the class for ``options``.

        Raises:
            ConfigurationError: an option is unknown or impossible.
        """
        super().reset(seed=seed)
        self._axes.options.set(options, _FIRST)
        if seed is not None or not self._seeded:
            self._axes.seed(0, self.np_random)
            self._seeded = True
        observation = np.empty((1, self._size), dtype=np.float32)
        self._begun = False  # stays so where the plant cannot begin
        self._axes.begin(_FIRST, observation)
        self._begun = True
        self._history = []
        if self.render_mode is not None:
            self._note_history()
        if self.render_mode == "human":
            self.render()
        return observation[0], self._info()

    def step(self, action: NDArray[np.float32]) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """Advance one control period with a command in [−1, 1], shape (1,).

        Raises:
            ConfigurationError: the action is NaN, infinite or of another shape, or ``reset`` was not called.
        """
        try:
            command = np.array(action, dtype=np.float64)
        except (TypeError, ValueError):
            command = np.empty(0)
        if command.shape != (1,) or not abs(command[0]) < np.inf:
            shown = " ".join(repr(action).split())
            raise ConfigurationError(f"action = {shown}: must be one finite number within -1 to 1, shape (1,)")
        if not self._begun:
            raise ConfigurationError("step: call reset first")
        observation = np.empty((1, self._size), dtype=np.float32)
        self._axes.step(command, observation, self._reward, self._terminated, self._truncated)
        if self.render_mode is not None:
            self._note_history()
        if self.render_mode == "human":
            self.render()
        return (
            observation[0],
            float(self._reward[0]),
            bool(self._terminated[0]),
            bool(self._truncated[0]),
            self._info(),
        )

    def __getstate__(self) -> dict[str, Any]:
        """What a copy or a pickle holds: everything but the window or canvas, which a copy makes for itself."""
        return {**self.__dict__, "_renderer": None}

    @property
    def parameters(self) -> PlantParameters:
        """The physical parameters of the present episode, leakage included (for the judge)."""
        if not self._begun:
            raise ConfigurationError("parameters: call reset first")
        return self._axes.parameters(0)

    def _info(self) -> dict[str, Any]:
        row = self._axes.record[0].tolist()
        flow, position, reference = row[_LEAK], row[_POSITION], row[_REFERENCE]
        return {
            "leakage_resistance": resistance_from_flow(flow),
            "leakage_flow_lpm": flow,
            "leakage_class": bisect_left(self._class_bounds, flow),
            "position": position,
            "velocity": row[_VELOCITY],
            "reference": reference,
            "tracking_error": reference - position,
            "reference_family": REFERENCE_FAMILIES[int(row[_FAMILY])],
            "failure": failure_name(row[_FAILURE]),
            "reward_terms": {
                "tracking": -row[_COST],
                "effort": -row[_COST + 1],
                "failure": -row[_COST + 2],
            },
        }

    def _note_history(self) -> None:
        row = self._axes.record[0]
        self._history.append((row[_POSITION], row[_REFERENCE]))

    def render(self) -> NDArray[np.uint8] | None:
        """Draw the axis: an image (height, width, 3) with ``"rgb_array"``, a window with ``"human"``."""
        if self.render_mode is None:
            gym.logger.warn("render() draws nothing without a render_mode; give one to gym.make")
            return None
        if not self._begun:
            raise ConfigurationError("render: call reset first")
        if self._renderer is None:
            from hydro_env.rendering import AxisRenderer

            self._renderer = AxisRenderer(self.render_mode, self.metadata["render_fps"])
        return self._renderer.draw(self._view())

    def _view(self) -> Any:
        from hydro_env.rendering import View

        row = self._axes.record[0]
        state = self._axes.state[0]
        step = int(row[_COLUMN["step"]])
        cylinder = self.config.plant.cylinder
        history = np.array(self._history)
        parameters = self.parameters
        return View(
            time=step * self.config.control_period,
            position=state[0],
            velocity=state[1],
            reference=row[_COLUMN["reference"]],
            reference_preview=self._axes.reference[0, step + 1 : self.config.steps + 1].copy(),
            pressure_a=state[2],
            pressure_b=state[3],
            supply_pressure=state[7],
            spool_position=state[4],
            command=row[_COLUMN["command"]],
            leakage_flow_lpm=row[_COLUMN["leak_flow"]],
            external_force=self._axes.external_force(0),
            stroke=cylinder.stroke,
            bore_diameter=cylinder.bore_diameter,
            rod_diameter=cylinder.rod_diameter,
            has_spring=parameters.load.spring_stiffness > 0.0,
            history_time=self.config.control_period * np.arange(step + 1 - len(history), step + 1),
            history_position=history[:, 0],
            history_reference=history[:, 1],
        )

    def close(self) -> None:
        """Close the window, if there is one; may be called more than once."""
        if self._renderer is not None:
            self._renderer.close()
            self._renderer = None
        self._axes.close()
