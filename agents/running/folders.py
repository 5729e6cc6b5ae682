"""Folders: where configuration files and shipped weights lie, and where results may go."""

from __future__ import annotations

from pathlib import Path

from hydro_env.errors import ConfigurationError
from hydro_env.files import write_whole

_PACKAGE = Path(__file__).resolve().parents[1]


def config_folder() -> Path:
    """``configs/``: beside the package in a checkout, inside it when installed."""
    beside = _PACKAGE.parent / "configs"
    return beside if (beside / "studies").is_dir() else _PACKAGE / "configs"


def pretrained_folder() -> Path:
    """The weights that ship with the project."""
    return _PACKAGE / "pretrained"


def prepare_folder(folder: Path, resume: bool, overwrite: bool, *written: str, can_resume: bool = False) -> None:
    """Check that results may go into a folder, and that it can be written.

    Args:
        folder: for the results.
        resume: the user wants to go on with what is there.
        overwrite: the user wants to replace what is there.
        written: names of the files that the job writes.
        can_resume: whether the job knows how to go on.

    Raises:
        ConfigurationError: it holds results and neither resume nor overwrite is asked for, or cannot be written.
    """
    if resume and overwrite:
        raise ConfigurationError("--resume and --overwrite exclude each other")
    found = next((name for name in written if (folder / name).exists()), None)
    if found is not None and not (resume or overwrite):
        ways = "--resume goes on with them, " if can_resume else ""
        raise ConfigurationError(
            f"{folder}: holds results already ({found}); {ways}--overwrite replaces them, --output takes another folder"
        )
    if folder.exists() and not folder.is_dir():
        raise ConfigurationError(f"{folder}: is a file, a folder is needed")
    probe = folder / ".write-test"
    write_whole(probe, b"")
    probe.unlink()
