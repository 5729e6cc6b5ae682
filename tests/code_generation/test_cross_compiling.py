"""An exported controller in C is compiled for other processors, where the extra 'playground' brings a compiler."""

import os
import subprocess
from pathlib import Path

import pytest

from hydro_agents.export.controller import controller_code, controller_graph
from hydro_agents.export.variable_gains import variable_gains
from hydro_agents.learning.opponents import opponent
from hydro_env import TaskConfig

ziglang = pytest.importorskip("ziglang", reason="the extra 'playground' brings it")
TASK = TaskConfig(episode_duration=0.5)
LARGEST_OBJECT = 65_536  # bytes, with its symbols
LARGEST_FRAME = 8192  # bytes of stack in one call
# A bare target has no C library; the project of a controller brings the header.
MATH = """#define INFINITY __builtin_inf()
#define NAN __builtin_nan("")
double fabs(double); double sqrt(double); double exp(double); double log(double); double pow(double, double);
double tanh(double); double asinh(double); double copysign(double, double);
float fabsf(float); float sqrtf(float); float expf(float); float tanhf(float);
"""


@pytest.mark.parametrize("target", [("thumb-freestanding-eabihf", "-mcpu=cortex_m4"), ("aarch64-linux-musl",)])
def test_the_code_of_a_controller_is_small_and_needs_no_heap(target, tmp_path):
    """Compiled, not run: a Cortex-M4 with bounds of size and stack, and a 64-bit ARM."""
    controller = opponent("pid", TASK, "pid")
    code = controller_code(controller_graph(controller, TASK, variable_gains(controller, TASK)))
    for name, text in (code.files | {"include/math.h": MATH}).items():
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_text(text)
    own = ["-I", "include"] if "freestanding" in target[0] else []
    options = ["-std=c99", "-Os", "-ffp-contract=off", f"-Wframe-larger-than={LARGEST_FRAME}", "-Werror", *own]
    command = [str(Path(ziglang.__file__).parent / "zig"), "cc", "-target", *target, *options]
    places = {f"ZIG_{kind}_CACHE_DIR": str(tmp_path / "cache") for kind in ("GLOBAL", "LOCAL")}
    done = subprocess.run(
        [*command, "-c", "controller.c", "-o", "controller.o"],
        cwd=tmp_path,
        env=os.environ | places,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    made = (tmp_path / "controller.o").read_bytes()
    assert made[:4] == b"\x7fELF"
    assert len(made) < LARGEST_OBJECT
    assert not [name for name in (b"malloc", b"calloc", b"realloc", b"free\0", b"printf") if name in made]
