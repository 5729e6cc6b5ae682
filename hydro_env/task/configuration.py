"""The task as data: timing, leakage, randomisation, references, sensors, reward, end of episode.

The same classes validate a YAML file and the keywords of the environment. SI units, except leakage, which is in litres
per minute at 100 bar across the piston, as usual in practice.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field, field_serializer, field_validator

from hydro_env.errors import ConfigurationError, UnknownKeyError
from hydro_env.files import Group, read_yaml, whole_group
from hydro_env.folders import config_file
from hydro_env.mistakes import known_name
from hydro_env.plant.parameters import PARAMETER_PATHS, PlantParameters
from hydro_env.plant.parts.leakage import LeakLaw
from hydro_env.task.faults import Faults
from hydro_env.task.law import RigLaw
from hydro_env.task.randomisation import Distribution, Randomisation, check_draws, default_randomisation
from hydro_env.task.record import MOST_LATE, OPTION_NAMES
from hydro_env.task.reference_signals import MOVING_FAMILIES, REFERENCE_FAMILIES
from hydro_env.task.rig import task_from
from hydro_env.task.sensors import Sensors
from hydro_env.units import Number, Range, interval, quantity

LEAKAGE_CLASSES = ("healthy", "incipient", "moderate", "severe")
"""Names of the class labels 0 to 3."""

Family = Annotated[str, known_name(REFERENCE_FAMILIES, "family")]

LEAKAGE_LIMIT = 20.0  # l/min at 100 bar; a larger leak would mean that the seal is missing


class LeakageDraw(Group):
    """Internal leakage of an episode, in l/min at 100 bar across the piston."""

    healthy_share: Number = Field(0.25, ge=0.0, le=1.0, description="share of episodes with a healthy seal")
    healthy_range: Range = interval((0.003, 0.03), "l/min", 1e-6, LEAKAGE_LIMIT, "at 100 bar; drawn log-uniformly")
    faulty_range: Range = interval((0.1, 4.0), "l/min", 1e-6, LEAKAGE_LIMIT, "at 100 bar; drawn log-uniformly")
    class_bounds: tuple[Number, Number, Number] = Field(
        (0.03, 0.3, 1.0), description="l/min at 100 bar; highest of healthy, incipient, moderate; above is severe"
    )
    law: LeakLaw = Field("laminar", description="flow ∝ Δp (10), or ∝ √Δp as through a throttle")
    schedule: Literal["constant", "onset", "growth", "mixed"] = Field(
        "constant",
        description="constant; a sudden onset; growth (log-linear) from healthy to the end of the episode; "
        "mixed: one of the three, drawn per episode",
    )
    start_range: Range = interval((0.25, 0.75), "1", 0.0, 1.0, "onset or start of growth, as a share of the episode")

    @whole_group
    def _classes_rise(self) -> "LeakageDraw":
        low, middle, high = self.class_bounds
        if not 0.0 < low < middle < high <= LEAKAGE_LIMIT:
            raise ValueError(
                f"class_bounds = [{low:g}, {middle:g}, {high:g}]: must be positive and rising up to "
                f"{LEAKAGE_LIMIT:g} l/min"
            )
        return self


class References(Group):
    """The references, within the force and the speed of each plant."""

    weights: dict[Family, Annotated[Number, Field(ge=0.0, le=1e6)]] = Field(
        default_factory=lambda: dict.fromkeys(MOVING_FAMILIES, 1.0),
        description="relative frequency of each family; absent families do not occur",
    )
    user: list[Number] | None = Field(None, description="m, one per control period from the start; held at its end")
    range_share: Number = Field(0.6, gt=0.0, le=0.95, description="of the range that the supply can hold")
    largest_amplitude: Number = quantity(0.10, "m", "farthest from mid-stroke", 1e-3, 5.0)
    speed_share: Number = Field(0.7, gt=0.0, le=1.0, description="of the speed at full opening on that stretch")
    acceleration_limit: Number = quantity(4.0, "m/s²", "of smooth moves and sines", 0.01, 100.0)
    frequency_range: Range = interval((0.3, 4.0), "Hz", 1e-3, 1e3, "of sines")
    step_range: Range = interval((0.002, 0.02), "m", 1e-6, 10.0, "of steps")
    preview_times: tuple[Number, ...] = Field(
        (0.005, 0.010, 0.020, 0.040), description="s; the observation contains the reference this far ahead"
    )

    @whole_group
    def _consistent(self) -> "References":
        if not sum(self.weights.values()) > 0.0:
            raise ValueError("weights: at least one family needs a positive weight")
        if self.weights.get("user", 0.0) > 0.0 and not self.user:
            raise ValueError("weights: family 'user' needs 'user', an array of positions in m")
        if list(self.preview_times) != sorted({time for time in self.preview_times if 0.0 < time <= 2.0}):
            raise ValueError("preview_times must rise, each within 0 (excluded) to 2 s")
        return self


class Reward(Group):
    """Weights of the named reward terms; all terms are costs, and the reward is at most zero.

    ``tracking``: −weight · min(|error| / error_scale, error_limit). ``effort``: −weight · (change of command)².
    ``failure``: paid once when the axis fails. The default equals the worst tracking cost forever at a discount of
    0.98; failing therefore never pays.
    """

    tracking: Number = quantity(1.0, "1", "weight of the error", 0.0, 1e6)
    error_scale: Number = quantity(0.010, "m", "error that costs 1", 1e-6, 10.0)
    family_scale: dict[Family, Annotated[Number, Field(gt=0.0, le=1e6)]] = Field(
        {}, description="factor on error_scale for a family of references; absent families: 1"
    )
    frame: Literal["axis", "sensor"] = Field(
        "axis", description="position for the error: that of the axis, or that of the biased sensor without its noise"
    )
    error_limit: Number = quantity(5.0, "1", "largest tracking cost of a step, as a multiple of error_scale", 1e-6, 1e6)
    effort: Number = quantity(0.05, "1", "weight of the change of command", 0.0, 1e6)
    failure: Number = quantity(250.0, "1", "cost of a failure", 0.0, 1e9)


class Failure(Group):
    """Limits whose violation ends an episode as a physical failure (``terminated``)."""

    end_stop_speed: Number = quantity(0.05, "m/s", "an end stop met faster than this", 0.0, 100.0)
    pressure_rating: Number = quantity(250e5, "Pa", "paper, Table 1; of valve and cylinder", 1e5, 2e8)


class Disturbance(Group):
    """External force in addition to the plant's own: a constant and a changing part; none by default."""

    kind: Literal["none", "step", "pulse", "sine", "mixed"] = Field(
        "none", description="of the changing force; mixed: step, pulse or sine, drawn per episode"
    )
    share: Number = Field(1.0, ge=0.0, le=1.0, description="of the episodes, with these forces, steady and changing")
    force_range: Range = interval((200.0, 1000.0), "N", 0.0, 1e6, "amplitude; the sign is drawn")
    force_share: Range = interval(
        (0.0, 0.0),
        "1",
        0.0,
        1.0,
        "amplitude as a share of what the supply gives against it; above 0: instead of force_range",
    )
    steady_share: Range = interval(
        (0.0, 0.0),
        "1",
        0.0,
        1.0,
        "steady force from the start, as a share of what the supply has left against it; sign drawn",
    )
    start_range: Range = interval((0.2, 0.6), "1", 0.0, 1.0, "start as a share of the episode")
    pulse_duration: Number = quantity(0.05, "s", "of a pulse", 1e-3, 100.0)
    frequency_range: Range = interval((0.5, 5.0), "Hz", 0.0, 1e3, "of a sine")


class TaskConfig(Group):
    """The whole task; every field is a keyword of ``gym.make("ServoHydraulic-v0", ...)`` and a key of a YAML file.

    Example:
        >>> from hydro_env import TaskConfig
        >>> task = TaskConfig(control_period=0.01, references={"preview_times": [0.01, 0.05]})
        >>> task.steps, task.preview_samples
        (200, (1, 5))
        >>> TaskConfig(control_period=1.0)
        Traceback (most recent call last):
            ...
        hydro_env.errors.ConfigurationError: TaskConfig: control_period = 1.0: must be a number within 0.0005 to ...
    """

    control_period: Number = quantity(5e-3, "s", "of the controller", 0.5e-3, 20e-3)
    command_latency: Number = quantity(1e-3, "s", "from sampling to the new command; at most five periods", 0.0, 0.1)
    command_latency_range: tuple[Number, Number] | None = Field(
        None,
        description="s; each episode draws its latency from it; command_latency is then the value of the data sheet",
    )
    episode_duration: Number = quantity(2.0, "s", "then the episode is truncated", 0.01, 3600.0)
    tolerance: Number = quantity(1e-6, "1", "largest error of an inner step, relative to a state's size", 1e-12, 1e-2)
    maximum_step: Number = quantity(2e-3, "s", "longest inner step of the integration", 1e-6, 20e-3)
    plant: PlantParameters = Field(PlantParameters(), description="the nominal one")
    law: RigLaw | None = Field(None, description="each episode draws its rig from it; none: the plant above")
    randomisation: Randomisation = Field(
        default_factory=default_randomisation,
        description="files and keywords change single distributions; null: not drawn; an empty group: nothing is",
    )
    leakage: LeakageDraw = LeakageDraw()
    references: References = References()
    initial_position_range: Range = interval(
        (-1.0, 1.0), "1", -1.0, 1.0, "start, as a share of the range of references on either side of mid-stroke"
    )
    start: Literal["measured", "actual"] = Field(
        "measured",
        description="position that is on the reference when an episode begins: the one that the biased sensor "
        "measures, where a controller would hold the axis; or the true one, so that the first readings reveal the bias",
    )
    sensors: Sensors = Sensors()
    reward: Reward = Reward()
    failure: Failure = Failure()
    disturbance: Disturbance = Disturbance()
    faults: Faults = Faults()

    @field_validator("randomisation", mode="before")
    @classmethod
    def _drawn(cls, given: Any) -> Any:
        """Leave out parameters whose distribution is ``null``: they are not drawn."""
        if not isinstance(given, Mapping):
            return given
        return {path: draw for path, draw in given.items() if draw is not None or path not in PARAMETER_PATHS}

    @field_serializer("randomisation")
    def _whole(self, drawn: dict[str, Distribution]) -> dict[str, Distribution | None]:
        """Name also what is not drawn, so that the default does not come back when the values are merged again."""
        absent = [path for path in default_randomisation() if path not in drawn] if drawn else []
        return {**drawn, **dict.fromkeys(absent)}

    @whole_group
    def _consistent(self) -> "TaskConfig":
        longest = MOST_LATE * self.control_period
        if self.command_latency > longest:
            raise ValueError(
                f"command_latency = {self.command_latency:g} s must not exceed {MOST_LATE} times "
                f"control_period = {self.control_period:g} s"
            )
        if self.command_latency_range:
            low, high = self.command_latency_range
            if not 0.0 <= low <= high <= longest:
                raise ValueError(
                    f"command_latency_range = [{low:g}, {high:g}]: must rise within 0 to {MOST_LATE} times "
                    f"control_period = {self.control_period:g} s"
                )
        if self.episode_duration < self.control_period:
            raise ValueError("episode_duration must be at least one control_period")
        if self.law and not (self.sensors.pressure_a.fitted and self.sensors.pressure_b.fitted):
            raise ValueError("sensors.pressure_a, pressure_b: a task that draws its rigs needs both")
        check_draws(self.randomisation, self.plant)
        return self

    @property
    def steps(self) -> int:
        """Control periods in an episode."""
        return max(round(self.episode_duration / self.control_period), 1)

    @property
    def preview_samples(self) -> tuple[int, ...]:
        """Number of control periods by which each preview looks ahead."""
        return tuple(preview_count(time, self.control_period) for time in self.references.preview_times)

    @classmethod
    def from_yaml(cls, path: str | Path, **overrides: Any) -> "TaskConfig":
        """Read a task from YAML; keywords override its fields.

        ``plant`` may be the name or the path (relative to the file) of a rig; the settings that are absent then follow
        from that rig.

        Raises:
            ConfigurationError: unreadable file, unknown key, or an impossible value.
        """
        return task_config(path, **overrides)


Given = TaskConfig | Mapping[str, Any] | str | Path | None  # what gives a task


def preview_count(time: float, period: float) -> int:
    """Control periods by which the preview for a nominal time, s, looks ahead: the nearest number, at least one."""
    return max(round(time / period), 1)


def task_config(
    config: Given = None,
    *,
    task: str | Path | None = None,
    rig: str | Path | None = None,
    folder: Path | None = None,
    **overrides: Any,
) -> TaskConfig:
    """A task from a name, a file, a mapping or nothing; the arguments of the environments.

    Args:
        config: the task; a text is a name in ``configs/tasks`` or the path of a YAML file.
        task: the same, as a keyword.
        rig: name in ``configs/rigs`` or path of a rig's YAML file. The task is adapted to this rig: each setting that
            followed from the old rig follows from the new one; all other settings stay.
        folder: base of relative paths; default: the current folder.
        overrides: single fields; they come last.

    Raises:
        ConfigurationError: the name is unknown, the file is unreadable, a key is unknown, or a value is impossible.

    Example:
        >>> from hydro_env import task_config
        >>> task_config(plant={"load": {"mass": 80.0}}, episode_duration=1.0).steps
        200
    """
    if task is not None and config is not None:
        raise ConfigurationError("task: 'task' and 'config' are two names of one argument; give one of them")
    config = task if config is None else config
    if config is not None and not isinstance(config, TaskConfig | Mapping | str | Path):
        raise ConfigurationError(f"task: config = {config!r}: must be a YAML file, a mapping or a TaskConfig")
    if isinstance(config, TaskConfig) and rig is None and not overrides:
        return config
    source, values = "task", config.model_dump() if isinstance(config, TaskConfig) else config
    try:
        if isinstance(values, str | Path):
            file = config_file("tasks", values, folder)
            source, folder, values = str(file), file.parent, read_yaml(file)
        return task_from(TaskConfig, dict(values or {}), source, folder, rig, overrides)
    except UnknownKeyError as error:
        foreign = next((name for name in overrides if name not in TaskConfig.model_fields), None)
        if foreign is None:
            raise
        fault = str(error)
        if foreign in OPTION_NAMES:
            fault = f"task: {foreign}: belongs to an episode: reset(options={{'{foreign}': …}})"
        # If the message has Python's wording, libraries omit the keyword and try again.
        raise UnknownKeyError(f"{fault}; unexpected keyword argument {foreign[:60]!r}") from None
