"""The Makefile asks PyTorch's own index for the CPU build of torch, and takes the plain index if that fails."""

import os
import shutil
import subprocess
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
STAND_IN = """#!/bin/sh
# Stands in for python: makes a "virtual environment" of itself, notes every call of pip.
if [ "$2" = venv ]; then mkdir -p "$3/bin" && cp "$0" "$3/bin/python"; exit; fi
echo "$@" >> "$CALLS"
case "$*" in *"$FAILING"*) echo "no such index" >&2; exit 1;; esac
"""

pytestmark = pytest.mark.skipif(shutil.which("make") is None, reason="make is not installed")


def installed(tmp_path, failing):
    """What make prints, and the calls of pip, where calls that contain ``failing`` fail."""
    python, calls = tmp_path / "python", tmp_path / "calls"
    python.write_text(STAND_IN)
    python.chmod(0o755)
    venv = tmp_path / "venv"
    environment = {**os.environ, "CALLS": str(calls), "FAILING": failing}
    environment.pop("MAKEFLAGS", None)
    target = ["make", f"PYTHON={python}", f"VENV={venv}", "TORCH_INDEX=https://index.example/cpu", f"{venv}/.torch"]
    done = subprocess.run(target, cwd=ROOT, env=environment, capture_output=True, text=True, check=False)
    return done, calls.read_text().splitlines()


@pytest.mark.parametrize(
    ("failing", "calls_of_pip"),
    [("nothing fails", 1), ("--index-url", 2), ("torch==", 2)],
    ids=["none", "index", "all"],
)
def test_the_cpu_build_comes_from_its_own_index_or_else_from_the_plain_one(tmp_path, failing, calls_of_pip):
    done, calls = installed(tmp_path, failing)
    works = failing != "torch=="
    assert (done.returncode == 0) == works, done.stderr
    assert (tmp_path / "venv" / ".torch").exists() == works
    assert len(calls) == calls_of_pip
    assert "--no-deps" in calls[0]
    assert "--index-url https://index.example/cpu torch==" in calls[0]
    if calls_of_pip == 2:
        assert "--index-url" not in calls[1]
        assert "torch==" in calls[1]
        assert "not available from https://index.example/cpu" in done.stdout
        assert (tmp_path / "venv" / "torch.log").read_text() == "no such index\n"
