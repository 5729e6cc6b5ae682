"""A controller as Structured Text: a parser of the language reads it, and its arithmetic is that of the C code."""

import copy
import re

import numpy as np
import pytest

pytest.importorskip("blark", reason="the extra 'dev' brings it")
from structured_text import FunctionBlock

from hydro_agents.controllers.registry import make_controller
from hydro_agents.learning.opponents import opponent
from hydro_env import TaskConfig
from hydro_rig.export.controller import controller_code, controller_graph
from hydro_rig.export.controller_folder import make_vectors, variable_gains
from hydro_rig.export.structured_text import structured_text

TASK = TaskConfig(episode_duration=0.5)
ALLOWED = 1e-6  # V


@pytest.fixture(scope="module", params=["pid", "flow_linearising"])
def exported(request):
    """A controller, its graph with variable gains, and its function block."""
    controller = opponent(request.param, TASK, request.param)
    graph = controller_graph(controller, TASK, variable_gains(controller, TASK))
    return controller, graph, FunctionBlock(structured_text(graph))


def largest_difference(block, controller):
    vectors = make_vectors(controller_graph(controller, TASK).measured)
    found = np.array([block(*sample) for sample in zip(vectors.signals, vectors.start, strict=True)])
    assert np.ptp(vectors.voltage) > 1.0
    return np.abs(found - vectors.voltage).max()


def test_its_arithmetic_gives_the_voltages_of_the_test_vectors(exported):
    controller, _, block = exported
    assert largest_difference(copy.deepcopy(block), controller) <= ALLOWED


def test_a_gain_that_is_changed_acts_as_in_a_new_controller(exported):
    controller, graph, block = exported
    kind = {"PID": "pid"}.get(type(controller).__name__, "flow_linearising")
    assert {gain.name for gain in graph.gains} >= ({"proportional"} if kind == "pid" else {"position_gain"})
    changed = copy.deepcopy(block)
    changed.gains = {name: 0.8 * value for name, value in block.gains.items()}
    settings = controller.gains.model_dump() | {gain.name: changed.gains[gain.name] for gain in graph.gains}
    other = make_controller(kind, TASK, settings)
    assert largest_difference(changed, other) <= ALLOWED
    assert largest_difference(copy.deepcopy(block), other) > 1e-3


def test_c_has_the_same_gains_in_one_structure(exported):
    _, graph, block = exported
    code = controller_code(graph)
    assert "extern ControllerGains controller_gains;" in code.header
    for gain in graph.gains:
        assert f"controller_gains.{gain.name}" in code.source
        assert f"    double {gain.name};" in code.header
        assert block.gains[gain.name] == gain.value


def test_the_code_has_the_names_of_signals_and_of_the_equations(exported):
    """A control engineer finds each signal by name, and each statement below its line of Python."""
    _, graph, block = exported
    code, text = controller_code(graph).source, structured_text(graph)
    for written in (code, text):
        assert not re.search(r"\b(held|present|last|last_before)\[\d+\] :?=|\b(signals|last)\[\d", written)
        statements = re.sub(r"/\*.*?\*/|\(\*.*?\*\)", "", written, flags=re.DOTALL)
        assert not re.search(r"\b(observation|value|values|dictcomp|listcomp)(_\d+)?\b *(\[|:?=)", statements)
    assert "position_sample = present[CONTROLLER_POSITION] ? signals[CONTROLLER_POSITION]" in code
    assert "position_sample := SEL(present[AT_POSITION], last_before[AT_POSITION], Signals[AT_POSITION]);" in text
    assert "const double position = (double)position_scaled * 0.1;" in code
    for place, signal in enumerate(graph.signals.signals):
        assert block.memory[f"at_{signal.name}"] == place
    body = code.split("double voltage;")[1]
    assert body.count("/* ") > 0.4 * len(re.findall(r"^ +(?:const )?(?:double|int|float) \w+ = ", body, re.MULTILINE))
