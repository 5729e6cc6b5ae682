"""Folders of shipped weights and of results; :mod:`hydro_env.folders` finds the configuration files."""

from __future__ import annotations

import errno
import json
import os
import sys
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from fnmatch import fnmatchcase
from pathlib import Path

from filelock import FileLock, Timeout

from hydro_env import ConfigurationError, __version__
from hydro_env.files import read_json, write_whole
from hydro_env.folders import config_folder as config_folder

MANIFEST_FILE, LOCK_FILE = ".hydro.json", ".hydro.lock"
_NO_LOCKS = (errno.ENOSYS, errno.ENOTSUP, errno.EOPNOTSUPP, errno.ENOLCK)
"""Errors of network file systems that know no locks."""

_PACKAGE = Path(__file__).resolve().parents[1]


def pretrained_folder() -> Path:
    """The weights that ship with the project."""
    return _PACKAGE / "pretrained"


@contextmanager
def output_folder(
    folder: Path, job: str, writes: Sequence[str], *, resume: bool | None = None, overwrite: bool = False
) -> Iterator[Path]:
    """Claim a folder for the files of a command; the command never replaces a file that it did not write.

    The folder's manifest (``.hydro.json``) lists each file and the command that wrote it. A command replaces only its
    own files, and only on request. While the block runs, no other process can claim the folder; the lock ends with the
    process. A block that writes nothing leaves nothing behind.

    Args:
        folder: for the results; created if it does not exist.
        job: the command, as in ``hydro <job>``.
        writes: names of all files that the block may write, relative to the folder; ``*`` matches any characters.
        resume: whether to continue earlier results; ``None`` for a command that cannot.
        overwrite: whether to remove the earlier results of this command first.

    Yields:
        The folder.

    Raises:
        ConfigurationError: the folder cannot be written, is in use by another process, holds results and neither
            ``resume`` nor ``overwrite`` is set, or holds a file with one of these names that the command did not write.
    """
    if resume and overwrite:
        raise ConfigurationError("--resume and --overwrite exclude each other")
    made = [path for path in (folder, *folder.parents) if not path.exists()]
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except FileExistsError:
        raise ConfigurationError(f"{folder}: is a file; --output needs a folder") from None
    except OSError as error:
        raise ConfigurationError(f"{folder}: cannot be written: {error.strerror}") from None
    try:
        with _locked(folder):
            owners = _owners(folder)
            _refuse_foreign(folder, job, writes, owners)
            present = _present(folder, [name for name, owner in owners.items() if owner == job])
            if present and not (resume or overwrite):
                go_on = "" if resume is None else "--resume continues them, "
                raise ConfigurationError(
                    f"{folder}: holds results already ({present[0]}); {go_on}--overwrite replaces them, "
                    "--output chooses another folder"
                )
            # The manifest comes before any result: it identifies the files of a killed command, and reveals a read-only
            # folder immediately, not after hours of work.
            claimed = owners | dict.fromkeys(writes, job)
            _write_manifest(folder, claimed)
            try:
                if overwrite:
                    _remove(folder, present)
                yield folder
            except KeyboardInterrupt as stop:
                stop.add_note(_what_stays(folder, resume, _present(folder, writes)))
                raise
            finally:
                with suppress(ConfigurationError):  # a full disk: the manifest above names the same files
                    _write_manifest(folder, {name: _owner(name, claimed) for name in _present(folder, claimed)})
    finally:
        for path in made:
            with suppress(OSError):  # not empty: it holds results
                path.rmdir()


def refuse_taken(folder: Path, job: str, writes: Sequence[str], overwrite: bool) -> None:
    """Refuse a folder before long work, as :func:`output_folder` does after it.

    Raises:
        ConfigurationError: as there.
    """
    if not overwrite:
        with output_folder(folder, job, writes):
            pass


def _what_stays(folder: Path, resume: bool | None, files: Sequence[str]) -> str:
    if not files:
        return "nothing had been written"
    if resume is None:
        return f"the results in {folder} are incomplete, --overwrite begins anew"
    return f"{folder} keeps the finished work, --resume continues it"


@contextmanager
def _locked(folder: Path) -> Iterator[None]:
    """Hold the lock of a folder: an empty file, which is removed at the end. A killed process leaves it, unlocked."""
    path, size = folder / LOCK_FILE, 0
    with suppress(OSError):
        size = path.stat().st_size
    if size:
        raise ConfigurationError(f"{path}: is not the lock of hydro; move it away, or choose another --output")
    lock = FileLock(path, blocking=False, fallback_to_soft=False)
    try:
        lock.acquire()
    except Timeout:
        raise ConfigurationError(
            f"{folder}: another hydro command is writing here; wait for it to end, or choose another --output"
        ) from None
    except OSError as error:
        if error.errno not in _NO_LOCKS:
            raise ConfigurationError(f"{folder}: cannot be written: {error.strerror}") from None
    try:
        yield
    finally:
        with suppress(OSError):  # Windows removes no open file
            path.unlink()
        lock.release()
        if sys.platform == "win32":
            with suppress(OSError):  # the next process has it already
                path.unlink()


def _owners(folder: Path) -> dict[str, str]:
    """Command by file name (or pattern), from the manifest; empty without one."""
    path = folder / MANIFEST_FILE
    if not os.path.lexists(path):
        return {}
    try:
        files = read_json(path)["files"]
        if not all(isinstance(name, str) and isinstance(job, str) for name, job in files.items()):
            raise TypeError
    except (ConfigurationError, AttributeError, KeyError, TypeError):
        raise ConfigurationError(
            f"{path}: is not the list of results that hydro keeps; move it away, or choose another --output"
        ) from None
    return {name: job for name, job in files.items() if not Path(name).is_absolute() and ".." not in Path(name).parts}


def _owner(name: str, owners: Mapping[str, str]) -> str:
    return next((job for pattern, job in owners.items() if fnmatchcase(name, pattern)), "")


def _write_manifest(folder: Path, owners: Mapping[str, str]) -> None:
    path = folder / MANIFEST_FILE
    if owners:
        text = json.dumps({"hydro_env": __version__, "files": dict(sorted(owners.items()))}, indent=1)
        write_whole(path, text.encode())
    else:
        path.unlink(missing_ok=True)


def _present(folder: Path, names: Sequence[str] | Mapping[str, str]) -> list[str]:
    """Names of the files that exist; a dangling link counts."""
    existing: dict[str, None] = {}
    for name in names:
        if "*" in name:
            existing |= dict.fromkeys(sorted(path.relative_to(folder).as_posix() for path in folder.glob(name)))
        elif os.path.lexists(folder / name):
            existing[name] = None
    return list(existing)


def _refuse_foreign(folder: Path, job: str, writes: Sequence[str], owners: Mapping[str, str]) -> None:
    for name in _present(folder, writes):
        owner = _owner(name, owners)
        if owner != job:
            whose = f"was written by hydro {owner}" if owner else "was not written by hydro"
            raise ConfigurationError(
                f"{folder / name}: {whose}, and hydro {job} would replace it; move it away, or choose another --output"
            )


def _remove(folder: Path, names: Sequence[str]) -> None:
    for name in names:
        try:
            (folder / name).unlink()
        except OSError as error:
            raise ConfigurationError(f"{folder / name}: cannot be removed: {error.strerror}") from None
