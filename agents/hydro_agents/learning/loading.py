"""Controllers by name, file or object, checked against the task: what a command or an evaluation is asked to run.

A name of weights or gains that ship, a file, or an object of your own.
"""

import re
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hydro_agents.controllers.base import Controller, ObservationLayout, check_layout
from hydro_agents.controllers.registry import CONTROLLERS, GAINS_FILE, controller_from_gains, make_controller
from hydro_agents.learning.policy import PolicyController
from hydro_agents.learning.rig_gains import GainsFor, chosen_gains, searched_gains
from hydro_agents.running.cases import check_predict
from hydro_agents.running.folders import shipped_weights
from hydro_agents.running.weights import weight_files
from hydro_env import ConfigurationError, PlantParameters, TaskConfig
from hydro_env.errors import at
from hydro_env.files import Group, read_yaml
from hydro_env.folders import config_folder
from hydro_env.mistakes import unknown
from hydro_env.task.law import RigLaw
from hydro_env.task.paces import outside_law
from hydro_env.types import ByName

if TYPE_CHECKING:
    from hydro_agents.learning.trainers import Trainer

_ATTRIBUTE = re.compile(r"[A-Za-z_][\w.]*:[A-Za-z_][\w.]*")
SHIPPED_WEIGHTS = {"ppo": "policy"}  # file of the shipped weights by kind; with _any_axis: of those for any axis


class GainsOrigin(StrEnum):
    """Where the gains of a classical controller come from on a rig; in words for a person."""

    TUNED = "tuned for this rig"
    ANY_RIG = "gains for any rig, which nobody tuned for this one"
    SEARCHED = "searched on a simulation of this rig"
    FIGURES = "from the figures of this rig"
    RIG = "from the figures of this rig, and a simulation of it"


def shipped(kind: str, config: TaskConfig, gains: GainsFor = chosen_gains) -> Controller:
    """The controller that comes with the project: on the paper's rig with gains or weights for it.

    On any other rig flow linearisation takes its gains for any rig, the defaults of its class. ``gains`` finds those of
    a PID there, and those that a policy for any axis corrects: one of a few sets by default, in seconds;
    :func:`load_controller` searches for a minute.

    Raises:
        ConfigurationError: the kind is not shipped, or no gains of a PID suit the rig.

    Example:
        >>> from hydro_agents.learning.loading import shipped
        >>> from hydro_env import TaskConfig
        >>> pid, policy = (shipped(kind, TaskConfig()) for kind in ("pid", "ppo"))
        >>> type(pid).__name__, type(policy).__name__
        ('PID', 'PolicyController')
    """
    if kind in SHIPPED_WEIGHTS:
        return load_policy(shipped_weights(SHIPPED_WEIGHTS[kind], config), config, gains)
    match origin_of_gains(kind, config):
        case GainsOrigin.TUNED:
            return make_controller(kind, config, usual_gains(kind))
        case GainsOrigin.RIG:
            return make_controller(kind, config, gains(kind, config).model_dump())
    return make_controller(kind, config)


def load_policy(path: Path, config: TaskConfig, gains: GainsFor, trainer: "Trainer | None" = None) -> Controller:
    """A policy from its weights; one for any axis moves to the rig of the task, ``gains`` as in :func:`shipped`.

    Raises:
        ConfigurationError: the weights cannot be read, or the rig lacks a sensor that the policy needs.
    """
    policy = PolicyController.load(path) if trainer is None else trainer.load(path)
    if isinstance(policy, PolicyController) and policy.features.for_any_axis and policy.features.config != config:
        return policy.moved_to(config, gains)
    return policy


def load_controller(
    what: Controller | str | Path,
    config: TaskConfig,
    name: str,
    trainer: "Trainer | None" = None,
    gains: GainsFor | None = None,
) -> Controller:
    """A controller for a task.

    Args:
        what: an object with ``predict``; or ``"pid"`` or ``"ppo"`` (as shipped), ``"module:attribute"`` (see
            :func:`~hydro_agents.controllers.registry.make_controller`), the path of weights, a YAML file of tuned
            gains, or a folder ``controllers/NAME`` of a study.
        config: the task.
        name: for messages.
        trainer: trainer that loads weights; default PPO.
        gains: finds the gains that depend on the rig, as for :func:`shipped`; default: a search of a minute.

    Raises:
        ConfigurationError: the controller does not exist, or needs other observations; the message names it.

    Example:
        >>> from hydro_agents.learning.loading import load_controller
        >>> from hydro_env import TaskConfig
        >>> type(load_controller("flow_linearising", TaskConfig(), "mine")).__name__
        'FlowLinearising'
        >>> load_controller("pidd", TaskConfig(), "mine")
        Traceback (most recent call last):
            ...
        hydro_env.errors.ConfigurationError: mine: 'pidd': unknown; did you mean pid? ...
    """
    finds = gains or searched_gains
    with at(name):
        controller = _named(found_in(what), config, trainer, finds) if isinstance(what, str | Path) else what
        check_predict(controller)
        layout = getattr(getattr(controller, "features", controller), "layout", None)
        if isinstance(layout, ObservationLayout):
            check_layout(layout, config)
    return controller


def _named(what: str, config: TaskConfig, trainer: "Trainer | None", gains: GainsFor) -> Controller:
    if what in CONTROLLERS or what in SHIPPED_WEIGHTS:
        return shipped(what, config, gains)
    if what.endswith(".zip"):
        raise ConfigurationError(
            f"{what}: a zip file of stable-baselines3 runs code when it is loaded; load it in your own module "
            "and give module:attribute"
        )
    if what.endswith(".yaml"):
        return controller_from_gains(what, config)
    if _ATTRIBUTE.fullmatch(what):
        return make_controller(what, config)
    if trainer is None and "/" not in what and not any(file.is_file() for file in weight_files(what)):
        names = unknown(what, (*CONTROLLERS, *SHIPPED_WEIGHTS))
        raise ConfigurationError(f"'{what}': {names}; or give module:attribute, or a path of weights")
    return load_policy(Path(what), config, gains, trainer)


def found_in(what: str | Path) -> str:
    """The weights or gains in a controller's folder of a study; any other text as it is."""
    for name in ("policy.json", GAINS_FILE):  # beside weights the gains are those of the controller that they correct
        if (Path(what) / name).is_file():
            return str(Path(what) / name).removesuffix(".json")
    return str(what)


# What ships, and for which rig ---------------------------------------------------------------------------------------


def origin_of_gains(kind: str, config: TaskConfig) -> GainsOrigin:
    """Where the gains of a shipped classical controller come from on a task's rig."""
    if config.plant == PlantParameters():
        return GainsOrigin.TUNED
    return GainsOrigin.RIG if kind == "pid" else GainsOrigin.ANY_RIG


def usual_gains(kind: str) -> ByName:
    """A classical controller's gains for the paper's rig."""
    return read_yaml(config_folder() / "agents" / f"{kind}.yaml")


def ships(kind: str, gains: Group) -> bool:
    """Whether the gains of a classical controller ship, of whichever rig, or are the defaults of their class."""
    known = [type(gains)()]
    for file in (config_folder() / "agents").glob(f"{kind}*.yaml"):
        if not file.stem.endswith("_sets"):
            known.append(type(gains).model_validate(read_yaml(file)))
    return gains in known


def outside_training(trained: Any, config: TaskConfig) -> str:
    """Where a rig lies outside the drawn rigs of a training of policy or head, and how far; empty: nowhere."""
    training = getattr(getattr(trained, "settings", trained), "training", None) or {}
    law = training.get("settings", {}).get("law")
    return outside_law(RigLaw.model_validate(law), config) if law else ""


def trained_elsewhere(controller: Controller, config: TaskConfig) -> bool:
    """Whether a controller is a policy whose training had another nominal rig than the task."""
    features = getattr(controller, "features", None)
    return features is not None and features.config.plant != config.plant
