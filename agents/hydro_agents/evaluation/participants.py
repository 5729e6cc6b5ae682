"""The controllers of a protocol, and those for single conditions."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

from hydro_agents.controllers.base import Controller, ObservationLayout
from hydro_agents.controllers.registry import controller_with_gains
from hydro_agents.learning.loading import load_controller
from hydro_agents.running.seeds import SEED_MARK
from hydro_env import ConfigurationError
from hydro_env.errors import at

if TYPE_CHECKING:
    from hydro_agents.evaluation.robustness_protocol import RobustnessProtocol


@dataclass(frozen=True)
class Participants:
    """Controllers by name, the baseline first."""

    controllers: Mapping[str, Controller]
    corrects: Mapping[str, str] = field(default_factory=dict)  # names of policies and of what they correct

    def of(self, name: str, condition: str, protocol: "RobustnessProtocol") -> Controller | str:
        """The controller that runs under a condition, or the reason why none can.

        The protocol may name one for this condition; else the general one runs if it knows such observations.

        Raises:
            ConfigurationError: the controller for this condition cannot be made.
        """
        entry, task = protocol.conditions[condition], protocol.tasks[condition]
        if name in entry.controllers:
            with at(f"conditions.{condition}.controllers.{name}"):
                what = entry.controllers[name]
                return load_controller(what if isinstance(what, str) else controller_with_gains(what, task), task, name)
        if entry.rig is not None:
            return "no controller of this name is tuned for this rig"
        here, known = ObservationLayout.of(task), ObservationLayout.of(protocol.task)
        if here.control_period != known.control_period:
            return f"no controller of this name is tuned for a control period of {1e3 * here.control_period:g} ms"
        if here != known:
            return "the observations differ from those that it knows"
        return self.controllers[name]


def participants(
    controllers: Mapping[str, Controller | str | Path],
    protocol: "RobustnessProtocol",
    corrects: Mapping[str, str] | None = None,
) -> Participants:
    """Make the controllers of a protocol.

    Args:
        controllers: by name, objects with ``predict`` or texts of
            :func:`~hydro_agents.learning.loading.load_controller`. The first one is the baseline. ``NAME#0``,
            ``NAME#1``, … are training seeds of one controller.
        protocol: the protocol.
        corrects: names of policies and of what they correct.

    Raises:
        ConfigurationError: there is no controller, a name is wrong, or a controller cannot be made for its task.
    """
    if not controllers:
        raise ConfigurationError("protocol: needs at least one controller")
    known: dict[tuple[str, int], str] = {}
    for name in controllers:
        same = known.setdefault(split_name(name), name)
        if same != name:
            raise ConfigurationError(f"controllers '{same}' and '{name}': name the same training seed of a controller")
    ready = {name: load_controller(what, protocol.task, name) for name, what in controllers.items()}
    return Participants(ready, corrects or {})


def split_name(name: str) -> tuple[str, int]:
    """Controller and training seed of a name: ``PPO#3`` is seed 3 of PPO; a name without a mark is seed 0.

    Raises:
        ConfigurationError: the part after the mark is not a number.
    """
    controller, mark, seed = name.partition(SEED_MARK)
    if not controller or (mark and not seed.isdecimal()):
        raise ConfigurationError(f"controller '{name}': must be NAME, or NAME#0, NAME#1, … for training seeds")
    return controller, int(seed) if mark else 0
