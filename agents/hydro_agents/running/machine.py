"""Conditions of a run besides its settings: command, date, commit, versions of packages, and machine."""

import contextlib
import datetime
import functools
import os
import platform
import subprocess
from collections.abc import Mapping
from importlib.metadata import version
from pathlib import Path
from typing import NamedTuple

import hydro_env
from hydro_env import __version__


class Origin(NamedTuple):
    """Origin of a page."""

    command: str
    date: str  # UTC
    version: str  # of hydro_env, with the commit if there is one

    @classmethod
    def now(cls, command: str) -> "Origin":
        """The origin of a page that a command writes now."""
        return cls.of({**package_versions(), "date": date_now(), "command": command})

    @classmethod
    def of(cls, facts: Mapping[str, str]) -> "Origin":
        """The origin from the facts of a run: command, date, hydro_env, commit."""
        commit = facts.get("commit", "")
        made_with = facts.get("hydro_env", "")
        if commit:
            made_with += f", commit {commit}"
        return cls(facts.get("command", ""), facts.get("date", ""), made_with)


def date_now() -> str:
    """Date and time in UTC, to the minute."""
    return datetime.datetime.now(datetime.UTC).strftime("%Y-%m-%d %H:%M UTC")


CODE = (":/", ":(top,exclude)docs", ":(top,exclude)*.md")  # of the repository; no figure depends on the pages


@functools.cache
def commit() -> str:
    """Commit of the sources, plus "with changes" if more than pages differ; empty for a package without sources."""
    git = ["git", "-C", str(Path(hydro_env.__file__).parent)]
    try:
        subprocess.run([*git, "ls-files", "--error-unmatch", "version.py"], check=True, capture_output=True)
        name = subprocess.run([*git, "rev-parse", "--short", "HEAD"], check=True, capture_output=True, text=True)
        changes = subprocess.run([*git, "diff", "--quiet", "HEAD", "--", *CODE], check=False, capture_output=True)
    except (OSError, subprocess.CalledProcessError):
        return ""
    return name.stdout.strip() + (" with changes" if changes.returncode else "")


def package_versions() -> dict[str, str]:
    """Commit of the sources, if there is one, and versions of the packages that the results depend on."""
    versions = {"python": platform.python_version(), "hydro_env": __version__}
    if commit():
        versions["commit"] = commit()
    packages = ("gymnasium", "numba", "numpy", "scipy", "stable-baselines3", "torch")
    return versions | {name: version(name) for name in packages}


def machine_description() -> str:
    """Processor, cores and system in one line."""
    model = platform.processor() or platform.machine()
    with contextlib.suppress(OSError):
        for line in Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines():
            if line.startswith("model name"):
                model = line.split(":", 1)[1].strip()
    return f"{model}, {os.cpu_count()} cores, {platform.system()}"
