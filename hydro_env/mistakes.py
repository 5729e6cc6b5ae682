"""Mistakes of the user in words: unknown names with the one that was probably meant, and several mistakes as one."""

import difflib
import textwrap
from collections.abc import Collection, Iterable, Iterator, Sequence
from contextlib import contextmanager

from pydantic import AfterValidator

from hydro_env.errors import ConfigurationError, UnknownKeyError


def did_you_mean(given: object, known: Iterable[str]) -> str:
    """``; did you mean load?`` if a known name resembles the given one, or alone begins with it; else nothing."""
    names = {_plain(name): name for name in known}
    word = _plain(str(given)[:60])
    longer = sorted((name for name in names if len(word) > 2 and name.startswith(word)), key=len)
    if longer and all(name.startswith(longer[0]) for name in longer):
        return f"; did you mean {names[longer[0]]}?"
    # Of names as short as units, only another spelling is meant: mn may be mm or m.
    similar = difflib.get_close_matches(word, names, 1, 0.6 if len(word) > 2 else 1.0)
    return f"; did you mean {names[similar[0]]}?" if similar else ""


def _plain(name: str) -> str:
    return name.casefold().replace("-", "_").replace(" ", "_")


def unknown(given: object, known: Collection[str], what: str = "") -> str:
    """``unknown; did you mean pid? known: pid, ppo``, or ``unknown fault 'x'; known: …`` if ``what`` is ``fault``."""
    name = f" {what} '{str(given)[:60]}'" if what else ""
    return f"unknown{name}{did_you_mean(given, known) or ';'} known: {', '.join(known)}"


def refuse_unknown(place: str, names: Iterable[object], known: Collection[str], what: str) -> None:
    """Check that names are known.

    Raises:
        UnknownKeyError: one is not; the message begins with the place.
    """
    for name in names:
        if name not in known:
            raise UnknownKeyError(f"{place}: {unknown(name, known, what)}")


def one_of(given: object, known: Collection[str]) -> str:
    """``must be one of drive, spool, ideal; did you mean spool?``: the same for one of few choices."""
    return f"must be one of {', '.join(known)}{did_you_mean(given, known)}"


def known_name(known: Collection[str], what: str) -> AfterValidator:
    """For the type of a field: ``Annotated[str, known_name(FAMILIES, "family")]`` allows these names alone."""

    def checked(name: str) -> str:
        if name not in known:
            raise ValueError(unknown(name, known, what))
        return name

    return AfterValidator(checked)


Kept = list[ConfigurationError]  # of the parts of a file


@contextmanager
def kept(errors: Kept) -> Iterator[None]:
    """Keep the error of one part of a file, so that the other parts are read as well; :func:`refuse` raises them."""
    try:
        yield
    except ConfigurationError as error:
        errors.append(error)


def refuse(errors: Sequence[ConfigurationError], source: object) -> None:
    """Raise the errors that were kept, as one; do nothing if there are none.

    Raises:
        UnknownKeyError: one of them is an unknown key.
        ConfigurationError: any other.
    """
    if len(errors) == 1:
        raise errors[0]
    if errors:
        kind = UnknownKeyError if any(isinstance(error, UnknownKeyError) for error in errors) else ConfigurationError
        text = textwrap.indent("\n".join(map(str, errors)), "  ")
        raise kind(f"{source}: mistakes in {len(errors)} places\n{text}")
