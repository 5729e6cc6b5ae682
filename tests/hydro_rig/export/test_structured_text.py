"""Gains and names in the C code and the Structured Text of a controller."""

import re

import numpy as np
import pytest

from hydro_agents.controllers.registry import make_controller
from hydro_rig.export.controller import controller_code, controller_graph, variable_gains
from hydro_rig.export.controller_folder import make_vectors
from hydro_rig.export.structured_text import structured_text


@pytest.fixture(scope="module", params=["pid", "flow_linearising"])
def varied(request, exported):
    """Kind, controller and its graph with variable gains."""
    made = exported(request.param)
    config = made.graph.signals.config
    gains = variable_gains(made.controller, config)
    return request.param, made.controller, controller_graph(made.controller, config, gains)


def test_it_gives_the_voltages_of_the_vectors_sample_by_sample(varied, block, exported):
    kind, *_ = varied
    rows, run = np.genfromtxt(exported(kind).folder / "vectors.csv", delimiter=",", skip_header=1), block(kind)
    voltage = [run(row[1:-1], row[0] > 0.0) for row in rows]
    np.testing.assert_allclose(voltage, rows[:, -1], rtol=0, atol=1e-6)


def test_a_gain_that_is_changed_acts_as_in_a_new_controller(varied, block):
    kind, controller, graph = varied
    config = graph.signals.config
    assert {gain.name for gain in graph.gains} >= ({"proportional"} if kind == "pid" else {"position_gain"})
    plain, changed = block(kind), block(kind)
    changed.gains = {name: 0.8 * value for name, value in plain.gains.items()}
    settings = controller.gains.model_dump() | {gain.name: changed.gains[gain.name] for gain in graph.gains}
    vectors = make_vectors(controller_graph(make_controller(kind, config, settings), config).measured)
    assert np.ptp(vectors.voltage) > 1.0
    rows = list(zip(vectors.signals, vectors.start, strict=True))
    new, old = (np.abs([run(*row) for row in rows] - vectors.voltage).max() for run in (changed, plain))
    assert new <= 1e-6 < 1e-3 < old


def test_c_has_the_same_gains_in_one_structure(varied, block):
    kind, _, graph = varied
    code, gains = controller_code(graph), block(kind).gains
    assert "extern ControllerGains controller_gains;" in code.header
    for gain in graph.gains:
        assert f"controller_gains.{gain.name}" in code.source
        assert f"    double {gain.name};" in code.header
        assert gains[gain.name] == gain.value


def test_the_code_has_the_names_of_signals_and_of_the_equations(varied, block):
    """A control engineer finds each signal by name, and each statement below its line of Python."""
    kind, _, graph = varied
    code, text = controller_code(graph).source, structured_text(graph)
    for written in (code, text):
        assert not re.search(r"\b(held|present|last|last_before)\[\d+\] :?=|\b(signals|last)\[\d", written)
        statements = re.sub(r"/\*.*?\*/|\(\*.*?\*\)", "", written, flags=re.DOTALL)
        assert not re.search(r"\b(observation|value|values|dictcomp|listcomp)(_\d+)?\b *(\[|:?=)", statements)
    assert "position_sample = present[CONTROLLER_POSITION] ? signals[CONTROLLER_POSITION]" in code
    assert "position_sample := SEL(present[AT_POSITION], last_before[AT_POSITION], Signals[AT_POSITION]);" in text
    assert "const double position = (double)position_scaled * 0.1;" in code
    memory = block(kind).memory
    for place, signal in enumerate(graph.signals.signals):
        assert memory[f"at_{signal.name}"] == place
    body = code.split("double voltage;")[1]
    assert body.count("/* ") > 0.4 * len(re.findall(r"^ +(?:const )?(?:double|int|float) \w+ = ", body, re.MULTILINE))
