"""Trainers by name; to add an algorithm, write a class with two methods in a new file."""

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

from hydro_agents.controllers.base import Controller
from hydro_agents.controllers.by_name import imported
from hydro_agents.learning.policy import PolicyController
from hydro_agents.learning.settings import PPOSettings
from hydro_env import ConfigurationError, TaskConfig
from hydro_env.errors import reason
from hydro_env.files import Group

if TYPE_CHECKING:
    from hydro_agents.learning.progress import Progress


class TrainedController(Controller, Protocol):
    """A controller whose weights can be saved."""

    def save(self, path: str | Path) -> Path:
        """Write the weights in a format that loads without running code; returns the file."""
        ...


class Trainer(Protocol):
    """An algorithm that trains a controller for a task."""

    settings: type[Group]  # class of the settings in a YAML file

    def train(
        self,
        config: TaskConfig,
        settings: Group,
        *,
        seed: int,
        folder: Path,
        resume: bool,
        base: Controller | None,
        progress: "Callable[[Progress], None] | None",
    ) -> TrainedController:
        """Train a controller.

        Args:
            config: the task.
            settings: an instance of the class's ``settings``.
            seed: seed of all random numbers.
            folder: for checkpoints and logs.
            resume: continue from the checkpoint in ``folder``.
            base: the controller that a residual form corrects, if there is one.
            progress: called regularly.

        Raises:
            ConfigurationError: impossible settings, or nothing to resume.
        """
        ...

    def load(self, path: Path) -> TrainedController:
        """Read weights that a controller of this trainer saved.

        Raises:
            ConfigurationError: the files are missing, damaged, or of another kind.
        """
        ...


class PPOTrainer:
    """PPO of stable-baselines3, or RecurrentPPO of sb3-contrib; they are imported when a training begins."""

    settings: type[Group] = PPOSettings

    def train(self, config: TaskConfig, settings: Any, **options: Any) -> PolicyController:
        """Train a policy; the residual form corrects the ``base`` of the options, a classical controller."""
        from hydro_agents.learning.training import train_policy

        return train_policy(config, settings, **options)

    def load(self, path: Path) -> PolicyController:
        """Read weights that ``PolicyController.save`` wrote."""
        return PolicyController.load(path)


TRAINERS: dict[str, Trainer] = {"ppo": PPOTrainer()}


def trainer(kind: str) -> Trainer | None:
    """The trainer of a name in :data:`TRAINERS`, or of ``my_module:MyTrainer``; ``None``: it names no trainer.

    Raises:
        ConfigurationError: the module cannot be imported, or the trainer cannot be made.
    """
    if ":" not in kind:
        return TRAINERS.get(kind)
    made = imported(kind)
    if not (hasattr(made, "train") and hasattr(made, "load")):
        return None
    if isinstance(made, type):
        try:
            made = made()
        except Exception as error:  # a user's class may raise anything
            raise ConfigurationError(f"trainer '{kind}': cannot be made: {reason(error)}") from None
    if not hasattr(made, "settings"):
        raise ConfigurationError(f"trainer '{kind}': needs settings, train and load")
    return made
