"""``hydro record --minari``: episodes of a controller as a data set of Minari, for offline learning."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import gymnasium as gym
import numpy as np

from hydro_agents.controllers.base import Controller
from hydro_env import ConfigurationError, TaskConfig, __version__

MOST_EPISODES = 100_000


class DatasetSummary(NamedTuple):
    """Summary of a recorded data set."""

    episodes: int
    steps: int
    folder: str


def check_dataset(name: str) -> None:
    """Check that a data set of this name can be made, before any work.

    Raises:
        ConfigurationError: Minari is missing, the name is invalid, or the data set exists.
    """
    try:
        import minari
        from minari.dataset.minari_dataset import parse_dataset_id
    except ImportError:
        raise ConfigurationError('--minari needs Minari: pip install "hydro_env[minari]"') from None
    try:
        parse_dataset_id(name)
    except ValueError:
        raise ConfigurationError(f"--minari {name}: must be NAME-v0 or FOLDER/NAME-v0") from None
    if name in minari.list_local_datasets():
        raise ConfigurationError(f"--minari {name}: exists; choose another name, or run: minari delete {name}")


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
) -> DatasetSummary:
    """Run episodes of the environment and store them in Minari's folder (``MINARI_DATASETS_PATH``).

    The data set contains the whole task; ``recover_environment`` therefore works on another machine. The infos are
    those of ``info="flat"``: leak, class, faults and true motion, which are not in the observations.

    Args:
        name: of the data set, ``FOLDER/NAME-v0``.
        config: the task.
        controller: moves the axis.
        algorithm: name of the controller.
        episodes: number of episodes.
        first_seed: seed of the first episode; the others follow.
        options: of ``reset``.
        note: description of the data set.
        progress: called with the number of finished episodes.

    Raises:
        ConfigurationError: Minari is missing, or an option or the name is impossible.
    """
    check_dataset(name)
    import minari
    from minari.data_collector import EpisodeBuffer

    if not 1 <= episodes <= MOST_EPISODES:
        raise ConfigurationError(f"--episodes = {episodes}: must be within 1 to {MOST_EPISODES}")
    buffers = []
    with gym.make("hydro_env:ServoHydraulic-v0", config=config.model_dump(mode="json"), info="flat") as env:
        for number in range(episodes):
            seed = first_seed + number
            observation, info = env.reset(seed=seed, options=dict(options))
            rows: dict[str, list[Any]] = {"observations": [observation], "actions": [], "rewards": []}
            infos, memory = [info], None
            failed: list[bool] = []
            ended: list[bool] = []
            while not (failed and (failed[-1] or ended[-1])):
                action, memory = controller.predict(observation, memory)
                observation, reward, terminated, truncated, info = env.step(action)
                for key, value in (("observations", observation), ("actions", action), ("rewards", reward)):
                    rows[key].append(value)
                infos.append(info)
                failed.append(terminated)
                ended.append(truncated)
            buffers.append(
                EpisodeBuffer(
                    id=number,
                    seed=seed,
                    observations=np.stack(rows["observations"]),
                    actions=np.stack(rows["actions"]),
                    rewards=rows["rewards"],
                    terminations=failed,
                    truncations=ended,
                    infos={key: np.array([one[key] for one in infos]) for key in infos[0]},
                )
            )
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
    return DatasetSummary(episodes, int(dataset.total_steps), str(dataset.storage.data_path.parent))
