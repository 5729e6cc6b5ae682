"""Exported controllers in each language of an export, called as a PLC does: ``voltage = run(signals, start)``.

A signal that is not a number is not valid, unless ``valid`` says so.
"""

import ctypes
from collections import ChainMap

import numpy as np
import pytest

from hydro_env import equilibrium
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
        self._place = (loaded, f"{name}_gains")
        self._memory = ctypes.create_string_buffer(100_000)

    def __call__(self, signals, start, valid=None, lost_limit=0):
        row = np.ascontiguousarray(signals, dtype=np.float64)
        valid = np.ascontiguousarray(np.isfinite(row) if valid is None else valid, dtype=np.intc)
        pointers = (array.ctypes.data_as(ctypes.c_void_p) for array in (row, valid))
        return self._step(self._memory, *pointers, int(start), ctypes.c_long(lost_limit))

    def gains_of(self, names):
        """The gains of the library by name, which may be changed."""
        fields = {"_fields_": [(name, ctypes.c_double) for name in names]}
        items = {"__getitem__": lambda *key: getattr(*key), "__setitem__": lambda *item: setattr(*item)}
        return type("Gains", (ctypes.Structure,), fields | items).in_dll(*self._place)


class InOnnx:
    """A controller as an ONNX model; ``lost`` is the number of lost signals of the last call."""

    def __init__(self, file):
        self._session = onnx_session(file.read_bytes())
        self._state = np.zeros(self._session.get_inputs()[1].shape)
        self.lost, self.holding = 0, False

    def __call__(self, signals, start, valid=None, lost_limit=0):
        valid = np.isfinite(signals) if valid is None else valid
        inputs = {"signals": signals, "state": self._state, "valid": valid, "start": np.array([start])}
        voltage, self._state, lost, holding = self._session.run(None, {**inputs, "lost_limit": np.array([lost_limit])})
        self.lost, self.holding = int(lost[0]), bool(holding[0])
        return float(voltage[0])


class InPython:
    """The controller with measured signals that was exported."""

    def __init__(self, measured):
        self._measured, self._memory = measured, None

    @property
    def holding(self):
        return bool(self._memory.holding)

    def __call__(self, signals, start, valid=None, lost_limit=0):
        valid = np.isfinite(signals) if valid is None else valid
        voltage, self._memory = self._measured(signals, self._memory, start, valid, lost_limit)
        return voltage


def at_rest(graph, position, reference=None):
    """Signals of an axis at rest at a position (m), with one reference (m) now and ahead; default: the position."""
    config = graph.signals.config
    state, _ = equilibrium(config.plant, position)
    values = {**state, "reference": position if reference is None else reference, "previous_voltage": 0.0}
    names = [signal.name for signal in graph.signals.signals]
    return np.array([values["reference" if name.startswith("reference") else name] for name in names])


def assert_it_holds_until_start(run, graph, allowed):
    """After more lost positions than are ``allowed`` on an axis at rest it holds, until a start with a position."""
    good, apart = at_rest(graph, 0.01), at_rest(graph, 0.01, 0.02)
    valid = np.arange(len(good)) != graph.signals.places["position"]

    def holds(*arguments):
        run(*arguments)
        return bool(run.holding)

    assert [holds(good, False) for _ in range(3)] == [False] * 3
    assert [holds(good, False, valid) for _ in range(allowed + 1)] == [False] * allowed + [True]
    held = run(apart, False)  # the wire is whole again: without start nothing moves
    assert run(apart, False) == held
    assert holds(apart, True, valid)  # a start without a position is none
    assert not holds(apart, True)
    assert abs(run(apart, False) - held) > 0.2
    assert [holds(apart, False, valid, 5) for _ in range(6)] == [False] * 5 + [True]  # the limit is an input


def sources_in(folder):
    """C sources of a controller in a folder, without its test program."""
    return {name: (folder / name).read_text(encoding="utf-8") for name in ("controller.c", "controller.h")}
