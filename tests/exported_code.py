"""Exported blocks in each language, called as a PLC does: ``outputs = run(inputs)``, both by name.

Inputs that are missing have their usual values.
"""

import ctypes
from collections import ChainMap

import pytest

from hydro_rig.export.c_files import WARNINGS, c_compiler, compiled

TYPES = {bool: ctypes.c_int, int: ctypes.c_long, float: ctypes.c_double}
WHOLE = ("state", "fault_code", "lost_signals")


def library(place, *sources):
    """C sources (texts by file name), compiled with all warnings as errors and loaded."""
    if c_compiler() is None:
        pytest.skip("this machine has no C compiler")
    compiled(dict(ChainMap(*sources)), [*WARNINGS, "-shared", "-fPIC"], folder=place)
    return ctypes.CDLL(str(place / "out"))


class InC:
    """A block of a library; ``reset`` false: zeros instead of a reset."""

    def __init__(self, loaded, graph, prefix="controller", reset=True):
        fields = [(row.name, TYPES[row.kind]) for row in graph.inputs]
        fields += [(name, ctypes.c_long if name in WHOLE else ctypes.c_double) for name in graph.outputs]
        size = getattr(loaded, f"{prefix}_size")
        size.restype = ctypes.c_size_t
        kind = type("Block", (ctypes.Structure,), {"_fields_": fields})
        self.buffer = ctypes.create_string_buffer(size())
        self.self = kind.from_buffer(self.buffer)
        self.step = getattr(loaded, f"{prefix}_step")
        self.step.restype = ctypes.c_double
        self._graph = graph
        if reset:
            getattr(loaded, f"{prefix}_reset")(self.buffer)

    def fill(self, inputs):
        for row in self._graph.inputs:
            setattr(self.self, row.name, row.kind(inputs.get(row.name, row.default)))

    def __call__(self, inputs):
        self.fill(inputs)
        assert self.step(self.buffer) == self.self.command
        return {name: getattr(self.self, name) for name in self._graph.outputs}


class InPython:
    """The block that was exported."""

    def __init__(self, graph):
        self._block, self.memory = graph.block, None

    def __call__(self, inputs):
        outputs, self.memory = self._block(inputs, self.memory)
        return outputs


def at_rest(graph, state, reference=None):
    """Inputs of an enabled block for an axis at rest in a state, with one reference (m) now and ahead."""
    reference, inputs = state["position"] if reference is None else reference, {"enable": True}
    for signal in graph.signals.signals:
        inputs[signal.name] = state[signal.name] if signal.sensor else reference
        if signal.sensor:
            inputs[f"valid_{signal.name}"] = True
    return inputs


def closed(run, inputs):
    """Close the loop of a new block."""
    run(inputs)
    return run({**inputs, "control": True})
