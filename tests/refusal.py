"""How this project refuses bad input."""

import json
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

from hydro_env import ConfigurationError


@contextmanager
def refused(message: str) -> Iterator[pytest.ExceptionInfo[ConfigurationError]]:
    """What runs inside is refused with one line, in which this regular expression is found."""
    with pytest.raises(ConfigurationError, match=message) as caught:
        yield caught
    assert len(str(caught.value).splitlines()) == 1


def undigested(file: Path) -> dict[str, Any]:
    """Rewrite the JSON of weights as older versions wrote it, without the digest that notices every change at once."""
    settings = json.loads(file.read_text())
    settings.pop("digest")
    settings["format_version"] = 1
    file.write_text(json.dumps(settings))
    return settings
