"""An exported controller in C on a Cortex-M4: its size and stack."""

import os
import re
import shutil
import struct
import subprocess
from pathlib import Path

import pytest

ziglang = pytest.importorskip("ziglang", reason="the extra 'playground' brings it")
CORTEX_M4 = ("thumb-freestanding-eabihf", "-mcpu=cortex_m4")
LARGEST = {"pid": (10_240, 1_024), "flow_linearising": (20_480, 5_120)}  # bytes of code and constants; of stack
# A bare target has no C library; the project of a controller brings the header.
MATH = """#define INFINITY __builtin_inf()
#define NAN __builtin_nan("")
double fabs(double); double sqrt(double); double exp(double); double log(double); double pow(double, double);
double tanh(double); double asinh(double); double copysign(double, double);
#define isless(a, b) __builtin_isless(a, b)
#define islessequal(a, b) __builtin_islessequal(a, b)
#define isgreater(a, b) __builtin_isgreater(a, b)
#define isgreaterequal(a, b) __builtin_isgreaterequal(a, b)
float fabsf(float); float sqrtf(float); float expf(float); float tanhf(float);
"""
MATH_NAMES = set(re.findall(r"(\w+)\(", MATH)) - {"__builtin_inf", "__builtin_nan"}


def zig(folder, *words):
    """Run ``zig cc`` in a folder; what it prints."""
    places = {f"ZIG_{kind}_CACHE_DIR": str(folder / "cache") for kind in ("GLOBAL", "LOCAL")}
    command = [str(Path(ziglang.__file__).parent / "zig"), "cc", "-std=c99", "-ffp-contract=off", *words]
    done = subprocess.run(command, cwd=folder, env=os.environ | places, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return done.stderr


def sections_and_unknown(made):
    """Bytes of each section of a 32-bit object that a processor loads, and the names that it needs from elsewhere."""
    start, count, names = (struct.unpack_from(kind, made, at)[0] for kind, at in (("<I", 32), ("<H", 48), ("<H", 50)))
    heads = [struct.unpack_from("<10I", made, start + 40 * one) for one in range(count)]

    def text(table, at):
        first = heads[table][4] + at
        return made[first : made.index(b"\0", first)].decode()

    loaded = {text(names, head[0]): head[5] for head in heads if head[2] & 2}
    (table,) = (head for head in heads if head[1] == 2)
    symbols = [struct.unpack_from("<IIIBBH", made, at) for at in range(table[4], table[4] + table[5], 16)]
    return loaded, {text(table[6], name) for name, _, _, _, _, section in symbols if name and section == 0}


@pytest.mark.parametrize("kind", LARGEST)
def test_a_cortex_m4_needs_little_memory_and_no_heap(kind, exported, tmp_path):
    """Compiled, not run. The figures are those of docs/export.md; pytest -rP prints them."""
    folder = shutil.copytree(exported(kind).folder, tmp_path / kind)
    (folder / "include").mkdir()
    (folder / "include" / "math.h").write_text(MATH)
    told = zig(
        *(folder, "-target", *CORTEX_M4, "-Os", "-Wframe-larger-than=1", "-I", "include"),
        *("-c", "controller.c", "-o", "controller.o"),
    )
    sections, unknown = sections_and_unknown((folder / "controller.o").read_bytes())
    flash = sum(size for name, size in sections.items() if name.startswith((".text", ".rodata", ".ARM", ".data")))
    frames = {name: int(size) for size, name in re.findall(r"stack frame size \((\d+)\).* in '(\w+)'", told)}
    assert "controller_step" in frames, told
    stack = sum(frames.values())
    print(f"{kind}: {flash} bytes of code and constants, at most {stack} bytes of stack without the calls to math.h")
    most_flash, most_stack = LARGEST[kind]
    assert 1_000 < flash <= most_flash
    assert 32 < stack <= most_stack
    helpers = {name for name in unknown if name.startswith("__aeabi_")} | {"memcpy", "memset"}
    assert unknown <= MATH_NAMES | helpers, "a name of no mathematical function: heap or input and output"
    assert not [name for name in sections if name.startswith(".bss") and sections[name]]
