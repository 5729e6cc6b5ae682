"""How this project refuses bad input."""

from collections.abc import Iterator
from contextlib import contextmanager

import pytest

from hydro_env import ConfigurationError


@contextmanager
def refused(message: str) -> Iterator[pytest.ExceptionInfo[ConfigurationError]]:
    """What runs inside is refused with one line, in which this regular expression is found."""
    with pytest.raises(ConfigurationError, match=message) as caught:
        yield caught
    assert len(str(caught.value).splitlines()) == 1
