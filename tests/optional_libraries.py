"""Libraries of the extra for recordings; a test that needs one is skipped where it is not installed."""

import pytest

NEEDS = "the extra 'recordings' is not installed: pip install 'hydro_env[recordings]'"


def library(name):
    return pytest.importorskip(name, reason=NEEDS)
