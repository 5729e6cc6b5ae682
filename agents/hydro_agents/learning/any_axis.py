"""Inputs of a policy for any axis: of the same number and meaning on every rig."""

import math

import numpy as np

from hydro_agents.controllers.base import ClassicalController, Controller
from hydro_agents.controllers.flow_linearising import FlowLinearising, FlowLinearisingGains
from hydro_agents.controllers.registry import kind_of
from hydro_agents.learning.features import (
    AVERAGED,
    AVERAGING_TIMES,
    HISTORY_LAGS,
    HISTORY_SIGNALS,
    PREVIEW_SCALE,
    Normalisation,
    PolicyFeatures,
)
from hydro_agents.learning.rig_gains import GainsFor, chosen_gains
from hydro_agents.running.cases import family_errors
from hydro_agents.running.seeds import SCALES
from hydro_env import TaskConfig, task_config
from hydro_env.task.paces import full_speed, pace, periods_per_step
from hydro_env.task.signals import data_sheet
from hydro_env.types import ByName, Floats, Singles

PREVIEW_PACES = (0.5, 1.0, 1.5, 2.0, 3.0, 4.0, 5.0)  # of the reference that a policy for any axis sees
FINER_PACES = (0.25, 0.75)  # more of them for one that acts alone
USUAL_ERROR = 0.03  # of untuned flow linearisation, as a part of the travel at full speed in a pace; on the paper's rig
CORRECTION_RANGE = (0.1, 3.0)  # of the correction's size, relative to that at the usual error
ERROR_PLANTS = 8  # plants of each family of references on which the error is simulated


class AnyAxisFeatures(PolicyFeatures):
    """Inputs of the same number and meaning on every rig, each in units of its own size under the corrected controller.

    They are the measured signals, the reference some paces ahead, what the corrected controller commands and estimates,
    a history in steps of the rig, and the data sheet. On a rig without a spool sensor the last command replaces it.

    A policy that acts alone has units by similarity: those of untuned flow linearisation on the rig of its task, on
    another rig in proportion to full speed, pace, stroke and supply pressure. One law for dimensionless numbers serves
    all.

    A correction is as large as the rig allows: in proportion to the travel that the corrected controller's error is.

    Args:
        config: the task on a rig.
        base: the controller that the policy corrects, with its gains for any rig; ``None``: it acts alone.
        correction: command per 1 of the policy's output where that error is :data:`USUAL_ERROR`.
        error: the error, as a part of the travel at full speed in a pace; :meth:`normalised` simulates it.
        samples: number of samples of the history, the newest; default: all. A policy with a memory needs one.
    """

    for_any_axis = True
    see_correction = True
    normalising_seeds = SCALES.take(60)

    def __init__(
        self,
        config: TaskConfig,
        base: ClassicalController | None,
        correction: float = 0.2,
        error: float = USUAL_ERROR,
        samples: int | None = None,
    ) -> None:
        periods = periods_per_step(config)
        lags = tuple(max(round(lag * periods), place) for place, lag in enumerate(HISTORY_LAGS[:samples], 1))
        factor = float(np.clip(error / USUAL_ERROR, *CORRECTION_RANGE))
        super().__init__(config, base, correction * factor, full_preview=True, see_estimates=True, lags=lags)
        self.correction, self.error = correction, error
        self._paces = np.array(PREVIEW_PACES if base else sorted((*PREVIEW_PACES, *FINER_PACES)))
        own, horizon = pace(config), self._preview.horizon
        ahead = np.minimum(self._paces * own / config.control_period, horizon)
        columns = np.arange(horizon + 2)[:, None] - 1.0  # −1: the sample before now
        weights = np.maximum(1.0 - np.abs(columns - ahead), 0.0)  # linear between samples
        weights[1] -= 1.0
        before = np.zeros((horizon + 2, 1))
        before[:2, 0] = -own / config.control_period, own / config.control_period
        self._weights = np.concatenate([weights, before], axis=1) / PREVIEW_SCALE
        reach = horizon * config.control_period / own
        more = [min(reach, 8.0) / 4.0, math.log(error / USUAL_ERROR)]
        self._sheet = np.array([*data_sheet(config).values(), *more], np.float32)

    @property
    def leader(self) -> ClassicalController:
        """The controller in whose units the inputs are: the corrected one, or untuned flow linearisation."""
        return self.base or FlowLinearising(FlowLinearisingGains(), self.config)

    def _natural_sizes(self) -> Floats:
        """Sizes of the inputs that move, by which rigs are compared, (moving,)."""
        plant, own = self.config.plant, pace(self.config)
        speed, reach = full_speed(plant), self._preview.horizon * self.config.control_period
        sizes = dict.fromkeys(HISTORY_SIGNALS, 1.0) | dict.fromkeys(("pressure_a", "pressure_b"), plant.supply.pressure)
        sizes |= {"position": 0.5 * plant.cylinder.stroke, "velocity_estimate": speed, "tracking_error": speed * own}
        scale = np.array(self.layout.scale)[self._columns]
        signals = np.array(list(sizes.values())) / scale
        changes = np.tile(signals, (len(self.lags), 1))
        changes[:, 0] = speed * self.config.control_period * np.array(self.lags) / scale[0]
        ahead = np.minimum(np.array([*self._paces, 1.0]) * own, reach) * speed / PREVIEW_SCALE
        averages = np.tile(signals[[HISTORY_SIGNALS.index(name) for name in AVERAGED]], len(AVERAGING_TIMES))
        return np.concatenate([signals, ahead, averages, changes.ravel()])

    @property
    def size(self) -> int:
        """Number of inputs: those that move, and the data sheet."""
        return self.moving + len(self._sheet)

    def _seen(self, inputs: Singles, signals: Singles, reference: Floats) -> list[Singles]:
        del inputs
        return [signals, (reference @ self._weights).astype(np.float32)]

    def _normalised(self, parts: list[Singles]) -> Singles:
        moving = super()._normalised(parts)
        if self.normalisation is None:
            return moving
        return np.concatenate([moving, np.tile(self._sheet, (len(moving), 1))], axis=1, dtype=np.float32)

    def describe(self) -> ByName:
        """All data to build this object again (JSON)."""
        own = {"any_axis": True, "correction": self.correction, "error": self.error}
        return super().describe() | own | {"history_signals": list(HISTORY_SIGNALS)}

    def normalised(self, leader: Controller | None = None) -> "AnyAxisFeatures":
        """The same features with the error of the corrected controller and normalised by its values, by simulation."""
        leader = leader or self.leader
        if self.base is None:
            return super().normalised(leader)
        errors = family_errors(self.config, leader, ERROR_PLANTS, sensor_frame=True)
        error = math.exp(np.mean(np.log(list(errors.values())))) / (full_speed(self.config.plant) * pace(self.config))
        return PolicyFeatures.normalised(
            AnyAxisFeatures(self.config, self.base, self.correction, error, len(self.lags))
        )

    def moved_to(self, config: TaskConfig, gains: GainsFor = chosen_gains) -> "AnyAxisFeatures":
        """The same features on another rig: there a simulation finds the corrected controller's gains and the units.

        Raises:
            ConfigurationError: the rig lacks a sensor that the corrected controller reads.
        """
        base = self.leader
        type(base)(base.gains, config)  # names a missing sensor
        usual = task_config(config, episode_duration=TaskConfig().episode_duration)  # longer ones find other gains
        own = self.base and type(base)(gains(kind_of(base), usual), usual)
        moved = AnyAxisFeatures(usual, own, self.correction, samples=len(self.lags))
        if own is None and isinstance(self.normalisation, Normalisation):
            ratio = (moved._natural_sizes() / self._natural_sizes()).astype(np.float32)
            moved.normalisation = Normalisation(self.normalisation.centre * ratio, self.normalisation.unit * ratio)
        else:
            moved = moved.normalised()
        moved.config = config
        return moved
