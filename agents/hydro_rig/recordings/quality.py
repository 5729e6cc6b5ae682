"""All checks of a recording, before any verdict: single channels, then spool, command, pressures and motion together.

Two balances, valid for every rig of this kind, reveal a wrong sign, exchanged chambers and a wrong unit:

* flow (12), (13): oil through the valve = piston area x speed + compression. Its slope is near 1 if the units are
  correct, and positive if spool and position have the same direction.
* force (14): A_a p_a − A_b p_b = M a + d v + F_c sign(v) + k x + F_0 with M, d, F_c, k not negative. Exchanged chambers
  or a reversed position do not satisfy it.
"""

from itertools import combinations
from typing import NamedTuple

import numpy as np
from scipy.optimize import nnls

from hydro_env import ConfigurationError, TaskConfig
from hydro_env.plant.arrays import plant_coefficients
from hydro_env.plant.parts.chambers import chamber_volumes
from hydro_env.plant.parts.valve import edge_flows
from hydro_env.plant.states import State
from hydro_env.task.paces import periods_late
from hydro_env.task.sensors import COMMAND, POSITION, PRESSURE_A, PRESSURE_B, SPOOL
from hydro_env.types import Floats
from hydro_env.units import FULL_VOLTAGE
from hydro_rig.estimation.estimate import two_pressures
from hydro_rig.recordings.channels import OVERRANGE, check_channels, check_set_point
from hydro_rig.recordings.files import interpolated
from hydro_rig.recordings.findings import Finding, Findings, Weight, finding_of, severe_of
from hydro_rig.recordings.recording import Recording
from hydro_rig.recordings.sampling import Sampled, on_grid, sampled

INTERVAL = 0.02  # s, about, over which readings are averaged: the noise of the position gets small beside the motion
MOST_SAMPLES = 4000  # more add no information: of a longer recording, the part with the most travel is used
FEWEST_SAMPLES = 100
LONGEST_BLANK = 0.1  # s between two readings of a slow sensor
LEAST_TRAVEL = 20.0  # smallest useful travel, in standard deviations of the position's noise
STEADY = 0.05  # scatter of the flow over its mean, below which the axis moves at one speed
LEAST_TRAVELLED = 0.05  # smallest travel, as a share of the travel from the valve's flow
UNRELATED = 0.05  # square of the correlation of the flows below which their slope says nothing

FITS, FAILS = 0.6, 0.75
"""Unexplained share of the force: largest of a fitting balance, smallest of a wrong one. On the three shipped rigs it
is 0 to 0.6, and 0.6 to 1.0 with exchanged chambers or a reversed position."""

SLOPES = (0.15, 6.0)  # valid range of the slopes of the flow balance and of spool against command, with wear and noise
ROUNDING = 1e-4  # of full scale, by which a command at its limit may exceed it without a word

CHANGES = EXCHANGED, TURNED_POSITION, TURNED_VALVE = (
    "the pressures of the chambers exchanged (of a load pressure, the other sign)",
    "the other sign of the position",
    "the other sign of spool and command",
)
SETTLED = "a move by a positive command settles it: the axis extends, and chamber a gets the oil"


class Checked(NamedTuple):
    """A recording at the control period, and all findings about it."""

    samples: Sampled  # invalid readings are NaN
    findings: Findings

    @property
    def severe(self) -> Findings:
        """Findings that rule out a verdict."""
        return severe_of(self.findings)


def check_recording(recording: Recording, config: TaskConfig, own_grid: bool = False) -> Checked:
    """Check time stamps, channels and wiring of a recording for the rig of a task.

    Each check relies on the previous ones, and is left out after a severe finding. ``own_grid``: as of
    :func:`~hydro_rig.recordings.sampling.sampled`.
    """
    differential = config.sensors.differential_pressure
    if recording.has_pressure and recording.differential != differential:
        has, map_as = ("two pressures", "load_pressure") if differential else ("a load pressure", "the two pressures")
        rig = f"differential_pressure: {str(differential).lower()}"
        raise ConfigurationError(
            f"{recording.source}: has {has}, but the rig's sensors {rig}; change that, or map {map_as}"
        )
    samples = sampled(recording, config, own_grid)
    config = on_grid(config, samples.period)
    findings = [*recording.findings, *samples.findings]
    if not len(samples.time):
        return Checked(samples, findings)
    moving = _stretch_with_motion(samples, config)
    if moving is not None and (set_point := check_set_point(moving, samples.period)):
        return Checked(samples, [*findings, set_point])
    samples, beyond = _within_full_scale(samples)
    findings += beyond
    of_channels, bad = check_channels(samples, config)
    findings += of_channels
    samples = samples._replace(signals=np.where(bad, np.nan, samples.signals))
    if all(finding.weight is Weight.NOTE for finding in findings):
        findings += check_wiring(samples, config)
    return Checked(samples, findings)


def _within_full_scale(samples: Sampled) -> tuple[Sampled, Findings]:
    """The samples with commands of up to OVERRANGE of full scale taken as full scale; a valve opens no farther."""
    size = np.abs(samples.signals[COMMAND])
    beyond = (size > 1.0) & (size <= OVERRANGE)
    if not beyond.any() or (size > OVERRANGE).any():  # the unit is wrong: check_channels says so
        return samples, []
    signals, most = samples.signals.copy(), size[beyond].max()
    signals[COMMAND] = signals[COMMAND].clip(-1.0, 1.0)
    what = f"is up to {100.0 * most:.4g} % of full scale ({FULL_VOLTAGE * most:.4g} V): taken as full scale"
    found = [finding_of(beyond, samples.time, "command", what)] if most >= 1.0 + ROUNDING else []
    return samples._replace(signals=signals), found


class TwoBalances(NamedTuple):
    """Fit of a recording to the two balances."""

    force_rest: float  # unexplained share of the force, 0 to 1
    slope: float  # of the flow balance of chamber a
    travel: float  # m
    expected_travel: float  # m, by the flow through the valve


def _stretch_with_motion(samples: Sampled, config: TaskConfig) -> Floats | None:
    """All signals (5, T) of a stretch without gaps in which the axis moves most; ``None`` if all are too short.

    Between the readings of a slow sensor they are interpolated, for checks of slow motion. An absent spool follows its
    command, and absent pressures are half the supply's. With a flow, a pump moves the axis, and the command may be none
    of a valve: absent signals stay absent.
    """
    signals = samples.signals.copy()
    for values in signals[:COMMAND]:
        known = np.isfinite(values)
        if known.any() and not known.all():
            values[:] = interpolated(samples.time, samples.time[known], values[known], LONGEST_BLANK)
    if "flow" not in samples.auxiliary:
        if config.sensors.differential_pressure:
            signals = two_pressures(signals[None], config)[0]
        half_supply = 0.5 * config.plant.supply.pressure
        for row, usual in ((PRESSURE_A, half_supply), (PRESSURE_B, half_supply), (SPOOL, signals[COMMAND])):
            if not np.isfinite(signals[row]).any():
                signals[row] = usual
    whole = np.flatnonzero(np.isfinite(signals).all(axis=0))
    longest = max(np.split(whole, np.flatnonzero(np.diff(samples.place[whole]) != 1) + 1), key=len)
    if len(longest) < FEWEST_SAMPLES:
        return None
    signals = signals[:, longest[0] : longest[-1] + 1]
    starts = range(0, max(signals.shape[1] - MOST_SAMPLES, 0) + 1, MOST_SAMPLES)
    best = max(starts, key=lambda start: signals[POSITION, start : start + MOST_SAMPLES].std())
    return signals[:, best : best + MOST_SAMPLES]


def check_wiring(samples: Sampled, config: TaskConfig) -> Findings:
    """Find wrong signs, exchanged chambers and wrong units; needs motion."""
    signals = _stretch_with_motion(samples, config)
    if signals is None:
        return []
    findings = _spool_and_command(signals, config)
    if findings and findings[0].weight is Weight.SEVERE:
        return findings
    fit = balance(signals, config)
    if max(fit.travel, fit.expected_travel) < LEAST_TRAVEL * config.sensors.position.noise:
        return findings
    if fit.force_rest < FAILS and _plausible(fit.slope):
        return findings
    ratio = fit.travel / max(fit.expected_travel, 1e-300)
    if ratio < LEAST_TRAVELLED or (fit.slope > 0.0 and not _plausible(fit.slope)):
        what = f"moves {ratio:.2g} times as far as the valve's flow moves the piston; check its unit and the rig"
        return [*findings, Finding("position", what, Weight.SEVERE)]
    # One pressure does not tell which sign is wrong.
    if fit.force_rest and (changes := _change_that_helps(signals, config)):
        what = f"contradict each other; they would fit with {changes}; {SETTLED}"
        return [*findings, Finding("pressures, spool and motion", what, Weight.SEVERE)]
    if fit.slope < 0.0:
        what = f"moves against the valve's flow: its sign, or that of the command, is wrong; {SETTLED}"
        return [*findings, Finding("position", what, Weight.SEVERE)]
    return findings


def balance(signals: Floats, config: TaskConfig) -> TwoBalances:
    """Fit of signals (5, T) without gaps to the two balances of the nominal rig; with one pressure to that of flow."""
    c = plant_coefficients(config.plant)
    step = max(round(INTERVAL / config.control_period), 1)
    time = step * config.control_period
    position, pressure_a, pressure_b = _means(signals[:SPOOL], step)
    force = c.area_a * pressure_a - c.area_b * pressure_b
    speed = (position[2:] - position[:-2]) / (2.0 * time)
    acceleration = (position[2:] - 2.0 * position[1:-1] + position[:-2]) / time**2
    slow = 0.02 * max(np.abs(speed).max(), 1e-9)
    causes = np.column_stack([acceleration, speed, np.tanh(speed / slow), position[1:-1]])
    causes -= causes.mean(axis=0)
    wanted = force[1:-1] - force[1:-1].mean()
    _, rest = nnls(causes / (causes.std(axis=0) + 1e-300), wanted)
    force_rest = 0.0
    if np.ptp(signals[[PRESSURE_A, PRESSURE_B]], axis=1).all():
        force_rest = rest**2 / max(wanted @ wanted, 1e-300)

    flow = _means(flow_into_a(signals, config), step)[1:-1]
    volume = chamber_volumes(position[1:-1], c)[0]
    stored = volume / c.bulk_modulus * (pressure_a[2:] - pressure_a[:-2]) / (2.0 * time)
    needed = c.area_a * speed + stored
    covariance = np.cov(needed, flow)
    travel = np.ptp(np.quantile(position, [0.01, 0.99]))
    if flow.std() < STEADY * abs(flow.mean()):  # at one speed only the means say something
        return TwoBalances(0.0, needed.mean() / flow.mean(), travel, abs(flow.sum()) * time / c.area_a)
    expected = np.ptp(np.cumsum(flow - flow.mean())) * time / c.area_a
    slope = 1.0
    if covariance[0, 1] ** 2 >= UNRELATED * covariance[0, 0] * covariance[1, 1]:
        slope = covariance[0, 1] / max(covariance[1, 1], 1e-300)
    return TwoBalances(force_rest, slope, travel, expected)


def flow_into_a(signals: Floats, config: TaskConfig) -> Floats:
    """Flow of the nominal valve into chamber a, m³/s, (T,), at signals (5, T)."""
    c, supply = plant_coefficients(config.plant), config.plant.supply.pressure
    rest = State(*[0.0] * len(State._fields))._replace(supply_pressure=supply)
    flow = []
    for pressure_a, pressure_b, spool in signals[[PRESSURE_A, PRESSURE_B, SPOOL]].T.tolist():
        edges = edge_flows(rest._replace(pressure_a=pressure_a, pressure_b=pressure_b, spool_position=spool), c)
        flow.append(edges.supply_to_a - edges.a_to_tank)
    return np.array(flow)


def _change_that_helps(signals: Floats, config: TaskConfig) -> str:
    """The smallest change of columns after which both balances fit, as text; empty if there is none."""
    for count in range(1, len(CHANGES) + 1):
        for chosen in combinations(CHANGES, count):
            changed = signals.copy()
            if EXCHANGED in chosen:
                changed[[PRESSURE_A, PRESSURE_B]] = changed[[PRESSURE_B, PRESSURE_A]]
            for row, change in ((POSITION, TURNED_POSITION), (SPOOL, TURNED_VALVE)):
                if change in chosen:
                    changed[row] *= -1.0
            fit = balance(changed, config)
            if fit.force_rest < FITS and _plausible(fit.slope):
                return " and ".join(chosen)
    return ""


def _plausible(slope: float) -> bool:
    return SLOPES[0] <= slope <= SLOPES[1]


def _spool_and_command(signals: Floats, config: TaskConfig) -> Findings:
    """Check sign and scale of the command against the spool."""
    if not np.ptp(signals[COMMAND]) >= 0.02 or signals[COMMAND].std() < 2.0 * config.sensors.spool_position.noise:
        return []  # the command changes too little for the spool to follow it
    slope, rest = _spool_after_commands(signals, config)
    if rest > 0.5:
        return [Finding("spool_position", "does not follow the command")]
    if slope < 0.0:
        return [Finding("spool_position", "moves against the command: reverse the sign of one of them", Weight.SEVERE)]
    if not _plausible(slope):
        what = f"moves {slope:.3g} times as far as the command; check the units of both"
        return [Finding("spool_position", what, Weight.SEVERE)]
    return []


def _spool_after_commands(signals: Floats, config: TaskConfig) -> tuple[float, float]:
    """Slope of the spool's readings against the commands, and the unexplained share of their standard deviation.

    The command of the row that acts by the data sheet counts, that of the row after it, and those of two before.
    """
    late = periods_late(config.command_latency, config.control_period)
    spool, command = signals[SPOOL][late:], signals[COMMAND][: signals.shape[1] - late]
    rows = np.column_stack([command[3:], command[2:-1], command[1:-2], command[:-3], np.ones(len(command) - 3)])
    wanted = spool[2:-1]
    weights, *_ = np.linalg.lstsq(rows, wanted, rcond=None)
    rest = (wanted - rows @ weights).std() / max(wanted.std(), 1e-300)
    return weights[:4].sum(), rest


def _means(values: Floats, step: int) -> Floats:
    """Means over consecutive groups of samples, (…, T // step), of values (…, T)."""
    count = values.shape[-1] // step
    return values[..., : count * step].reshape(*values.shape[:-1], count, step).mean(axis=-1)
