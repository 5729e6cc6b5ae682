"""Circumstances of a run besides its settings: versions of packages, and the machine."""

from __future__ import annotations

import os
import platform
from importlib.metadata import version
from pathlib import Path

from hydro_env import __version__


def package_versions() -> dict[str, str]:
    """Versions of the packages that the results depend on."""
    names = ("gymnasium", "numba", "numpy", "scipy", "stable-baselines3", "torch")
    own = {"python": platform.python_version(), "hydro_env": __version__}
    return {**own, **{name: version(name) for name in names}}


def machine_description() -> str:
    """Processor, cores and system in one line."""
    model = platform.processor() or platform.machine()
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
        model = next((line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")), model)
    except OSError:
        pass
    return f"{model}, {os.cpu_count()} cores, {platform.system()}"
