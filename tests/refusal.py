"""How this project refuses bad input."""

import json
from contextlib import contextmanager, suppress

import pytest

from hydro_agents.running.weights import digest_of_weights
from hydro_env import ConfigurationError


@contextmanager
def refused(message):
    """What runs inside is refused with one line, in which this regular expression is found."""
    with pytest.raises(ConfigurationError, match=message) as caught:
        yield caught
    assert len(str(caught.value).splitlines()) == 1


def redigested(path):
    """Make weights, of which a test has changed tensors or JSON, agree with their digest again."""
    file, content = path.with_suffix(".json"), path.with_suffix(".safetensors").read_bytes()
    with suppress(ValueError, AttributeError, TypeError, RecursionError):  # no JSON, or no mapping
        settings = json.loads(file.read_bytes())
        settings.pop("digest", None)
        file.write_text(json.dumps({**settings, "digest": digest_of_weights(content, settings)}))
