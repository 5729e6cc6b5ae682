"""Any controller of the project in a loop that is not ours: measured signals in, volts out."""

from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from hydro_agents.controllers.by_name import imported
from hydro_agents.controllers.flow_model import FlowModel
from hydro_env import ConfigurationError, TaskConfig
from hydro_env.plant.analysis import speed_limits
from hydro_env.task.kernel import observe
from hydro_env.task.record import RECORD, table
from hydro_env.task.sensors import CHANNEL_UNITS, CHANNELS
from hydro_env.task.settings import settings_of
from hydro_env.task.signals import POSITION, PRESSURE_A, PRESSURE_B, layout_of, observation_layout
from hydro_env.types import ByName, Mask
from hydro_env.units import FULL_VOLTAGE

OUT_OF_RANGE = 0.025  # share of its range by which a signal may lie outside; beyond (of 4–20 mA below 3.6), it is lost
LOST_TRAVEL = 1e-3  # m that the axis may travel at the present command after the first lost sample, which is allowed
LOST_TIME = 0.1  # s during which samples may be lost, even if the axis stands still
STOPPING_TIME = 0.01  # s in which the voltage goes from full command to the one that holds the axis
ENGINEERING = {"m": 1e-3, "Pa": 1e5, "1": 1e-2}  # SI units per mm, bar and %


class OwnLoop:
    """A controller between the sensors and the valve of your plant; the observation is the environment's own.

    Args:
        controller: a name (``"pid"``, ``"flow_linearising"``, ``"ppo"``), weights, gains, or an object with
            ``predict``; on a rig without shipped gains, a name searches for some, which takes a minute.
        task: rig, sensors and control period; ``ahead`` then lists the times, s, of the references ahead.
        head: a leakage head that watches, ``HeadDetector.load().on(task)``; ``leak`` holds its last answer.
        si: signals in m, Pa and fractions of the stroke of the spool; default: in mm, bar and %.

    Raises:
        ConfigurationError: the controller does not exist or does not fit the rig; in :meth:`step`, a signal is unknown,
            or the number of references is another.

    Example:
        >>> from hydro_agents.controllers.own_loop import OwnLoop
        >>> from hydro_env import TaskConfig
        >>> loop = OwnLoop("pid", TaskConfig())
        >>> f"{loop.step(11.0, position=10.0, pressure_a=35.0, pressure_b=65.0, spool_position=0.0):.1f} V"
        '4.4 V'
    """

    def __init__(self, controller: Any, task: TaskConfig, head: Any = None, si: bool = False) -> None:
        self.controller = imported("hydro_agents.learning.loading:load_controller")(controller, task, "own loop")
        self.ahead = tuple(count * task.control_period for count in task.preview_samples)
        self._places, self._head, self._period = [0, *task.preview_samples], head, task.control_period
        self._settings, self._layout, names = settings_of(task), layout_of(task), observation_layout(task)[0]
        self._model, self._travel = FlowModel(task.plant), max(speed_limits(task.plant)) * task.control_period
        self._units = np.array([1.0 if si else ENGINEERING[unit] for unit in CHANNEL_UNITS.values()])
        self._fitted = [place for place, name in enumerate(CHANNELS) if name in names]
        self._columns = np.array([names.index(CHANNELS[place]) for place in self._fitted])
        both = {PRESSURE_A, PRESSURE_B} <= set(self._fitted)
        self._for_rest = [POSITION, PRESSURE_A, PRESSURE_B] if both else [POSITION]
        low, high = (self._settings["channels"][end][0] for end in ("low", "high"))
        self._low, self._high = low - OUT_OF_RANGE * (high - low), high + OUT_OF_RANGE * (high - low)
        self.reset()

    def reset(self, volts: float = 0.0) -> None:
        """Begin anew at the next complete sample; ``volts`` is what the valve receives until then."""
        if not abs(volts) <= FULL_VOLTAGE:
            raise ConfigurationError(f"own loop: volts = {volts:g}: must be within ±{FULL_VOLTAGE:g}")
        self._record, self._reference = table(1, RECORD), np.zeros(max(self._places) + 1)
        self._record["command"] = volts / FULL_VOLTAGE
        self._before, self._at_rest, self.lost, self.holding = np.nan, 0.0, 0, False
        self._memory = self._watching = self.leak = None

    def step(self, reference: ArrayLike | None, **measured: float | None) -> float:
        """Voltage of the valve, V, for the sample of one control period.

        A lost signal (``None``, NaN, absent or out of range) keeps its last value. ``lost`` counts such samples in
        succession; after too many, ``holding`` is true and the voltage holds the axis until :meth:`reset`.

        Args:
            reference: desired position from the middle of the stroke, now, or now and at each of ``ahead``.
            measured: ``position``, ``pressure_a``, ``pressure_b`` (gauge), ``spool_position``: those that the rig has.
        """
        present, measured_si = self._read(reference, measured), self._record["measured"][0]
        command = kept = float(self._record["command"][0])
        complete = present.all()
        if complete:
            self._at_rest = self._model.voltage_at_rest(*measured_si[self._for_rest]) / FULL_VOLTAGE
        if complete or not np.isnan(self._before):
            command = self._answer(present)
            self._before = measured_si[POSITION]
        self.lost = 0 if complete and np.isfinite(command) else self.lost + 1
        command = float(np.clip(command, -1.0, 1.0)) if np.isfinite(command) else kept
        travel, largest = (self.lost - 1) * self._travel * abs(command), min(self._period / STOPPING_TIME, 1.0)
        self.holding = self.holding or travel > LOST_TRAVEL or self.lost * self._period > LOST_TIME
        if self.holding:
            command = kept + float(np.clip(self._at_rest - kept, -largest, largest))
        self._record["command"] = command
        return FULL_VOLTAGE * command

    def _read(self, reference: Any, measured: ByName) -> Mask:
        """Write a sample into the record, in SI units; whether each fitted sensor, and the reference, are present."""
        wanted = np.atleast_1d(np.asarray(reference, float)) * self._units[POSITION]  # None becomes NaN
        if not measured.keys() <= CHANNEL_UNITS.keys() or wanted.shape not in ((1,), (len(self._places),)):
            allowed = f"{', '.join(CHANNELS)}; 1 or {len(self._places)} references"
            raise ConfigurationError(f"own loop: {', '.join(measured)}; {wanted.size} references: must be {allowed}")
        sample = np.array([measured.get(name) for name in CHANNELS], float) * self._units
        present = (self._low <= sample) & (sample <= self._high)
        self._record["measured"][0, present] = sample[present]
        if np.isfinite(wanted).all():
            self._reference[self._places] = wanted
        return np.append(present[self._fitted], np.isfinite(wanted).all())

    def _answer(self, present: Mask) -> float:
        """The controller's command; the head reads the same observation, except lost signals."""
        observation = np.zeros((1, len(self._layout)), np.float32)
        observe(self._settings, self._layout, self._record, self._reference, observation, self._before)
        command, self._memory = self.controller.predict(observation.copy(), self._memory)
        if self._head:
            observation[0, self._columns[~present[:-1]]] = np.nan
            self.leak, self._watching = self._head.predict(observation, self._watching)
        return float(command[0, 0])
