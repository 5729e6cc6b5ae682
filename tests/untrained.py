"""A leakage head with random weights."""

from hydro_agents.detection.head import HeadSettings, LeakageHead, tensors_like
from hydro_agents.detection.head_training import make_network, network_tensors
from hydro_env import TaskConfig


def untrained_head(config: TaskConfig, width: int = 8) -> LeakageHead:
    """A head for windows of one to four episodes of the task."""
    tensors = tensors_like(width) | network_tensors(make_network(width))
    tensors["scale"][:] = tensors["widening"][:] = tensors["limit"][:] = 1.0
    settings = HeadSettings(
        task=config, window=config.steps, longest=4 * config.steps, threshold=0.5, width=width, training={}
    )
    return LeakageHead(tensors, settings)
