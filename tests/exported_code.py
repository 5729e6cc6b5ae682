"""Exported controllers in each language of an export, called as a PLC does: ``voltage = run(signals, start)``."""

import ctypes
from collections import ChainMap

import numpy as np
import pytest

from hydro_rig.export.c_files import WARNINGS, c_compiler, compiled
from hydro_rig.export.onnx_writer import onnx_session


def library(place, *sources):
    """C sources (texts by file name), compiled with all warnings as errors and loaded."""
    if c_compiler() is None:
        pytest.skip("this machine has no C compiler")
    compiled(dict(ChainMap(*sources)), [*WARNINGS, "-shared", "-fPIC"], folder=place)
    return ctypes.CDLL(str(place / "out"))


class InC:
    """A controller of a library, with a memory of its own."""

    def __init__(self, loaded, name="controller"):
        self._step = getattr(loaded, f"{name}_step")
        self._step.restype = ctypes.c_double
        self._memory = ctypes.create_string_buffer(100_000)

    def __call__(self, signals, start):
        row = np.ascontiguousarray(signals, dtype=np.float64)
        return self._step(self._memory, row.ctypes.data_as(ctypes.c_void_p), int(start))


class InOnnx:
    """A controller as an ONNX model; ``lost`` is the number of lost signals of the last call."""

    def __init__(self, file):
        self._session = onnx_session(file.read_bytes())
        self._state = np.zeros(self._session.get_inputs()[1].shape)
        self.lost = 0

    def __call__(self, signals, start):
        inputs = {"signals": signals, "state": self._state, "start": np.array([start])}
        voltage, self._state, lost = self._session.run(None, inputs)
        self.lost = int(lost[0])
        return float(voltage[0])


class InPython:
    """The controller with measured signals that was exported."""

    def __init__(self, measured):
        self._measured, self._memory = measured, None

    def __call__(self, signals, start):
        voltage, self._memory = self._measured(signals, self._memory, start)
        return voltage


def sources_in(folder):
    """C sources of a controller in a folder, without its test program."""
    return {name: (folder / name).read_text(encoding="utf-8") for name in ("controller.c", "controller.h")}
