"""``hydro record``: a recording of a simulated axis with the signals of a rig, or episodes as a data set of Minari."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import gymnasium as gym
import numpy as np
import pandas as pd

from hydro_agents.controllers.base import Controller
from hydro_agents.detection.detector import measured_run
from hydro_agents.running.cases import Cases
from hydro_env import ConfigurationError, TaskConfig, __version__
from hydro_env.files import write_text
from hydro_env.types import Floats
from hydro_rig.recordings.columns import MEASURED, factor

WRITTEN_UNITS = {
    "time": "s",
    "position": "mm",
    "pressure_a": "bar",
    "pressure_b": "bar",
    "spool_position": "%",
    "command": "V",
}

_FORMAT = "%.7g"  # digits for the 16-bit steps of every sensor
LONGEST_RECORDING = 3600.0  # s
MOST_EPISODES = 100_000


class Recorded(NamedTuple):
    """Summary of a recording."""

    rows: int
    duration: float  # s
    leakage_flow_lpm: float  # at the end
    failed_at: float | None  # s, time of the failure, where the recording ends; None: no failure


def record_axis(
    path: Path,
    config: TaskConfig,
    controller: Controller,
    seed: int,
    leakage_flow_lpm: float | None = None,
    family: str | None = None,
    faults: Mapping[str, float] | None = None,
    note: str = "",
) -> Recorded:
    """Run one episode and write its measured signals as CSV, one row per control period.

    The command of a row acts when the row is measured.

    Args:
        path: the file; replaced if it exists.
        config: the task; its ``episode_duration`` is that of the recording.
        controller: moves the axis.
        seed: of plant, reference and noise.
        leakage_flow_lpm: l/min at 100 bar; ``None``: drawn, as the ``family`` of the reference.
        family: of the reference.
        faults: magnitude by name (:data:`hydro_env.task.faults.FAULTS`).
        note: for a comment in the first line.

    Raises:
        ConfigurationError: an option is impossible, or the file cannot be written.

    Example:
        >>> from pathlib import Path
        >>> from hydro_agents.learning.loading import shipped
        >>> from hydro_rig.recordings.simulated import record_axis
        >>> from hydro_env import TaskConfig
        >>> task = TaskConfig(episode_duration=1.0)
        >>> record_axis(Path("axis.csv"), task, shipped("pid", task), seed=1, leakage_flow_lpm=0.5)
        Recorded(rows=200, duration=1.0, leakage_flow_lpm=0.5, failed_at=None)
    """
    if config.episode_duration > LONGEST_RECORDING:
        raise ConfigurationError(f"--duration = {config.episode_duration:g} s: must be at most {LONGEST_RECORDING:g} s")
    cases = Cases(
        np.array([seed]),
        None if leakage_flow_lpm is None else np.array([leakage_flow_lpm]),
        None if family is None else np.array([family]),
        faults={name: np.array([size]) for name, size in (faults or {}).items()} or None,
    )
    signals, run = measured_run(config, controller, cases)
    failed = bool(run.failed_at[0] >= 0)
    rows = int(run.failed_at[0]) + 1 if failed else config.steps
    duration = rows * config.control_period
    time = np.arange(rows, dtype=np.float64) * config.control_period
    write_text(path, recording_csv(time, signals[0, :, :rows], note))
    return Recorded(rows, duration, float(run.leakage_flow_lpm[0]), duration if failed else None)


def recording_csv(time: Floats, signals: Floats, note: str = "") -> str:
    """A recording as CSV text; ``time`` (n,), s; ``signals`` (5, n), SI, in the order of MEASURED; NaN: absent."""
    values = dict(zip(MEASURED, signals, strict=True))
    table = pd.DataFrame({heading("time"): np.round(time, 6)})
    for name in MEASURED:
        if np.isfinite(values[name]).any():
            table[heading(name)] = values[name] / factor(name, WRITTEN_UNITS[name], name)
    comment = f"# {' '.join(note.split())}\n" if note else ""
    text: str = table.to_csv(index=False, float_format=_FORMAT, lineterminator="\n")
    return comment + text


def heading(signal: str) -> str:
    """Heading of a column: ``position [mm]``."""
    return f"{signal} [{WRITTEN_UNITS[signal]}]"


def check_dataset(name: str) -> None:
    """Check that a data set of this name can be made, before any work.

    Raises:
        ConfigurationError: Minari is missing, the name is invalid, or the data set exists.
    """
    try:
        import minari
        from minari.dataset.minari_dataset import parse_dataset_id
    except ImportError:
        raise ConfigurationError('a data set needs Minari: pip install "hydro_env[minari]"') from None
    try:
        parse_dataset_id(name)
    except (TypeError, ValueError):  # TypeError: a name without a version
        raise ConfigurationError(f"{name}: must be NAME-v0 or FOLDER/NAME-v0") from None
    if name in minari.list_local_datasets():
        raise ConfigurationError(f"{name}: exists; choose another name, or run: minari delete {name}")


def record_dataset(
    name: str,
    config: TaskConfig,
    controller: Controller,
    algorithm: str,
    episodes: int,
    first_seed: int,
    options: Mapping[str, Any],
    note: str = "",
    progress: Callable[[int], None] | None = None,
) -> tuple[int, Path]:
    """Run episodes of the environment and store them in Minari's folder (``MINARI_DATASETS_PATH``).

    The data set contains the whole task; ``recover_environment`` therefore works on another machine. The infos are
    those of ``info="flat"``: leak, class, faults and true motion, which are not in the observations. ``options`` are
    those of ``reset``; ``progress`` is called with the number of finished episodes.

    Returns:
        The number of steps, and the folder of the data set.

    Raises:
        ConfigurationError: Minari is missing, or an option or the name is impossible.
    """
    check_dataset(name)
    import minari

    if not 1 <= episodes <= MOST_EPISODES:
        raise ConfigurationError(f"episodes {episodes}: must be within 1 to {MOST_EPISODES}")
    buffers = []
    with gym.make("hydro_env:ServoHydraulic-v0", config=config.model_dump(mode="json"), info="flat") as env:
        for number in range(episodes):
            buffers.append(_episode(env, controller, number, first_seed + number, options))
            if progress is not None:
                progress(number + 1)
        with warnings.catch_warnings():  # the user adds author and code link
            warnings.simplefilter("ignore")
            dataset = minari.create_dataset_from_buffers(
                name,
                buffers,
                env=env,
                algorithm_name=algorithm,
                description=note,
                requirements=[f"hydro_env=={__version__}"],
            )
    return int(dataset.total_steps), Path(dataset.storage.data_path).parent


def _episode(env: Any, controller: Controller, number: int, seed: int, options: Mapping[str, Any]) -> Any:
    """One episode; Minari's own collector would need JAX."""
    from minari.data_collector import EpisodeBuffer

    observation, info = env.reset(seed=seed, options=dict(options))
    observations, infos, steps = [observation], [info], []
    memory, over = None, False
    while not over:
        action, memory = controller.predict(observation, memory)
        observation, reward, terminated, truncated, info = env.step(action)
        observations.append(observation)
        infos.append(info)
        steps.append((action, reward, terminated, truncated))
        over = terminated or truncated
    actions, rewards, terminations, truncations = zip(*steps, strict=True)
    return EpisodeBuffer(
        id=number,
        seed=seed,
        observations=np.stack(observations),
        actions=np.stack(actions),
        rewards=list(rewards),
        terminations=list(terminations),
        truncations=list(truncations),
        infos={key: np.array([each[key] for each in infos]) for key in info},
    )
