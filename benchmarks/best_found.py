"""The best found: a predictive search on the simulator itself that knows plant, leak, state and future forces.

It estimates how much better than a given controller any controller could be. It is no controller of a rig, which cannot
measure the true plant; it takes part in any comparison by its name: ``hydro evaluate --agent
"best found=benchmarks.best_found:BestFound"``. This script compares it with the shipped controllers.

Run: python -m benchmarks.best_found [--task NAME|FILE] [--plants 3] [--leak 0.01 0.3 1 4]; some minutes.
"""

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks import command_line
from hydro_agents.evaluation.evaluate import evaluate
from hydro_agents.evaluation.metrics import ERROR, ERROR_SENSOR
from hydro_agents.evaluation.study import default_study
from hydro_env import ConfigurationError, TaskConfig
from hydro_env.axes import Axes
from hydro_env.plant import kernel
from hydro_env.plant.equations import Coefficients
from hydro_env.plant.states import State
from hydro_env.task.configuration import task_config
from hydro_env.task.fault_effects import FAULT_COLUMNS
from hydro_env.task.kernel import follow
from hydro_env.task.paces import within_a_period
from hydro_env.task.record import FIRST_COEFFICIENT, FIRST_VOLTAGE
from hydro_env.task.schedules import LEAK_COLUMNS
from hydro_env.task.settings import settings_of
from hydro_env.task.signals import POSITION as SENSOR_POSITION
from hydro_env.types import Floats
from hydro_env.units import FULL_VOLTAGE

HORIZON = 20  # control periods that are planned ahead
ITERATIONS = 2  # improvements of the plan in each control period
SAMPLES = 8  # random changes of the plan that are tried in each iteration
EFFORT = 2e-7  # m; cost of a change of the command by 1, squared
EVEN_ERRORS = (20e-6, 200e-6, 2e-3, 1.0)  # m; one Gauss–Newton step for each: its cost is quadratic below, linear above

STEP_LENGTHS = (1.0, 0.4)  # fractions of each Gauss–Newton step that are tried
CHANGE_SIZES = (2.0, 0.5, 0.1, 0.02)  # largest random changes of the plan, as a fraction of 10 V

SCHEDULED = (*LEAK_COLUMNS, Coefficients._fields.index("external_force"), *FAULT_COLUMNS)
"""Coefficients that change during an episode."""

POSITION = State._fields.index("position")
PERTURBATION = 0.01  # of 10 V, of a command for the sensitivities; its effect is far above the integrator's error
NEWTON_STEPS = 6  # steps of the projected Newton method; each decides which commands stay at a limit
BENDING = 5  # periods for which the reference beyond the preview keeps its acceleration; then it keeps its speed


class BestFound:
    """Plans the commands of N axes in each control period; :func:`~hydro_agents.running.cases.run_cases` runs it.

    The search knows the true state, the plant of the episode, its leak and its forces, present and future, and the
    reference within the task's preview. The position that the biased sensor reads follows the reference.
    """

    def __init__(self, config: TaskConfig) -> None:
        self.config = config
        self._axes: Axes | None = None

    def begin(self, axes: Axes) -> None:
        """Prepare for the episodes of the axes, which have just been reset."""
        config = self.config
        plants, latency = axes.coefficient.copy(), axes.column("latency").copy()
        within_a_period(float(latency.max()), config, "best found")
        self._axes = axes
        self._prediction = Prediction(config, plants, latency, true_schedule(config, axes, config.steps + HORIZON))
        offset = axes.column("bias")[:, SENSOR_POSITION] if config.sensors.enabled else 0.0
        self._target = axes.reference - np.reshape(offset, (-1, 1))
        self._plan = np.repeat(axes.column("command")[:, None], HORIZON, axis=1)
        self._generator = np.random.default_rng(0)

    def predict(
        self, observation: Any, state: Any = None, episode_start: Any = None, deterministic: bool = True
    ) -> tuple[NDArray[np.float32], None]:
        """The first command of the plan, (N, 1); it reads the axes themselves, not the observation."""
        del observation, state, episode_start, deterministic
        axes = self._axes
        if axes is None:
            raise ConfigurationError("best found: reads the true states of the axes; run it with run_cases")
        step = int(axes.column("step").max())
        now, before = axes.state.copy(), axes.column("command").copy()
        target = continued(self._target, step, max(self.config.preview_samples, default=0), HORIZON)
        plan = np.concatenate([self._plan[:, 1:], self._plan[:, -1:]], axis=1)
        for _ in range(ITERATIONS):
            tried = self._candidates(now, before, plan, target, step)
            positions = self._prediction.positions(now, before, tried, step)
            cost = np.abs(target[:, None, :] - positions).mean(axis=2)
            changes = np.diff(tried, axis=2, prepend=np.broadcast_to(before[:, None, None], (*tried.shape[:2], 1)))
            cost += EFFORT * (changes**2).mean(axis=2)
            plan = tried[np.arange(len(tried)), np.argmin(cost, axis=1)]
        self._plan = plan
        return plan[:, :1].astype(np.float32), None

    def _candidates(self, now: Floats, before: Floats, plan: Floats, target: Floats, step: int) -> Floats:
        """Candidate sequences of commands, (N, M, H); the first is the present plan."""
        tried = [plan]
        positions, jacobian = self._prediction.sensitivities(now, before, plan, step)
        error = target - positions
        for even in EVEN_ERRORS:
            weight = 1.0 / np.maximum(np.abs(error), even)
            found = bounded_least_squares(jacobian, error, weight, plan, before, EFFORT)
            tried += [plan + length * (found - plan) for length in STEP_LENGTHS]
        changes = random_changes(self._generator, SAMPLES, HORIZON, CHANGE_SIZES)
        random = np.clip(plan[:, None, :] + changes, -1.0, 1.0)
        return np.concatenate([np.stack(tried, axis=1), random], axis=1)


class Prediction:
    """The positions of N axes over a horizon, from given states and commands.

    ``coefficients``: of each plant, (N, coefficients); ``latency``: from the start of a period until its command acts,
    (N,), s; ``schedule``: as of :func:`true_schedule`, also in the horizon beyond the end of the episode.
    """

    def __init__(self, config: TaskConfig, coefficients: Floats, latency: Floats, schedule: Floats) -> None:
        self._failure = config.failure
        self._coefficients = coefficients
        self._schedule = schedule
        self._durations = np.stack([latency, config.control_period - latency], axis=1)
        self._accuracy = kernel.Accuracy(config.maximum_step, config.tolerance, kernel.MOST_STEPS_PER_PERIOD)

    def positions(self, state: Floats, before: Floats, commands: Floats, step: int, failing: bool = True) -> Floats:
        """Positions (N, M, H), m, at the end of each period from ``step`` on; infinite after failures, if they count.

        ``state``: of each plant now, (N, states). ``before``: the command that acts until the first of ``commands``
        does, (N,), as a fraction of 10 V; of these M sequences for each axis, (N, M, H).
        """
        axes, sequences, horizon = commands.shape
        rows = sequences * axes
        states = np.tile(state, (sequences, 1))  # of the axes for each sequence
        coefficients = np.tile(self._coefficients, (sequences, 1))
        durations = np.tile(self._durations, (sequences, 1))
        volts = FULL_VOLTAGE * commands.transpose(2, 1, 0).reshape(horizon, rows)
        voltage = np.tile(FULL_VOLTAGE * before, (2, sequences)).T.copy()
        peaks, failed = np.zeros((rows, kernel.N_PEAKS)), np.zeros(rows, dtype=np.bool_)
        positions = np.empty((horizon, rows))
        for period in range(horizon):
            voltage[:, 0] = voltage[:, 1]
            voltage[:, 1] = volts[period]
            now = self._schedule[min(step + period, len(self._schedule) - 1)]
            coefficients.reshape(sequences, axes, -1)[..., SCHEDULED] = now
            plants = kernel.Plants(states, coefficients, voltage, durations, peaks)
            kernel.integrate(plants, self._accuracy, 0, rows)
            position = states[:, POSITION]
            failed |= peaks[:, kernel.IMPACT_SPEED] > self._failure.end_stop_speed
            failed |= (peaks[:, kernel.PEAK_PRESSURE] > self._failure.pressure_rating) | ~np.isfinite(position)
            positions[period] = np.where(failed & failing, np.inf, position)
        return np.ascontiguousarray(positions.reshape(horizon, sequences, axes).transpose(2, 1, 0))

    def sensitivities(self, state: Floats, before: Floats, commands: Floats, step: int) -> tuple[Floats, Floats]:
        """Positions (N, H) of one sequence of commands (N, H), and their change per change of each command (N, H, H).

        Entry [n, i, j] is the change of the position at the end of period i, m per 1 of command j. The differences are
        one-sided, towards the middle of the range of commands. The other arguments are those of :meth:`positions`.
        """
        horizon = commands.shape[1]
        changes = np.where(commands > 0.0, -PERTURBATION, PERTURBATION)
        moved = np.concatenate([np.zeros((1, horizon)), np.eye(horizon)]) * changes[:, None, :]
        positions = self.positions(state, before, commands[:, None, :] + moved, step, failing=False)
        differences = (positions[:, 1:] - positions[:, :1]) / changes[:, :, None]
        return positions[:, 0], np.ascontiguousarray(differences.transpose(0, 2, 1))


def true_schedule(config: TaskConfig, axes: Axes, periods: int) -> Floats:
    """The coefficients :data:`SCHEDULED` of the true plants in each control period, (periods, N, S)."""
    task, record, plant = settings_of(config), axes.record.copy(), axes.arrays.plant.copy()
    coefficients, schedule = plant[:, FIRST_COEFFICIENT:FIRST_VOLTAGE], []
    for period in range(periods):
        record["step"] = period
        follow(task, record, plant, 0, axes.count)
        schedule.append(coefficients[:, SCHEDULED])
    return np.array(schedule)


def bounded_least_squares(
    jacobian: Floats, error: Floats, weight: Floats, commands: Floats, before: Floats, effort: float
) -> Floats:
    """Commands that minimise Σ weight · (error − jacobian · change)² + effort · Σ (change of command)² within ±1.

    The projected Newton method (Bertsekas 1982): commands at a limit whose gradient points outwards stay there; the
    others take the Newton step. ``jacobian``: (N, H, H), change of sample i per change of command j; ``error``: with
    ``commands``, from which it starts, (N, H), as is the weight of each sample; ``before``: the command before, (N,).
    """
    horizon = commands.shape[1]
    changes = np.eye(horizon) - np.eye(horizon, k=-1)  # of the commands from period to period
    weighted = jacobian.transpose(0, 2, 1) * weight[:, None, :]
    smooth = effort * changes.T @ changes
    hessian = weighted @ jacobian + smooth
    hessian += 1e-9 * np.trace(hessian, axis1=1, axis2=2)[:, None, None] / horizon * np.eye(horizon)
    # Gradient at commands u: hessian u − pull.
    pull = (weighted @ (error + (jacobian @ commands[:, :, None])[..., 0])[:, :, None])[..., 0]
    pull[:, 0] += effort * before
    best = commands.copy()
    for _ in range(NEWTON_STEPS):
        gradient = (hessian @ best[:, :, None])[..., 0] - pull
        held = ((best >= 1.0) & (gradient < 0.0)) | ((best <= -1.0) & (gradient > 0.0))
        free = ~held
        reduced = hessian * (free[:, :, None] & free[:, None, :]) + held[:, :, None] * np.eye(horizon)
        step = np.linalg.solve(reduced, np.where(free, -gradient, 0.0)[:, :, None])[..., 0]
        best = np.clip(best + step, -1.0, 1.0)
    return best


def random_changes(generator: np.random.Generator, count: int, horizon: int, sizes: Any) -> Floats:
    """Changes of a sequence of commands, (count, horizon): each constant on a random stretch, of random size."""
    first = generator.integers(0, horizon, count)
    last = first + 1 + generator.integers(0, horizon, count)
    period = np.arange(horizon)
    inside = (period >= first[:, None]) & (period < last[:, None])
    size = np.resize(np.asarray(sizes), count) * generator.uniform(-1.0, 1.0, count)
    return np.asarray(inside * size[:, None])


def continued(reference: Floats, step: int, known: int, horizon: int) -> Floats:
    """The reference, (N, samples), at the next ``horizon`` samples (N, H), of which so many are ``known`` at a step.

    Beyond these it keeps its last speed, and for a while its last acceleration too, if the last differences agree on
    them: a jump is no speed, and a kink no acceleration.
    """
    samples = reference.shape[1] - 1
    times = step + 1 + np.arange(horizon)
    end = step + known
    ahead: Floats = reference[:, np.minimum(np.minimum(times, end), samples)]
    if step + horizon <= end:
        return ahead
    last = np.clip(end - np.arange(4), 0, samples)
    speeds = -np.diff(reference[:, last], axis=1)
    new, old = speeds[:, 0], speeds[:, 1]
    steady = (new * old > 0.0) & (np.abs(new) < 2.0 * np.abs(old))
    beyond = np.maximum(times - end, 0)
    ahead += np.where(steady, new, _agreed(new, old))[:, None] * beyond
    bends = -np.diff(speeds, axis=1)
    acting = np.minimum(beyond, BENDING)
    bent = 0.5 * acting * (acting + 1) + BENDING * (beyond - acting)  # by a unit of acceleration that lasts BENDING
    ahead += _agreed(bends[:, 0], bends[:, 1])[:, None] * bent
    return ahead


def _agreed(a: Floats, b: Floats) -> Floats:
    """The smaller of two numbers of the same sign, else 0."""
    return np.where(a * b > 0.0, np.where(np.abs(a) < np.abs(b), a, b), 0.0)


def main() -> None:
    """Compare the shipped controllers with the best found, and print mean errors by family and by leak."""
    given = command_line(__doc__, task=str, plants=3, leak=[0.01, 0.3, 1.0, 4.0])
    task = task_config(given.task)
    size = {"plants": given.plants, "leak_levels": given.leak, "standstill_plants": 0}
    controllers = {
        **default_study(Path("opponents"), task).with_gains_of_rig().with_weights({}),
        "best found": BestFound(task),
    }
    cases = evaluate(task, controllers, settings=size).table("cases")
    for column in (ERROR_SENSOR, ERROR, "valve_travel_per_s"):
        for by in ("family", "leakage_flow_lpm"):
            means = cases.pivot_table(column, by, "controller", sort=False)
            means.loc["mean"] = means.mean()
            print(f"{column}:\n\n{means.round(4).to_string()}\n")


if __name__ == "__main__":
    main()
