"""Where the configuration files and the shipped weights lie, in a checkout and in an installed package."""

from __future__ import annotations

from pathlib import Path

_PACKAGE = Path(__file__).resolve().parent


def config_folder() -> Path:
    """``configs/``: beside the package in a checkout, inside it when installed."""
    beside = _PACKAGE.parent / "configs"
    return beside if (beside / "studies").is_dir() else _PACKAGE / "configs"


def pretrained_folder() -> Path:
    """The weights that ship with the project."""
    return _PACKAGE / "pretrained"
