"""What holds for every test."""

import os
import signal
import tempfile

import pytest
from browser import start_browser

# Threads of torch wait actively for each other: two are many times slower than one where other processes hold a core.
os.environ.setdefault("OMP_NUM_THREADS", "1")
# Without --jobs a command takes one core: tests run one per core already, and what they replace holds in this process.
os.environ.setdefault("LOKY_MAX_CPU_COUNT", "1")
# No test finds what another run searched, nor leaves what it searched.
os.environ["HYDRO_CACHE_DIR"] = tempfile.mkdtemp(prefix="hydro-searches-")


def pytest_configure():
    """Let Ctrl-C act even where it is ignored (``nohup make test &``): tests send it to processes that they start."""
    if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
        signal.signal(signal.SIGINT, signal.default_int_handler)


LONG = (
    *("test_recipes.py", "test_house.py", "test_diagnose.py", "test_controller_folder.py", "test_any_axis.py"),
    *("test_cli.py", "test_playground.py", "test_run.py", "test_runs_anywhere.py", "test_pages.py", "test_tuning.py"),
    *("test_identify.py", "test_errors.py", "test_pipeline.py", "test_command.py", "test_other_rig.py"),
)
"""On a machine without machine code one process compiles it in the first files, while the other has no use for it."""


def pytest_collection_modifyitems(items):
    """Files with long tests come first: of several processes none is left with such a file at the end."""
    items.sort(key=lambda item: LONG.index(item.path.name) if item.path.name in LONG else len(LONG))


@pytest.fixture(scope="module")  # Playwright keeps an event loop: it ends with the file of tests
def browser():
    """A headless browser; see tests/browser.py."""
    with start_browser() as started:
        yield started
