"""Folder of the configuration files that ship with the project, and files in it by name."""

from contextlib import suppress
from pathlib import Path

from hydro_env.errors import ConfigurationError
from hydro_env.mistakes import unknown

_PACKAGE = Path(__file__).resolve().parent


def config_folder() -> Path:
    """``configs/``: inside the package when installed, beside it in a checkout."""
    inside = _PACKAGE / "configs"
    return inside if inside.is_dir() else _PACKAGE.parent / "configs"


def page(name: str) -> str:
    """A page of the documentation, such as ``diagnose.md``, as the user can open it; for messages."""
    inside = _PACKAGE / "docs" / name
    return str(inside) if inside.is_file() else f"docs/{name}"


def config_file(kind: str, given: str | Path, folder: Path | None = None) -> Path:
    """The file of a rig, a task, a study and so on.

    Args:
        kind: a folder of ``configs``, such as ``"rigs"`` or ``"tasks"``.
        given: the name of a file in ``configs/<kind>`` without ``.yaml``, or a path.
        folder: what a relative path is relative to; default: the current folder.

    Raises:
        ConfigurationError: no file has this name.
    """
    path = (folder or Path()) / given
    if Path(given).suffix or len(Path(given).parts) != 1:
        return path
    named = config_folder() / kind / f"{given}.yaml"
    with suppress(OSError):  # the name may be longer than a file's
        if named.is_file() or path.is_file():
            return named if named.is_file() else path
    known = sorted(file.stem for file in (config_folder() / kind).glob("*.yaml"))
    what = {"studies": "study"}.get(kind, kind.removesuffix("s"))
    raise ConfigurationError(f"{what} '{str(given)[:60]}': {unknown(given, known)}; or give the path of a YAML file")
