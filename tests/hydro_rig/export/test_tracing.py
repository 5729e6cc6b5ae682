"""Traced NumPy functions against NumPy itself, in ONNX and in C; and what a trace refuses."""

import ctypes

import numpy as np
import onnxruntime
import pytest
from exported_code import library

from hydro_rig.export.c_writer import C, Writer
from hydro_rig.export.graph import needed
from hydro_rig.export.onnx_writer import OnnxWriter
from hydro_rig.export.tracing import TraceError, trace


def moves(a, b, s):
    """Slices, joins, transpositions and changes of parts of arrays."""
    changed = a.copy()
    changed[:, 1] = b[0]
    changed[0, 1:] += s
    part = changed[1].reshape(2, 2)
    changed[1, 3] = s
    part -= 2.0  # a view, also of what was changed after it was made
    filled = np.empty_like(a)
    filled[...] = a[::-1]
    filled[:, :2] = filled[:, 2:4] = a[:, [3, 0]]
    joined = np.concatenate([changed, filled, np.ones((1, 4))], axis=0)
    tiled = np.tile(np.stack([b, -b], axis=1), 2)
    return {"joined": joined, "tiled": tiled, "rolled": np.roll(a.T, 1, axis=0).reshape(2, -1), "diff": np.diff(joined)}


def products(a, b, s):
    """Products and sums."""
    square = a.T @ a
    quadratic = np.einsum("ij,jk->ki", a, square)
    return {
        "matrix": square,
        "vector": a @ a[0] + np.einsum("i,ij->j", b, a)[:3] * s,
        "outer": b[:, None] * a[0],
        "sums": np.concatenate([a.sum(axis=0), quadratic.sum(axis=1), np.sum(a * s)[None]]),
        "row": b @ a,
    }


def elements(a, b, s):
    """Functions that work element by element, and types."""
    single = a.astype(np.float32) * np.float32(0.1) + 0.5
    found = np.where((a > b[:, None]) & (a < 2.0) | ~(a >= s), np.copysign(np.sqrt(np.abs(a)), -a), np.clip(a, -0.5, s))
    return {
        "found": found,
        "single": np.arcsinh(single / 3.0),
        "limited": np.maximum(np.minimum(single, 0.25), -1.0).astype(np.float64) / (np.abs(a) + 1.0),
        "functions": np.sign(a) * np.exp(-np.abs(a)) + np.tanh(a),
        "truth": np.logical_or(a > 0.0, b[:, None] > 0.0) != (a == 0.0),
        "squares": a**2 + np.square(b)[:, None],
    }


EXAMPLE = {"a": np.arange(12.0).reshape(3, 4) - 5.5, "b": np.array([1.0, -2.0, 0.5]), "s": np.array(0.3)}


def draws():
    generator = np.random.default_rng(7)
    values = [{name: generator.normal(size=np.shape(one)) for name, one in EXAMPLE.items()} for _ in range(20)]
    values[0]["a"][0, :2] = (0.0, -0.0)
    return values


def in_onnx(graph, folder):
    """The graph as a function from flat arrays to arrays, computed by onnxruntime."""
    writer = OnnxWriter(graph.inputs, list(graph.outputs))
    session = onnxruntime.InferenceSession(writer.model(graph.outputs, "test", {}).SerializeToString())
    return lambda values: session.run(None, values)


def in_c(graph, folder):
    """The same, computed by C."""
    inputs = {name: name if node.size > 1 else f"{name}[0]" for name, node in graph.inputs.items()}
    writer = Writer(graph, inputs, taken=[*graph.inputs, *(f"to_{name}" for name in graph.outputs)])
    lines = writer.statements(graph.nodes())
    for name, node in graph.outputs.items():
        lines.append(f"for (int i = 0; i < {node.size}; ++i) to_{name}[i] = {writer.element(node, 'i')};")
    arguments = [f"const {C.types[node.kind]} *{name}" for name, node in graph.inputs.items()]
    arguments += [f"{C.types[node.kind]} *to_{name}" for name, node in graph.outputs.items()]
    head = f"void run({', '.join(arguments)})"
    text = "\n".join(["#include <math.h>", *writer.tables, f"{head};", head, "{", *lines, "}", ""])
    code = library(folder, {"f.c": text})
    kinds = {np.dtype(np.bool_): np.int32}

    def run(values):
        results = [np.zeros(node.size, kinds.get(node.kind, node.kind)) for node in graph.outputs.values()]
        arrays = [np.ascontiguousarray(values[name]) for name in graph.inputs] + results
        code.run(*(ctypes.c_void_p(array.ctypes.data) for array in arrays))
        return [array.astype(node.kind) for array, node in zip(results, graph.outputs.values(), strict=True)]

    return run


@pytest.mark.parametrize("language", [in_onnx, in_c])
@pytest.mark.parametrize("function", [moves, products, elements])
def test_the_written_code_computes_what_numpy_computes(function, language, tmp_path):
    graph = trace(function, EXAMPLE)
    run = language(graph, tmp_path)
    for values in draws():
        expected = function(**values)
        results = run({name: np.ravel(value) for name, value in values.items()})
        for name, array in zip(graph.outputs, results, strict=True):
            assert array.dtype == expected[name].dtype
            np.testing.assert_allclose(array, expected[name].ravel(), rtol=3e-7, atol=1e-12, err_msg=name)


def writes_into_a_plain_array(a):
    plain = np.zeros(3)
    plain[1:] = a[1:]
    return {"x": plain}


@pytest.mark.parametrize(
    "function",
    [
        lambda a: {"x": a if a[0] > 0.0 else -a},
        lambda a: {"x": a * len([value for value in a if value > 0])},
        lambda a: {"x": a * float(a[0])},
        lambda a: {"x": np.zeros(3) if not a.any() else a},
        lambda a: {"x": a[a > 0.0]},
        lambda a: {"x": np.sort(a)},
        lambda a: {"x": np.array([value**3 for value in a])},
        lambda a: {"x": np.add.accumulate(a)},
        writes_into_a_plain_array,
        lambda a: {"x": np.einsum("i,i", a, a)},
    ],
)
def test_what_no_fixed_graph_can_hold_is_refused_with_its_line(function):
    with pytest.raises(TraceError, match=r"^test_tracing\.py, line \d+: .*cannot be exported$"):
        trace(function, {"a": np.array([1.0, 2.0, 3.0])})


def test_only_inputs_that_an_output_needs_are_needed():
    def function(a, b):
        changed = np.stack([a, b, a])
        changed[2] = 7.0
        return {"x": changed[1:] * 2.0, "y": np.stack([b, a])[:1] @ np.ones(1)}

    graph = trace(function, {"a": np.array(0.0), "b": np.array(1.0)})
    for node in graph.outputs.values():
        assert [graph.inputs[name] in needed([node]) for name in "ab"] == [False, True]
