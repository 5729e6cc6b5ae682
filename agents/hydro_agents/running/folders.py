"""Folders of shipped weights and of results; :mod:`hydro_env.folders` finds the configuration files."""

import json
import os
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path

from hydro_env import ConfigurationError, PlantParameters, TaskConfig
from hydro_env.errors import at
from hydro_env.files import read_json, write_whole

MANIFEST_FILE = ".hydro.json"


def pretrained_folder() -> Path:
    """The weights that ship with the project."""
    return Path(__file__).resolve().parents[1] / "pretrained"


def shipped_weights(name: str, config: TaskConfig) -> Path:
    """The shipped weights of a name: those for the paper's rig at its control period, else those for any axis.

    Raises:
        ConfigurationError: the task draws its rigs.
    """
    if config.law:
        raise ConfigurationError("law: a controller is made for one rig; rig_tasks(config) lists those of the law")
    if config.plant != PlantParameters() or config.control_period != TaskConfig().control_period:
        name = f"{name}_any_axis"
    return pretrained_folder() / name


@contextmanager
def output_folder(
    folder: Path, job: str, writes: Sequence[str], *, resume: bool | None = None, overwrite: bool = False
) -> Iterator[Path]:
    """Claim a folder for the files of a command; the command never replaces a file that it did not write.

    The folder's manifest (``.hydro.json``) lists the files of each command. A block that writes nothing leaves nothing
    behind. Two commands should not write into one folder at a time.

    Args:
        folder: for the results; created if it does not exist.
        job: the command, as in ``hydro <job>``.
        writes: names of all files that the block may write, relative to the folder; ``*`` matches any characters.
        resume: whether to continue earlier results; ``None`` for a command that cannot.
        overwrite: whether to remove the earlier results of this command first.

    Raises:
        ConfigurationError: the folder cannot be written, holds results and neither ``resume`` nor ``overwrite`` is
            set, or holds a file with one of these names that the command did not write.
    """
    if resume and overwrite:
        raise ConfigurationError("--resume and --overwrite exclude each other")
    made = [path for path in (folder, *folder.parents) if not path.exists()]
    with at(f"{folder}: cannot be written"):
        folder.mkdir(parents=True, exist_ok=True)
    try:
        with _listed(folder, job, writes, resume, overwrite):
            yield folder
    except KeyboardInterrupt as stop:
        if _present(folder, writes):
            go_on = "--overwrite begins anew" if resume is None else "--resume continues"
            stop.add_note(f"{folder} keeps the finished work, {go_on}")
        raise
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


@contextmanager
def _listed(folder: Path, job: str, writes: Sequence[str], resume: bool | None, overwrite: bool) -> Iterator[None]:
    """Keep the list of the files of each command: before the work the names that it may write, then those that exist.

    A killed command leaves the first one, which names its files too.
    """
    files, manifest = {}, folder / MANIFEST_FILE
    if os.path.lexists(manifest):
        try:
            files = dict(read_json(manifest)["files"])
        except (KeyError, TypeError, ValueError):
            raise ConfigurationError(f"{manifest}: is not hydro's list of results; move it away") from None
    earlier = _present(folder, files.pop(job, []))
    for name in _present(folder, writes):
        if name not in earlier:
            raise ConfigurationError(f"{folder / name}: was not written by hydro {job}; choose another --output")
    if earlier and not (resume or overwrite):
        go_on = "" if resume is None else "--resume continues them, "
        raise ConfigurationError(
            f"{folder}: holds results already ({earlier[0]}); {go_on}--overwrite replaces them, "
            "--output chooses another folder"
        )
    _write_list(folder, {**files, job: [*earlier, *writes]})
    try:
        if overwrite:
            for name in earlier:
                (folder / name).unlink()
        yield
    finally:
        with suppress(ConfigurationError):  # a full disk: the list above names the same files
            _write_list(folder, {**files, job: _present(folder, [*earlier, *writes])})


def _write_list(folder: Path, files: Mapping[str, Sequence[str]]) -> None:
    if any(files.values()):
        write_whole(folder / MANIFEST_FILE, json.dumps({"files": files}, indent=1).encode())
    else:
        (folder / MANIFEST_FILE).unlink(missing_ok=True)


def _present(folder: Path, names: Iterable[str]) -> list[str]:
    """Names of the files in the folder that exist, without repetition; a dangling link counts."""
    existing: dict[str, None] = {}
    for name in names:
        found = sorted(folder.glob(name)) if "*" in name else [folder / name]
        if ".." in Path(name).parts:
            continue
        for path in found:
            if os.path.lexists(path) and path.is_relative_to(folder):
                existing[path.relative_to(folder).as_posix()] = None
    return list(existing)
