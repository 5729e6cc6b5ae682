"""One FMU with the binaries of Linux, Windows (run by wine) and macOS (read, not run)."""

import os
import re
import shutil
import struct
import subprocess
import zipfile

import numpy as np
import pytest

from hydro_env import ConfigurationError, TaskConfig, equilibrium, simulate
from hydro_rig.export import c_files
from hydro_rig.export.c_files import compiled, cross_compiler
from hydro_rig.export.plant import TARGETS, make_fmu

PERIOD, SAMPLES, PLACE = 5e-3, 80, 0.02
VOLTAGE = np.where(np.arange(SAMPLES) < 20, 1.0, -2.0)
BINARIES = {
    "linux": "binaries/linux64/hydro_axis.so",
    "win32": "binaries/win64/hydro_axis.dll",
    "darwin": "binaries/darwin64/hydro_axis.dylib",
}
# A program of the target's own: it loads the binary that its command line names and prints position and pressure.
TOOL = """
#include <stdio.h>
#include <stdlib.h>
#ifdef _WIN32
#include <windows.h>
#define OPEN(file) LoadLibraryA(file)
#define NAMED(library, name) GetProcAddress(library, name)
#else
#include <dlfcn.h>
#define OPEN(file) dlopen(file, RTLD_NOW)
#define NAMED(library, name) dlsym(library, name)
#endif
VALUES
typedef unsigned int Reference;
static void logger(void *e, const char *n, int s, const char *c, const char *m, ...) { (void)e; (void)s; puts(m); }
typedef struct { void *logger, *allocate, *release, *finished, *environment; } Callbacks;
int main(int count, char **words)
{
    void *library = count > 1 ? (void *)OPEN(words[1]) : NULL;
    if (!library)
        return 3;
    void *(*make)(const char *, int, const char *, const char *, const Callbacks *, int, int) =
        (void *(*)(const char *, int, const char *, const char *, const Callbacks *, int, int))
            NAMED(library, "fmi2Instantiate");
    int (*begin)(void *) = (int (*)(void *))NAMED(library, "fmi2EnterInitializationMode");
    int (*begun)(void *) = (int (*)(void *))NAMED(library, "fmi2ExitInitializationMode");
    int (*set)(void *, const Reference *, size_t, const double *) =
        (int (*)(void *, const Reference *, size_t, const double *))NAMED(library, "fmi2SetReal");
    int (*get)(void *, const Reference *, size_t, double *) =
        (int (*)(void *, const Reference *, size_t, double *))NAMED(library, "fmi2GetReal");
    int (*advance)(void *, double, double, int) = (int (*)(void *, double, double, int))NAMED(library, "fmi2DoStep");
    Callbacks callbacks = {(void *)logger, (void *)calloc, (void *)free, NULL, NULL};
    void *axis = make("axis", 1, IDENTITY, "", &callbacks, 0, 0);
    const Reference place = INITIAL_POSITION, voltage = VOLTAGE, seen[2] = {POSITION, PRESSURE_A};
    const double start = START;
    double values[2];
    if (!axis || begin(axis) || set(axis, &place, 1, &start) || begun(axis))
        return 4;
    for (int sample = 0; sample < SAMPLES; ++sample) {
        const double command = sample < 20 ? 1.0 : -2.0;
        if (set(axis, &voltage, 1, &command) || advance(axis, sample * PERIOD, PERIOD, 1) || get(axis, seen, 2, values))
            return 5;
        printf("%.17g %.17g\\n", values[0], values[1]);
    }
    return 0;
}
"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """The FMU, unpacked."""
    pytest.importorskip("ziglang", reason="the extra 'playground' brings it")
    folder = tmp_path_factory.mktemp("fmu")
    (folder / "axis.fmu").write_bytes(make_fmu(TaskConfig(), all_systems=True))
    with zipfile.ZipFile(folder / "axis.fmu") as packed:
        assert {name for name in packed.namelist() if name.startswith("binaries/")} == set(BINARIES.values())
        packed.extractall(folder)
    return folder


def tool(folder, system):
    """The program above, compiled for a system."""
    description = (folder / "modelDescription.xml").read_text()
    values = {"IDENTITY": re.search(r'guid=("[^"]+")', description)[1]}
    for name in ("initial_position", "voltage", "position", "pressure_a"):
        values[name.upper()] = re.search(rf'name="{name}" valueReference="(\d+)"', description)[1]
    values |= {"START": f"{PLACE}", "PERIOD": f"{PERIOD}", "SAMPLES": f"{SAMPLES}"}
    source = TOOL.replace("VALUES", "\n".join(f"#define {name} {value}" for name, value in values.items()))
    file = folder / f"tool_{system}.exe"
    file.write_bytes(compiled({"tool.c": source}, [], cross_compiler(TARGETS[system], "the test is")))
    file.chmod(0o755)
    return file


@pytest.mark.slow  # zig first compiles the C library of each system
@pytest.mark.parametrize("system", ["linux", "win32"])
def test_its_motion_is_the_kernel_s_on_each_system(system, folder, tmp_path):
    before = []
    if system == "win32":
        wine = shutil.which("wine")
        if wine is None:
            pytest.skip("wine is not installed")
        before = [wine]
    place = os.environ | {"WINEPREFIX": str(tmp_path), "WINEDEBUG": "-all", "WINEDLLOVERRIDES": "mscoree,mshtml="}
    command = [*before, str(tool(folder, system)), BINARIES[system]]
    done = subprocess.run(command, cwd=folder, env=place, capture_output=True, text=True, check=False, timeout=120)
    assert done.returncode == 0, done.stdout + done.stderr
    position, pressure = np.array([row.split() for row in done.stdout.splitlines()], dtype=float).T

    plant = TaskConfig().plant
    expected = simulate(plant, VOLTAGE, PERIOD, equilibrium(plant, PLACE)[0])
    assert np.ptp(expected.position) > 5e-3
    largest = [
        np.abs(ours - theirs).max() / np.ptp(theirs)
        for ours, theirs in ((position, expected.position[1:]), (pressure, expected.pressure_a[1:]))
    ]
    print(f"{system}: largest difference {max(largest):.1e} of the range")
    assert max(largest) <= 1e-9


@pytest.mark.slow
def test_the_binary_of_macos_is_a_library_of_64_bit_x86_with_the_interface(folder):
    binary = (folder / BINARIES["darwin"]).read_bytes()
    magic, processor, _, kind = struct.unpack_from("<4I", binary)
    assert (magic, processor, kind) == (0xFEEDFACF, 0x01000007, 6)  # 64 bits, x86-64, dynamic library
    assert all(name in binary for name in (b"_fmi2Instantiate\0", b"_fmi2DoStep\0", b"_fmi2GetReal\0"))


def test_without_the_compiler_one_line_says_what_to_install(monkeypatch):
    monkeypatch.setattr(c_files.importlib.util, "find_spec", lambda name: None)
    with pytest.raises(ConfigurationError, match=r"binaries of all systems are compiled by the package ziglang: pip"):
        make_fmu(TaskConfig(), all_systems=True)
