"""What knowing the leak is worth: flow linearisation that is told the leak instead of estimating it.

It is no controller of a rig, which cannot measure its leak; it takes part in any comparison by its name:

    hydro evaluate --task press --leak 0.01 2 4 6 --agent "told the leak=benchmarks.told_leak:ToldLeak" \
        --agent PID=configs/agents/pid_press.yaml
"""

from hydro_agents.controllers.base import Observation
from hydro_agents.controllers.flow_linearising import FlowLinearising, FlowLinearisingGains, FlowLinearisingState
from hydro_agents.controllers.flow_model import Flow
from hydro_agents.controllers.motion_filter import LEAK
from hydro_agents.learning.loading import usual_gains
from hydro_env import ConfigurationError, TaskConfig
from hydro_env.axes import Axes
from hydro_env.types import Floats
from hydro_env.units import LEAKAGE_TEST_PRESSURE, LITRE_PER_MINUTE


class ToldLeak(FlowLinearising):
    """Flow linearisation with the gains of the paper's rig; :func:`~hydro_agents.running.cases.run_cases` runs it."""

    def __init__(self, config: TaskConfig) -> None:
        super().__init__(FlowLinearisingGains.model_validate(usual_gains("flow_linearising")), config)
        self._axes: Axes | None = None

    def begin(self, axes: Axes) -> None:
        """Prepare for the episodes of the axes, which have just been reset."""
        self._axes = axes

    def _observed(
        self, old: FlowLinearisingState, batch: Observation, flow: Flow, position: Floats, spool: Floats
    ) -> FlowLinearisingState:
        if self._axes is None:
            raise ConfigurationError("told the leak: reads the leak of the axes; run it with run_cases")
        leak = self._axes.column("leak_flow") * LITRE_PER_MINUTE / LEAKAGE_TEST_PRESSURE
        estimate, covariance = old.estimate.copy(), old.covariance.copy()
        estimate[:, LEAK] = leak
        covariance[:, LEAK, :] = covariance[:, :, LEAK] = 0.0
        now = super()._observed(old._replace(estimate=estimate, covariance=covariance), batch, flow, position, spool)
        now.estimate[:, LEAK] = leak
        return now
