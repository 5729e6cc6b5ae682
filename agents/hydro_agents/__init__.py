"""Everything that acts on the servo axis or watches it: controllers, learning, leakage detection, evaluation."""

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from hydro_agents.evaluation.evaluate import evaluate

__all__ = ["evaluate"]


def __getattr__(name: str) -> Any:
    """Load the public names when they are used: they need the learning libraries."""
    if name not in __all__:
        raise AttributeError(f"module 'hydro_agents' has no attribute '{name}'")
    from hydro_agents.evaluation import evaluate as protocol

    return getattr(protocol, name)
