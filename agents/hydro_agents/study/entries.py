"""One controller in the file of a study, and what it takes over from an earlier one."""

from __future__ import annotations

from collections.abc import Collection
from functools import cached_property
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, Field, StringConstraints

from hydro_agents.controllers.registry import CONTROLLERS, imported
from hydro_agents.learning.trainers import TRAINERS, Trainer, trainer
from hydro_agents.running.text import NAME_RULE
from hydro_env.files import Group
from hydro_env.mistakes import did_you_mean, unknown
from hydro_env.task.rig import merged

Name = Annotated[str, StringConstraints(pattern=NAME_RULE)]


class TuningSettings(Group):
    """Tuning of a classical controller (:func:`hydro_agents.learning.tuning.tune`) before it takes part in a study."""

    objective: Literal["mean", "equal"] = Field("equal", description="mean error, or each family with equal weight")
    evaluations: int = Field(840, ge=1, le=10_000_000, description="total number of candidates")
    cases: int = Field(42, ge=1, le=100_000, description="training cases per candidate")


def _known_kind(kind: str) -> str:
    if ":" not in kind and kind not in (*CONTROLLERS, *TRAINERS):
        raise ValueError(f"{unknown(kind, (*CONTROLLERS, *TRAINERS))}, or 'module:attribute'")
    return kind


class ControllerEntry(Group):
    """One controller of a study."""

    kind: Annotated[str, AfterValidator(_known_kind)] = Field(
        description="pid, ppo, or module:attribute for your own controller or trainer"
    )
    settings: dict[str, Any] = Field(
        default_factory=dict, description="settings of the controller or its training; or the path of a YAML file"
    )
    after: str | None = Field(
        None,
        exclude=True,
        description="an earlier entry, whose kind, settings and corrected controller apply where this one says nothing",
    )
    corrects: str | None = Field(None, description="name of the controller whose command a trained one corrects")
    tune: TuningSettings | None = Field(
        None,
        description="for a classical controller: tune its gains first, beginning with its settings; --rig always does",
    )

    @cached_property
    def trainer(self) -> Trainer | None:
        """Its trainer; ``None`` for a controller that needs no training.

        Raises:
            ConfigurationError: its module cannot be imported.
        """
        if self.kind in CONTROLLERS:
            return None
        if ":" in self.kind:
            given = imported(self.kind)
            return trainer(self.kind) if hasattr(given, "train") and hasattr(given, "load") else None
        return TRAINERS[self.kind]


def refuse_later(name: str, key: str, named: str | None, earlier: Collection[str]) -> None:
    """Refuse an entry that names another one in a field if that one does not stand before it."""
    if named is not None and named not in earlier:
        must = f"must be a controller before it ({', '.join(earlier) or 'none'})"
        raise ValueError(f"controllers.{name}: {key} = '{named}': {must}{did_you_mean(named, earlier)}")


def following(entry: dict[str, Any], before: dict[str, Any] | None, training: Any) -> dict[str, Any]:
    """An entry with what it takes over; the settings are merged group by group."""
    whole = (before or {}) | entry | {"after": None}
    first = (before or {}).get("settings", {})
    if before is None and str(whole.get("kind")) not in CONTROLLERS:
        first = training
    own = entry.get("settings", {})
    if isinstance(first, dict) and isinstance(own, dict):
        whole["settings"] = merged(first, own)
    return whole
