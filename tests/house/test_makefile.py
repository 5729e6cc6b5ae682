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


def test_the_cpu_build_comes_from_its_own_index(tmp_path):
    done, calls = installed(tmp_path, failing="nothing fails")
    assert done.returncode == 0, done.stderr
    assert len(calls) == 1
    assert "--no-deps" in calls[0]
    assert "--index-url https://index.example/cpu torch==" in calls[0]
    assert "installed the CPU build" in done.stdout


def test_the_plain_index_is_the_second_choice(tmp_path):
    done, calls = installed(tmp_path, failing="--index-url")
    assert done.returncode == 0, done.stderr
    assert len(calls) == 2
    assert "--index-url" not in calls[1]
    assert "torch==" in calls[1]
    assert "not available from https://index.example/cpu" in done.stdout
    assert (tmp_path / "venv" / "torch.log").read_text() == "no such index\n"


def test_a_failed_installation_is_not_taken_for_done(tmp_path):
    done, calls = installed(tmp_path, failing="torch==")
    assert done.returncode != 0
    assert len(calls) == 2
    assert not (tmp_path / "venv" / ".torch").exists()
