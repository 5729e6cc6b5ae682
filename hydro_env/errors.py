"""The errors that this package raises; each message is one line with place, value and what is allowed."""

from collections.abc import Iterator
from contextlib import contextmanager


class HydroError(ValueError):
    """Base of all errors of this project; the command line prints its message and exits with code 2."""


class ConfigurationError(HydroError):
    """A configuration file or keyword is wrong."""


class UnknownKeyError(ConfigurationError, TypeError):
    """A key or keyword does not exist; also a ``TypeError``, as Python raises for an unknown keyword argument."""


class NotBegunError(ConfigurationError, AttributeError):
    """An attribute that exists only after ``reset``; also an ``AttributeError``, for ``hasattr``."""


class InvalidStateError(HydroError, ArithmeticError):
    """A simulated state left the range in which the model is valid."""


@contextmanager
def at(place: object) -> Iterator[None]:
    """An error of the block begins with the place of its cause; one of a file that cannot be used tells why."""
    try:
        yield
    except OSError as error:
        raise ConfigurationError(f"{place}: {error.strerror}") from None
    except ConfigurationError as error:
        raise type(error)(f"{place}: {error}") from error


def reason(error: BaseException) -> str:
    """Kind and message of an error that foreign code has raised, in one line."""
    return " ".join(f"{type(error).__name__}: {error}".split())
