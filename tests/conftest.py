"""What holds for every test."""

import os
import signal

import pytest
from browser import start_browser

# Threads of torch wait actively for each other: two are many times slower than one where other processes hold a core.
os.environ.setdefault("OMP_NUM_THREADS", "1")
# Without --jobs a command takes one core: tests run one per core already, and what they replace holds in this process.
os.environ.setdefault("LOKY_MAX_CPU_COUNT", "1")


def pytest_configure():
    """Let Ctrl-C act even where it is ignored (``nohup make test &``): tests send it to processes that they start."""
    if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
        signal.signal(signal.SIGINT, signal.default_int_handler)


FEW_BUT_LONG = ("test_recipes.py", "test_runs_anywhere.py", "test_pages.py", "test_examples.py", "test_pretrained.py")


def pytest_collection_modifyitems(items):
    """Files with few long tests come first: of several processes none is left with such a file at the end."""
    items.sort(key=lambda item: item.path.name not in FEW_BUT_LONG)


@pytest.fixture(scope="module")  # Playwright keeps an event loop: it ends with the file of tests
def browser():
    """A headless browser; see tests/browser.py."""
    with start_browser() as started:
        yield started
