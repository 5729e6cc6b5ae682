"""Gains and names in the C code and the Structured Text of a controller."""

import numpy as np
import pytest
from exported_code import InC, assert_it_holds_until_start, at_rest, library

from hydro_agents.controllers.own_loop import LOST_TIME
from hydro_agents.controllers.registry import make_controller
from hydro_agents.running.seeds import VALIDATION_SEEDS
from hydro_env import ServoHydraulicVectorEnv, equilibrium
from hydro_rig.export.controller import controller_code, controller_graph, variable_gains
from hydro_rig.export.controller_folder import make_vectors


@pytest.fixture(scope="module", params=["pid", "flow_linearising"])
def varied(request, exported):
    """Kind, controller and its graph with variable gains."""
    made = exported(request.param)
    config = made.graph.signals.config
    gains = variable_gains(made.controller)
    return request.param, made.controller, controller_graph(made.controller, config, gains)


def test_it_gives_the_voltages_of_the_vectors_sample_by_sample(varied, block, exported):
    kind, *_ = varied
    rows, run = np.genfromtxt(exported(kind).folder / "vectors.csv", delimiter=",", skip_header=1), block(kind)
    voltage = [run(row[1:-1], row[0] > 0.0) for row in rows]
    np.testing.assert_allclose(voltage, rows[:, -1], rtol=0, atol=1e-6)


@pytest.mark.slow  # blark reads a thousand letters a second
def test_it_is_structured_text_by_the_grammar_of_others(varied, exported):
    parse = pytest.importorskip("blark.parse", reason="the extra 'dev' brings it").parse_source_code
    assert parse((exported(varied[0]).folder / "controller.st").read_text()).exception is None


def test_a_new_block_begins_at_rest_and_holds_the_axis_when_the_position_is_lost(varied, block):
    kind, _, graph = varied
    config = graph.signals.config
    for position in (-0.04, 0.0, 0.02):
        _, holding = equilibrium(config.plant, position)
        assert block(kind)(at_rest(graph, position), False) == pytest.approx(holding, abs=0.2)
    assert_it_holds_until_start(block(kind), graph, round(LOST_TIME / config.control_period))


@pytest.mark.parametrize("bad", [np.nan, -5.0])
@pytest.mark.parametrize("language", ["c", "st"])
def test_a_gain_that_is_none_holds_the_last_command_for_this_call(language, bad, varied, block, tmp_path):
    kind, _, graph = varied
    if language == "c":
        run = InC(library(tmp_path, controller_code(graph).files))
        gains = run.gains_of([gain.name for gain in graph.gains])
    else:
        run = block(kind)
        gains, run.stops = run.gains, False  # Structured Text cannot avoid a comparison with such a gain
    name, env, voltages = graph.gains[0].name, ServoHydraulicVectorEnv(1, graph.signals.config), []
    env.reset(seed=[VALIDATION_SEEDS.start + 710_800], options={"reference": ["sine"]})
    for number in range(110):
        usual = gains[name]
        gains[name] = bad if number == 80 else usual
        voltages.append(run(graph.signals.of_axes(env.axes)[0], False))
        gains[name] = usual
        env.step(np.array([[voltages[-1] / 10.0]], dtype=np.float32))
    assert voltages[80] == pytest.approx(voltages[79], abs=1e-6)  # the valve receives single precision
    assert voltages[79] != pytest.approx(voltages[78], abs=1e-6)
    assert np.abs(np.diff(voltages[70:])).max() < 1.0


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
