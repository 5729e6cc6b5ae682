"""Writes a graph of array operations as an ONNX model: plain operators, fixed shapes, one-dimensional tensors."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hydro_env import ConfigurationError, HydroError, __version__
from hydro_rig.export.controller import ANSWER, CONTINUED, OUTPUT, STARTED, ControllerGraph
from hydro_rig.export.graph import Builder, Node, in_order

OPSET = 17
DOUBLE = np.dtype(np.float64)
_OPERATORS = {
    "add": "Add", "subtract": "Sub", "multiply": "Mul", "divide": "Div", "negative": "Neg", "absolute": "Abs",
    "sqrt": "Sqrt", "exp": "Exp", "log": "Log", "power": "Pow", "tanh": "Tanh", "arcsinh": "Asinh", "equal": "Equal",
    "greater": "Greater", "greater_equal": "GreaterOrEqual", "less": "Less", "less_equal": "LessOrEqual",
    "and": "And", "or": "Or", "not": "Not", "where": "Where",
}  # fmt: skip


def onnx_package() -> Any:
    """The package onnx.

    Raises:
        ConfigurationError: the package is not installed.
    """
    try:
        import onnx
    except ImportError:
        raise ConfigurationError("ONNX needs the package onnx: pip install 'hydro_env[export]'") from None
    return onnx


def onnx_session(model: bytes) -> Any:
    """A session of onnxruntime on one thread.

    Raises:
        ConfigurationError: onnxruntime is not installed.
    """
    try:
        import onnxruntime
    except ImportError:
        text = "the check of an ONNX model needs the package onnxruntime: pip install 'hydro_env[export]'"
        raise ConfigurationError(text) from None
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = options.inter_op_num_threads = 1
    options.log_severity_level = 4
    return onnxruntime.InferenceSession(model, options, providers=["CPUExecutionProvider"])


class OnnxWriter:
    """Collects the operators of one ONNX model.

    Args:
        inputs: size and type of each input of the model, by name.
        outputs: names of its outputs, which no other tensor may have.
    """

    def __init__(self, inputs: Mapping[str, tuple[int, np.dtype[Any]]], outputs: Sequence[str]) -> None:
        self._onnx = onnx_package()
        self._nodes: list[Any] = []
        self._constants: list[Any] = []
        self._places: dict[bytes, str] = {}
        self._names: dict[Node, str] = {}
        self._used: Counter[str] = Counter([*inputs, *outputs])
        self._inputs = [self._described(name, size, kind) for name, (size, kind) in inputs.items()]
        self.given = {name: name for name in inputs}
        """Tensor of each input of a graph: inputs of the model, and tensors that the caller computes from them."""

    def tensor(self, node: Node) -> str:
        """Name of the tensor of a result; writes all required operators, operands first."""
        for one in [*in_order([node]), node]:
            if one not in self._names:
                self._names[one] = self._written(one)
        return self._names[node]

    def gathered(self, tensor: str, places: NDArray[np.int64], name: str) -> str:
        """Elements of a tensor at constant places as a separate tensor."""
        return self.add("Gather", [tensor, self._constant(places, f"{name}_places")], name, axis=0)

    def cast(self, tensor: str, kind: np.dtype[Any], wanted: np.dtype[Any], name: str) -> str:
        """A tensor of one type in another one."""
        return tensor if kind == wanted else self.add("Cast", [tensor], name, to=self._type(wanted))

    def add(self, operator: str, tensors: Sequence[str], name: str, origin: str = "", **attributes: Any) -> str:
        """Add one operator; returns the name of its result, which is also the operator's name."""
        plain = re.sub(r"\W", "_", name)
        self._used[plain] += 1
        unique = plain if self._used[plain] == 1 else f"{plain}.{self._used[plain]}"
        node = self._onnx.helper.make_node(operator, list(tensors), [unique], name=unique, **attributes)
        node.doc_string = origin
        self._nodes.append(node)
        return unique

    def model(self, outputs: Mapping[str, tuple[str, int, np.dtype[Any]]], title: str, facts: Mapping[str, str]) -> Any:
        """The model, checked.

        Args:
            outputs: tensor, size and type of each output, by name.
            title: one sentence.
            facts: further properties.

        Raises:
            HydroError: the checker of the package onnx finds a mistake.
        """
        helper = self._onnx.helper
        for name, (tensor, _, _) in outputs.items():
            self._nodes.append(helper.make_node("Identity", [tensor], [name], name=f"{name}.output"))
        described = [self._described(name, size, kind) for name, (_, size, kind) in outputs.items()]
        graph = helper.make_graph(self._nodes, "controller", self._inputs, described, self._constants, title)
        opset = helper.make_opsetid("", OPSET)
        model = helper.make_model(
            graph, opset_imports=[opset], ir_version=8, producer_name="hydro_env", producer_version=__version__
        )
        helper.set_model_props(model, dict(facts))
        try:
            self._onnx.checker.check_model(model, full_check=True)
        except (self._onnx.checker.ValidationError, self._onnx.shape_inference.InferenceError) as error:
            raise HydroError(f"the ONNX model is wrong: {' '.join(str(error).split())}") from error
        return model

    # Operators ----------------------------------------------------------------------------------------------------

    def _written(self, node: Node) -> str:
        name, origin = node.name or node.operation, node.origin
        if node.operation == "input":
            return self.given[node.name]
        if node.operation == "constant":
            assert node.table is not None
            return self._constant(node.table, name)
        tensors = [self._names.get(one) or self.tensor(one) for one in node.operands]  # new: inputs and constants
        if node.operation == "collect":
            assert node.table is not None
            joined = tensors[0] if len(tensors) == 1 else self.add("Concat", tensors, name, origin, axis=0)
            whole = sum(one.size for one in node.operands)
            return joined if np.array_equal(node.table, np.arange(whole)) else self.gathered(joined, node.table, name)
        if node.operation == "cast":
            return self.add("Cast", tensors, name, origin, to=self._type(node.kind))
        if node.operation == "where" and node.kind == np.bool_:  # onnxruntime has no Where of truth values
            test, yes, no = tensors
            other = self.add("And", [self.add("Not", [test], f"not_{name}"), no], name)
            return self.add("Or", [self.add("And", [test, yes], name), other], name, origin)
        if node.operation == "sum":
            outer, length, inner = node.sizes
            shaped = tensors[0] if node.size == 1 else self._shaped(tensors[0], (outer, length, inner), name)
            axis = self._constant(np.array([0 if node.size == 1 else 1]), "axis")
            keep = int(node.size == 1)
            total = self.add("ReduceSum", [shaped, axis], name, origin, keepdims=keep)
            return total if node.size == 1 else self._shaped(total, (node.size,), name)
        if node.operation == "matmul":
            rows, inner, columns = node.sizes
            left = tensors[0] if rows == 1 and columns > 1 else self._shaped(tensors[0], (rows, inner), name)
            product = self.add("MatMul", [left, self._shaped(tensors[1], (inner, columns), name)], name, origin)
            return product if rows == 1 and columns > 1 else self._shaped(product, (rows * columns,), name)
        return self.add(_OPERATORS[node.operation], tensors, name, origin)

    def _shaped(self, tensor: str, shape: tuple[int, ...], name: str) -> str:
        return self.add("Reshape", [tensor, self._constant(np.array(shape), f"{name}_shape")], f"{name}_shaped")

    def _constant(self, values: NDArray[Any], name: str) -> str:
        key = values.tobytes() + values.dtype.str.encode()
        if key not in self._places:
            self._used[name] += 1
            unique = f"{name}.constant.{self._used[name]}"
            self._constants.append(self._onnx.numpy_helper.from_array(np.ascontiguousarray(values), unique))
            self._places[key] = unique
        return self._places[key]

    def _described(self, name: str, size: int, kind: np.dtype[Any]) -> Any:
        return self._onnx.helper.make_tensor_value_info(name, self._type(kind), [size])

    def _type(self, kind: np.dtype[Any]) -> int:
        return int(self._onnx.helper.np_dtype_to_tensor_dtype(kind))


def controller_model(controller: ControllerGraph) -> Any:
    """A block as a model: its inputs, gains and ``memory`` come in; its outputs and ``next_memory`` go out.

    The memory is one vector: its parts, one after the other, as ``double``, which represents every ``float``, whole
    number and truth value exactly.

    Raises:
        ConfigurationError: the package onnx is not installed.
        HydroError: the model is wrong.
    """
    parts, graph, shared = controller.memory, controller.graph, controller.common
    size = sum(part.size for part in parts)
    inputs = {row.name: (1, graph.inputs[row.name].kind) for row in controller.inputs}
    writer = OnnxWriter({**inputs, "memory": (size, DOUBLE)}, [*controller.outputs, "next_memory"])
    first = 0
    for part in parts:
        tensor = writer.gathered("memory", np.arange(first, first + part.size), f"memory.{part.name}")
        writer.given[part.name] = writer.cast(tensor, DOUBLE, part.kind, f"memory.{part.name}")
        first += part.size
    builder, new = Builder(), dict(shared)
    started, continued = controller.case(STARTED), controller.case(CONTINUED)
    for name, node in started.items():
        before = builder.constant(np.zeros(1)) if name.startswith(ANSWER) else graph.inputs[name]
        example = np.zeros(node.size, node.kind)
        goes_on = (
            node
            if node is continued[name]
            else builder.node("where", [shared["begins"], node, continued[name]], example, name=name)
        )
        new[name] = (
            goes_on
            if goes_on is before
            else builder.node("where", [shared["controls"], goes_on, before], example, name=name)
        )
        if name.startswith(ANSWER):
            writer.given[name] = writer.tensor(new[name])
    pieces = [writer.cast(writer.tensor(new[part.name]), part.kind, DOUBLE, f"next.{part.name}") for part in parts]
    outputs = {"next_memory": (writer.add("Concat", pieces, "joined_memory", axis=0), size, DOUBLE)}
    for name in controller.outputs:
        if OUTPUT + name in shared:
            outputs[name] = (writer.tensor(shared[OUTPUT + name]), 1, shared[OUTPUT + name].kind)
        else:
            outputs[name] = (writer.given[ANSWER + name], 1, DOUBLE)
    facts = {"sample_time": repr(controller.signals.config.control_period)}
    return writer.model(outputs, controller.title, facts)
