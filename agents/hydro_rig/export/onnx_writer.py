"""Writes a graph of array operations as an ONNX model: plain operators, fixed shapes, one-dimensional tensors."""

import re
from collections import Counter
from collections.abc import Mapping, Sequence
from importlib import import_module
from typing import Any

import numpy as np

from hydro_env import ConfigurationError, HydroError, __version__
from hydro_env.types import Array
from hydro_rig.export.controller import ANSWER, CONTINUED, OUTPUT, STARTED, ControllerGraph, facts_of
from hydro_rig.export.graph import DOUBLE, Builder, Kind, Node, in_order

OPSET = 17
_OPERATORS = {
    "subtract": "Sub", "multiply": "Mul", "divide": "Div", "negative": "Neg", "absolute": "Abs", "power": "Pow",
    "arcsinh": "Asinh", "greater_equal": "GreaterOrEqual", "less_equal": "LessOrEqual",
}  # fmt: skip
"""Of operations whose operators have another name than theirs."""


def package(name: str) -> Any:
    """A package of the extra 'export'; ConfigurationError: it is not installed."""
    try:
        return import_module(name)
    except ImportError:
        raise ConfigurationError(f"the export needs the package {name}: pip install 'hydro_env[export]'") from None


def onnx_session(model: bytes) -> Any:
    """A session of onnxruntime on one thread, without warnings."""
    onnxruntime = package("onnxruntime")
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = options.inter_op_num_threads = 1
    options.log_severity_level = 4
    return onnxruntime.InferenceSession(model, options, providers=["CPUExecutionProvider"])


class OnnxWriter:
    """Collects the operators of one ONNX model, from its inputs by name and the names of its outputs."""

    def __init__(self, inputs: Mapping[str, Node], outputs: Sequence[str]) -> None:
        self._onnx = package("onnx")
        self._nodes: list[Any] = []
        self._constants: list[Any] = []
        self._places: dict[bytes, str] = {}
        self._names: dict[Node, str] = {}
        self._used: Counter[str] = Counter([*inputs, *outputs])
        self._inputs = [self._described(name, node) for name, node in inputs.items()]
        self.given = {name: name for name in inputs}
        """Tensor of each input of a graph: inputs of the model, and tensors that the caller computes from them."""

    def tensor(self, node: Node) -> str:
        """Name of the tensor of a result; writes all required operators, operands first."""
        for one in [*in_order([node]), node]:
            if one not in self._names:
                self._names[one] = self._written(one)
        return self._names[node]

    def add(self, operator: str, tensors: Sequence[str], name: str, origin: str = "", **attributes: Any) -> str:
        """Add one operator; returns the name of its result, which is also the operator's name."""
        plain = re.sub(r"\W", "_", name)
        self._used[plain] += 1
        unique = plain if self._used[plain] == 1 else f"{plain}.{self._used[plain]}"
        node = self._onnx.helper.make_node(operator, list(tensors), [unique], name=unique, **attributes)
        node.doc_string = origin
        self._nodes.append(node)
        return unique

    def model(self, outputs: Mapping[str, Node], title: str, facts: Mapping[str, str]) -> Any:
        """The model of outputs by name, checked; ``title``: one sentence; ``facts``: further properties.

        Raises:
            HydroError: the checker of the package onnx finds a mistake.
        """
        helper = self._onnx.helper
        tensors = {name: self.tensor(node) for name, node in outputs.items()}
        for name, tensor in tensors.items():
            self._nodes.append(helper.make_node("Identity", [tensor], [name], name=f"{name}.output"))
        described = [self._described(name, node) for name, node in outputs.items()]
        graph = helper.make_graph(self._nodes, "controller", self._inputs, described, self._constants, title)
        opset = helper.make_opsetid("", OPSET)
        origin = {"producer_name": "hydro_env", "producer_version": __version__}
        model = helper.make_model(graph, opset_imports=[opset], ir_version=8, **origin)
        helper.set_model_props(model, dict(facts))
        try:
            self._onnx.checker.check_model(model, full_check=True)
        except (self._onnx.checker.ValidationError, self._onnx.shape_inference.InferenceError) as error:
            raise HydroError(f"the ONNX model is wrong: {' '.join(str(error).split())}") from error
        return model

    # Operators ----------------------------------------------------------------------------------------------------

    def _written(self, node: Node) -> str:
        operation, add = node.operation, self.add
        name, origin = node.name or operation, node.origin
        if operation == "input":
            return self.given[node.name]
        if operation == "constant":
            assert node.table is not None
            return self._constant(node.table, name)
        tensors = [self._names.get(one) or self.tensor(one) for one in node.operands]  # new: inputs and constants
        if operation == "collect":
            assert node.table is not None
            joined = tensors[0] if len(tensors) == 1 else add("Concat", tensors, name, origin, axis=0)
            if np.array_equal(node.table, np.arange(sum(one.size for one in node.operands))):
                return joined
            return add("Gather", [joined, self._constant(node.table, f"{name}_places")], name, axis=0)
        if operation == "cast":
            return add("Cast", tensors, name, origin, to=self._type(node.kind))
        if operation == "where" and node.kind == np.bool_:  # onnxruntime has no Where of truth values
            test, yes, no = tensors
            other = add("And", [add("Not", [test], f"not_{name}"), no], name)
            return add("Or", [add("And", [test, yes], name), other], name, origin)
        if operation == "sum":
            terms = [self._shaped(tensors[0], node.sizes, name), self._constant(np.array([1]), "axis")]
            return self._shaped(add("ReduceSum", terms, name, origin, keepdims=0), (node.size,), name)
        if operation == "matmul":
            rows, inner, columns = node.sizes
            factors = [self._shaped(tensors[0], (rows, inner), name), self._shaped(tensors[1], (inner, columns), name)]
            return self._shaped(add("MatMul", factors, name, origin), (node.size,), name)
        return add(_OPERATORS.get(operation, operation.capitalize()), tensors, name, origin)

    def _shaped(self, tensor: str, shape: tuple[int, ...], name: str) -> str:
        return self.add("Reshape", [tensor, self._constant(np.array(shape), f"{name}_shape")], f"{name}_shaped")

    def _constant(self, values: Array, name: str) -> str:
        key = values.tobytes() + values.dtype.str.encode()
        if key not in self._places:
            self._used[name] += 1
            unique = f"{name}.constant.{self._used[name]}"
            self._constants.append(self._onnx.numpy_helper.from_array(np.ascontiguousarray(values), unique))
            self._places[key] = unique
        return self._places[key]

    def _described(self, name: str, node: Node) -> Any:
        return self._onnx.helper.make_tensor_value_info(name, self._type(node.kind), [node.size])

    def _type(self, kind: Kind) -> int:
        return int(self._onnx.helper.np_dtype_to_tensor_dtype(kind))


def controller_model(controller: ControllerGraph) -> Any:
    """A block as a model: its inputs, gains and ``memory`` come in; its outputs and ``next_memory`` go out.

    The memory is one vector: its parts, one after the other, as ``double``, which represents every ``float``, whole
    number and truth value exactly.

    Raises:
        ConfigurationError: the package onnx is not installed.
        HydroError: the model is wrong.
    """
    parts, graph, new = controller.memory, controller.graph, controller.common
    size = sum(part.size for part in parts)
    inputs = {row.name: graph.inputs[row.name] for row in controller.inputs}
    memory, zero = Node("input", (), size, DOUBLE, name="memory"), Builder().constant(np.zeros(1))
    writer = OnnxWriter({**inputs, "memory": memory}, [*controller.outputs, "next_memory"])
    first = 0
    for part in parts:
        name, places = f"memory.{part.name}", np.arange(first, first + part.size)
        piece = Node("collect", (memory,), part.size, DOUBLE, places, name=name)
        writer.given[part.name] = writer.tensor(_converted(piece, part.kind, name))
        first += part.size
    started, continued = controller.case(STARTED), controller.case(CONTINUED)
    for name in started:
        before = zero if name.startswith(ANSWER) else graph.inputs[name]
        goes_on = _chosen(new["begins"], started[name], continued[name], name)
        new[name] = _chosen(new["controls"], goes_on, before, name)
        if name.startswith(ANSWER):
            writer.given[name] = writer.tensor(new[name])
    pieces = tuple(_converted(new[part.name], DOUBLE, f"next.{part.name}") for part in parts)
    outputs = {"next_memory": Node("collect", pieces, size, DOUBLE, np.arange(size), name="joined_memory")}
    for name in controller.outputs:
        outputs[name] = new.get(OUTPUT + name) or new[ANSWER + name]
    facts = {"sample_time": repr(controller.signals.config.control_period)}
    return writer.model(outputs, facts_of(controller, "")["title"], facts)


def _converted(node: Node, kind: Kind, name: str) -> Node:
    return node if node.kind == kind else Node("cast", (node,), node.size, kind, name=name)


def _chosen(condition: Node, yes: Node, no: Node, name: str) -> Node:
    return yes if yes is no else Node("where", (condition, yes, no), yes.size, yes.kind, name=name)
