"""All checks of a recording, before any verdict."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from hydro_agents.recordings.channels import check_channels
from hydro_agents.recordings.findings import Finding, Weight
from hydro_agents.recordings.recording import Recording
from hydro_agents.recordings.sampling import Sampled, sampled
from hydro_agents.recordings.wiring import check_wiring
from hydro_env import TaskConfig


class Checked(NamedTuple):
    """A recording at the control period, and all findings about it."""

    samples: Sampled  # invalid readings are NaN
    findings: list[Finding]

    @property
    def severe(self) -> list[Finding]:
        """Findings that rule out a verdict."""
        return [finding for finding in self.findings if finding.weight is Weight.SEVERE]

    @property
    def faults(self) -> list[Finding]:
        """Findings that show a faulty sensor."""
        return [finding for finding in self.findings if finding.weight is Weight.FAULT]


def check_recording(recording: Recording, config: TaskConfig) -> Checked:
    """Check time stamps, channels and wiring of a recording for the rig of a task.

    Each check relies on the previous ones, and is left out after a severe finding.
    """
    samples = sampled(recording, config)
    findings = [*recording.findings, *samples.findings]
    checked = Checked(samples, findings)
    if not len(samples.time):
        return checked
    channels = check_channels(samples, config)
    findings += channels.findings
    samples = samples._replace(signals=np.where(channels.bad, np.nan, samples.signals))
    if not checked.severe and not checked.faults:
        findings += check_wiring(samples, config)
    return Checked(samples, findings)
