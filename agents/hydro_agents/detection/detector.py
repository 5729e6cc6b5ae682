"""What a leak detector is: it reads windows of measured signals and gives one reading for each.

A detector is any object with ``threshold``, ``refuses`` and ``read`` (:class:`Detector`). The leakage protocol
takes any detector through this interface. A detector of your own::

    class PressureDrop:
        threshold = None  # the leakage protocol computes it

        def refuses(self, task, samples):
            return ""  # it reads windows of every length and of every axis

        def read(self, windows, task):
            difference = windows.signal("pressure_a") - windows.signal("pressure_b")
            return Reading.of(-np.abs(difference).mean(axis=1))
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from enum import IntEnum
from typing import Any, NamedTuple, Protocol, Self

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import ArrayLike, NDArray

from hydro_agents.controllers.base import Controller, ObservationLayout
from hydro_agents.running.cases import Cases, Rollout, run_cases
from hydro_env import TaskConfig
from hydro_env.task.faults import KIND_OF_FAULT
from hydro_env.task.sensors import SENSORS
from hydro_env.types import Array, Floats, Indices, Mask

SIGNALS = (*SENSORS, "previous_command")  # measured signals of a window, in this order
HALF_WIDTH = 1.645  # half width of a 90 % interval, in standard deviations

SMOOTHED = 7  # readings of a recorded supply or tank pressure that are averaged: their noise adds up in the travel

AUXILIARY = ("supply_pressure", "tank_pressure", "flow", "oil_temperature")
"""Further signals that a recording may hold, Pa, m³/s and °C: they drive the model, or a balance of volumes, and are
not among the five of a window. The flow is that into chamber a: of a flow meter, or of a pump with known displacement.
"""

RECORDED = {"supply.pressure": "supply_pressure", "supply.tank_pressure": "tank_pressure"}  # what replaces an unknown


class Worded(IntEnum):
    """A number with words."""

    word: str  # in tables
    in_full: str  # in a sentence

    def __new__(cls, number: int, word: str = "", in_full: str = "") -> Self:
        """A member with its words."""
        member = int.__new__(cls, number)
        member._value_, member.word, member.in_full = number, word, in_full or word
        return member


class Cause(Worded):
    """What may explain a window; the words of all tables, pages and messages."""

    NONE = 0, "none"
    INTERNAL_LEAK = 1, "internal leak", "leak past the piston"
    EXTERNAL_LEAK = 2, "external leak", "external leak past the rod seal"
    VALVE = 3, "valve fault", "fault of the valve"
    SENSOR = 4, "sensor fault", "fault of a sensor"
    RETURN_LINE = 5, "return line", "raised pressure in the return line"
    UNKNOWN = 6, "cannot tell", "unlike all that the detector knows"
    UNDETERMINED = 7, "cannot tell", "the window does not determine the leak"


class Why(Worded):
    """Why a window has no answer, and the words for it."""

    ANSWERED = 0
    NO_COMMANDS = 1, "commands are missing in the window"
    NOT_READ = 2, "not read: the model does not explain the liveliest windows"
    MISFIT = 3, "the model does not explain the readings"
    UNDETERMINED = 4, "the window does not determine the leak; more motion is needed"
    AT_REST = 5, "standstill cannot tell seal from valve here; run the leak test (hydro leak-test)"
    NOT_ASKED = 6, "the estimator has read a window of this axis within the last minute"
    OUTSIDE = 7, "unlike all that the leakage head was trained on"
    FEW_WINDOWS = 8, "the recording holds fewer than 2 windows with all commands"
    DIFFERS = 9, "the model differs slowly from several signals, which can hide a leak"


def _cause_of_kind(kind: str) -> Cause:
    if kind.startswith("valve_"):
        return Cause.VALVE
    return {"tank_pressure": Cause.RETURN_LINE, "external_leak": Cause.EXTERNAL_LEAK}.get(kind, Cause.SENSOR)


CAUSE_OF_FAULT = {name: _cause_of_kind(kind) for name, kind in KIND_OF_FAULT.items()}  # by the name of the fault


@dataclass(frozen=True)
class Windows:
    """N windows of T measured samples."""

    signals: Floats
    """(N, 5, T) in SI units, in the order of :data:`SIGNALS`: position (m), pressures
    of chambers a and b (Pa), spool position and command (fractions of full stroke). NaN: lost, or no such sensor. The
    command of a sample is the one that acts until one latency after it."""

    begin: Floats  # (N,), s; NaN: unknown
    end: Floats  # (N,), s

    auxiliary: Mapping[str, Floats] = field(default_factory=dict)  # the recorded ones of AUXILIARY, each (N, T)

    @classmethod
    def of(cls, signals: Array) -> "Windows":
        """Windows (N, 5, T) whose times do not matter."""
        unknown = np.full(len(signals), np.nan)
        return cls(np.asarray(signals, float), unknown, unknown)

    @classmethod
    def joined(cls, parts: "Sequence[Windows]") -> "Windows":
        """Several sets of windows of the same length as one."""
        signals, begin, end = (
            np.concatenate([getattr(part, name) for part in parts]) for name in ("signals", "begin", "end")
        )
        auxiliary = {
            name: np.concatenate([part.auxiliary_signal(name) for part in parts])
            for name in AUXILIARY
            if any(name in part.auxiliary for part in parts)
        }
        return cls(signals, begin, end, auxiliary)

    def __len__(self) -> int:
        return len(self.signals)

    @property
    def samples(self) -> int:
        """T."""
        return self.signals.shape[2]

    def signal(self, name: str) -> Floats:
        """One signal, (N, T), by its name in :data:`SIGNALS`."""
        return self.signals[:, SIGNALS.index(name)]

    def auxiliary_signal(self, name: str) -> Floats:
        """One of :data:`AUXILIARY`, (N, T); NaN: not recorded."""
        return self.auxiliary.get(name, np.full((len(self), self.samples), np.nan))

    @property
    def commanded(self) -> Mask:
        """Windows whose commands are all known, (N,): a simulation needs every command."""
        return np.asarray(np.isfinite(self.signal("previous_command")).all(axis=1))

    @property
    def boundary(self) -> Floats | None:
        """Recorded supply and tank pressure, (N, 2, T), Pa, smoothed and without gaps; NaN: not recorded."""
        if not self.auxiliary:
            return None
        return _smooth(np.stack([self.auxiliary_signal(name) for name in RECORDED.values()], axis=1))

    def unrecorded(self, names: tuple[str, ...]) -> tuple[str, ...]:
        """The unknowns; the offset of its transducer in place of a pressure that was recorded in every window."""
        left = []
        for name in names:
            if name in RECORDED and np.isfinite(self.auxiliary_signal(RECORDED[name])).any(axis=1).all():
                name = f"{RECORDED[name]}_bias"
            left.append(name)
        return tuple(left)

    def part(self, chosen: Mask | Indices) -> "Windows":
        """Some of the windows."""
        auxiliary = {name: values[chosen] for name, values in self.auxiliary.items()}
        return Windows(self.signals[chosen], self.begin[chosen], self.end[chosen], auxiliary)


def _smooth(values: Floats) -> Floats:
    """Means of SMOOTHED neighbours, after linear interpolation over missing values, (N, C, T); NaN: all are missing."""
    places, result = np.arange(values.shape[2]), np.full_like(values, np.nan)
    for row, series in zip(result.reshape(-1, len(places)), values.reshape(-1, len(places)), strict=True):
        known = np.isfinite(series)
        if known.any():
            whole = np.pad(np.interp(places, places[known], series[known]), SMOOTHED // 2, mode="reflect")
            row[:] = np.convolve(whole, np.full(SMOOTHED, 1.0 / SMOOTHED), mode="valid")
    return result


class MeasuredColumns(NamedTuple):
    """Where the observations of a task hold :data:`SIGNALS`; a rig may lack some."""

    rows: list[int]  # of SIGNALS that the rig has
    columns: list[int]  # of the observation, one for each row
    scale: Floats  # SI units per 1, one for each row

    @classmethod
    def of(cls, config: TaskConfig) -> "MeasuredColumns":
        """The columns of a task."""
        layout = ObservationLayout.of(config)
        rows = [row for row, name in enumerate(SIGNALS) if name in layout.names]
        columns = [layout.index(SIGNALS[row]) for row in rows]
        return cls(rows, columns, np.array([layout.scale[column] for column in columns]))

    def si(self, observed: Array) -> Floats:
        """Signals (N, 5, T) in SI units from these columns of observations, (N, columns, T); NaN: no such sensor."""
        signals = np.full((len(observed), len(SIGNALS), observed.shape[2]), np.nan)
        signals[:, self.rows] = observed.astype(float) * self.scale[:, None]
        return signals


def measured_run(config: TaskConfig, controller: Controller, cases: Cases) -> tuple[Floats, Rollout]:
    """Run cases; returns their measured signals (N, 5, T) in SI units, and the runs.

    Raises:
        ControllerError: see :func:`~hydro_agents.running.cases.run_cases`.
    """
    measured = MeasuredColumns.of(config)
    run = run_cases(config, controller, cases, measured.columns)
    assert run.signals is not None
    return measured.si(run.signals), run


def cut(runs: Array, begins: Array, samples: int) -> Array:
    """Windows (N, C, samples) of runs (N, C, T), each from a sample of its own on."""
    return sliding_window_view(runs, samples, axis=2)[np.arange(len(runs)), :, begins]


class Reading(NamedTuple):
    """What a detector reads in N windows; each field (N,), NaN: no value.

    Values may be given for windows without an answer (:attr:`answers`); they do not count.
    """

    score: Floats  # rises with the evidence of a leak past the piston
    sigma: Floats  # standard deviation of the score
    probability: Floats  # of a leak past the piston, 0 to 1
    flow_lpm: Floats  # the leak, l/min at 100 bar
    low_lpm: Floats  # 90 % interval of the leak
    high_lpm: Floats
    cause: NDArray[np.int8]  # Cause that it names besides a leak past the piston; UNKNOWN, UNDETERMINED: no answer
    fault: NDArray[np.object_]  # the same in words, with sizes if it knows them; empty: none
    why: NDArray[np.int8]  # Why there is no answer

    @classmethod
    def of(cls, score: ArrayLike, cause: ArrayLike | None = None, **known: Any) -> "Reading":
        """A reading with some of the fields; all others are unknown.

        Args:
            score: (N,), NaN: no answer.
            cause: (N,), or one for all; default: ``NONE``, or ``UNDETERMINED`` without a score.
            known: other fields by name, each (N,), or one value for all.

        Raises:
            ValueError: a field has another length.
        """
        score = np.asarray(score, float)
        if cause is None:
            cause = np.where(np.isnan(score), Cause.UNDETERMINED, Cause.NONE)
        values = dict.fromkeys(cls._fields, np.nan) | {"fault": "", "why": Why.ANSWERED} | known
        values |= {"score": score, "cause": cause}
        kinds = {"fault": object, "cause": np.int8, "why": np.int8}
        return cls._make(
            np.broadcast_to(np.asarray(value, kinds.get(name, float)), score.shape).copy()
            for name, value in values.items()
        )

    @property
    def answers(self) -> Mask:
        """Windows for which the detector gives an answer, (N,)."""
        return np.isfinite(self.score) & (self.cause < Cause.UNKNOWN)

    @property
    def sized(self) -> Mask:
        """Windows with an answer that gives the size of the leak with an interval, (N,)."""
        return self.answers & np.isfinite(self.sizes).all(axis=0)

    @property
    def sizes(self) -> Floats:
        """The leak and the ends of its interval, (3, N), l/min at 100 bar."""
        return np.stack([self.flow_lpm, self.low_lpm, self.high_lpm])

    @property
    def remarks(self) -> list[str]:
        """The reason for no answer of each window in words; empty for an answer."""
        return [Why(why).word for why in self.why]

    def part(self, chosen: Indices) -> "Reading":
        """Some of the windows."""
        return Reading._make(values[chosen] for values in self)

    def replaced(self, chosen: Indices, other: "Reading") -> "Reading":
        """This reading with the windows ``chosen`` as another one reads them."""
        copies: list[Any] = [values.copy() for values in self]
        for values, new in zip(copies, other, strict=True):
            values[chosen] = new
        return Reading._make(copies)


class Detector(Protocol):
    """Anything that reads windows of measured signals.

    A detector with a memory of earlier windows is copied with ``deepcopy`` before it reads another run.
    """

    threshold: float | None  # score at which it reports a leak; None: the protocol computes it from validation windows

    def refuses(self, task: TaskConfig, samples: int) -> str:
        """The reason why it cannot read windows of ``samples`` samples of a task; empty if it can."""
        ...

    def read(self, windows: Windows, task: TaskConfig) -> Reading:
        """Read windows.

        Args:
            windows: N windows.
            task: as known to the detector: rig, ranges and sensors, not the drawn plants.
        """
        ...


def logit(probability: ArrayLike) -> Floats:
    """Logarithm of the odds, finite for 0 and 1."""
    inside = np.clip(np.asarray(probability, float), 1e-15, 1.0 - 1e-15)
    return np.log(inside / (1.0 - inside))


def threshold_at_false_alarm_rate(healthy_scores: Array, rate: float) -> float:
    """Lowest threshold that flags at most the share ``rate`` of the healthy scores."""
    ordered = np.sort(np.asarray(healthy_scores, float))[::-1]
    allowed = int(rate * len(ordered))
    if allowed >= len(ordered):
        return 0.0
    return np.nextafter(ordered[allowed], np.inf)
