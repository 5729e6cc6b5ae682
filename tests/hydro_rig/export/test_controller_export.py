"""Exported controllers against those in Python: ONNX in closed loops, C code, contract, lost samples, refusals."""

import csv
import ctypes
import json
import pickle
import sys
from collections import ChainMap
from itertools import pairwise

import numpy as np
import onnx
import pytest
from command_line import ROOT, assert_one_clear_line, hydro

from hydro_agents.controllers import PID, PIDGains
from hydro_agents.controllers.base import ObservationLayout
from hydro_agents.learning.features import PolicyFeatures
from hydro_agents.learning.opponents import opponent, trained_for
from hydro_agents.learning.policy import PolicyController
from hydro_agents.running.folders import pretrained_folder
from hydro_agents.running.seeds import VALIDATION_SEEDS
from hydro_env import ConfigurationError, ServoHydraulicVectorEnv, TaskConfig
from hydro_env.task.configuration import task_config
from hydro_rig.export.c_files import WARNINGS, c_compiler, compiled
from hydro_rig.export.controller import controller_code, controller_graph
from hydro_rig.export.controller_folder import exported_files
from hydro_rig.export.exported import ExportedController, onnx_session, read_contract
from hydro_rig.export.measured import MeasuredController, MeasuredSignals
from hydro_rig.export.tracing import TraceError

KINDS = ("pid", "flow_linearising", "adrc", "lqg", "ppo", "mpc")
TASK = TaskConfig(episode_duration=0.6)
FAMILIES = ("step", "point_to_point", "multi_sine", "start_stop")
SEED = VALIDATION_SEEDS.start + 710_000


def write(folder, files):
    folder.mkdir()
    for name, content in files.items():
        (folder / name).write_bytes(content)
    return folder


@pytest.fixture(scope="module")
def folders(tmp_path_factory):
    """The folder of each kind of controller, and what its checks reported."""
    made = {}
    for kind in KINDS:
        files, report = exported_files(opponent(kind, TASK, kind), TASK, "hydro export")
        made[kind] = write(tmp_path_factory.mktemp("export") / kind, files), report
    return made


@pytest.mark.parametrize("kind", KINDS)
def test_it_commands_the_same_over_closed_loop_episodes(kind, folders):
    controller, exported = (opponent(what, TASK, kind) for what in (kind, str(folders[kind][0])))
    env = ServoHydraulicVectorEnv(4, TASK)
    leaks = np.array([0.01, 0.3, 1.0, 4.0])
    options = {"reference": list(FAMILIES), "leakage_flow_lpm": leaks}
    observation, _ = env.reset(seed=[SEED, SEED + 1, SEED + 2, SEED + 3], options=options)
    memory = state = None
    largest = difference = 0.0
    for _ in range(TASK.steps):
        action, memory = controller.predict(observation, memory)
        again, state = exported.predict(observation, state)
        assert again.dtype == action.dtype
        difference = max(difference, float(np.abs(action - again).max()))
        largest = max(largest, float(np.abs(action).max()))
        observation, *_ = env.step(action)
    assert difference <= 1e-5
    assert largest == 1.0  # saturation is among it


@pytest.mark.parametrize("kind", KINDS)
def test_measured_signals_give_the_observation_of_the_environment(kind):
    controller = opponent(kind, TASK, kind)
    measured = controller_graph(controller, TASK).measured
    env = ServoHydraulicVectorEnv(1, TASK)
    observation, _ = env.reset(seed=[SEED + 20])
    memory = state = None
    for _ in range(60):
        action, memory = controller.predict(observation, memory)
        voltage, state = measured(measured.signals.of_axes(env.axes)[0], state)
        assert voltage == pytest.approx(10.0 * float(action[0, 0]), abs=1e-6)
        observation, *_ = env.step(action)


def test_an_axis_starts_again_alone_and_no_state_changes(folders):
    controller = ExportedController.load(folders["flow_linearising"][0])
    env = ServoHydraulicVectorEnv(3, TASK)
    observation, _ = env.reset(seed=[1, 2, 3])
    first, state = controller.predict(observation)
    kept = state.copy()
    again, after = controller.predict(observation, state, np.array([False, True, False]))
    assert np.array_equal(state, kept)
    assert np.array_equal(again[1], first[1])
    assert np.array_equal(after[1], state[1])
    assert not np.array_equal(after[0], state[0])
    single, single_state = controller.predict(observation[0])
    assert np.array_equal(single, first[0])
    assert np.array_equal(pickle.loads(pickle.dumps(controller)).predict(observation[0], single_state)[0], again[0])


@pytest.mark.parametrize("kind", KINDS)
def test_the_model_has_plain_operators_fixed_shapes_and_names(kind, folders):
    model = onnx.load(folders[kind][0] / "controller.onnx")
    onnx.checker.check_model(model, full_check=True)
    assert [(entry.domain, entry.version <= 17) for entry in model.opset_import] == [("", True)]
    assert not [node.op_type for node in model.graph.node if node.op_type in ("Loop", "If", "Scan", "CustomOp")]
    for value in (*model.graph.input, *model.graph.output):
        assert all(dimension.dim_value > 0 for dimension in value.type.tensor_type.shape.dim)
    names = [node.name for node in model.graph.node]
    assert len(set(names)) == len(names)
    assert "previous_voltage_sample" in names
    assert "position_scaled" in names
    assert [value.name for value in model.graph.input] == ["signals", "state", "start"]


@pytest.mark.parametrize("kind", KINDS)
def test_the_test_program_agrees(kind, folders):
    if c_compiler() is None:
        pytest.skip("this machine has no C compiler")
    assert "samples" in folders[kind][1][1]  # its report; the export fails if it differs
    contract = read_contract(folders[kind][0])
    assert contract.checked["controller.onnx"]["largest_difference_of_command"] <= 1e-5
    rows = np.genfromtxt(folders[kind][0] / "vectors.csv", delimiter=",", skip_header=1)
    assert rows[:, 0].sum() == 4  # episodes
    assert (np.abs(rows[:, -1]) == 10.0).any()
    assert np.isnan(rows[:, 1:-1]).any()


def test_the_compensation_of_an_overlapped_valve_is_exported(tmp_path):
    task = task_config(TASK, plant={"valve": {"overlap": 0.1, "underlap": 0.002}})
    plain, compensating = (PID(PIDGains(overlap_compensation=share), task) for share in (0.0, 1.0))
    files, report = exported_files(compensating, task, "hydro export")  # fails if C or ONNX differs from Python
    exported = ExportedController.load(write(tmp_path / "export", files))
    env = ServoHydraulicVectorEnv(1, task)
    observation, _ = env.reset(seed=[SEED])
    memories, added = [None] * 3, 0.0
    for _ in range(60):
        commands = []
        for number, controller in enumerate((compensating, exported, plain)):
            command, memories[number] = controller.predict(observation, memories[number])
            commands.append(float(command[0, 0]))
        assert commands[1] == pytest.approx(commands[0], abs=1e-6)
        added = max(added, abs(commands[0] - commands[2]))
        observation, *_ = env.step([[commands[0]]])
    assert 0.08 < added < 0.25  # the overlap, on one side of zero or from one side to the other
    assert len(report) > 1


def test_several_controllers_fit_into_one_program(tmp_path):
    if c_compiler() is None:
        pytest.skip("this machine has no C compiler")
    graphs = {kind: controller_graph(opponent(kind, TASK, kind), TASK) for kind in KINDS[:4]}
    sources = [controller_code(graph, kind).files for kind, graph in graphs.items()]
    compiled(dict(ChainMap(*sources)), [*WARNINGS, "-shared", "-fPIC"], folder=tmp_path)
    library = ctypes.CDLL(str(tmp_path / "out"))
    env = ServoHydraulicVectorEnv(1, TASK)
    env.reset(seed=[SEED + 30])
    for kind, graph in graphs.items():
        measured = graph.measured
        step = getattr(library, f"{kind}_step")
        step.restype = ctypes.c_double
        memory = ctypes.create_string_buffer(100_000)
        signals = measured.signals.of_axes(env.axes)[0]
        found = step(memory, signals.ctypes.data_as(ctypes.c_void_p), 1)
        assert found == pytest.approx(measured(signals, None)[0], abs=1e-5)


def test_a_name_that_is_none_in_c_is_refused():
    with pytest.raises(ConfigurationError, match="must be a valid name in C"):
        controller_code(controller_graph(opponent("pid", TASK, "pid"), TASK), "my pid")


# Lost samples and values out of range --------------------------------------------------------------------------------


def samples(kind, count):
    """Signals of an axis at rest, in the order of the controller."""
    signals = controller_graph(opponent(kind, TASK, kind), TASK).signals
    env = ServoHydraulicVectorEnv(1, TASK)
    env.reset(seed=[SEED + 40], options={"reference": ["sine"]})
    rows = []
    for _ in range(count):
        rows.append(signals.of_axes(env.axes)[0])
        env.step(np.zeros((1, 1), np.float32))
    return [signal.name for signal in signals.signals], np.array(rows)


def run(folder, rows, start=0):
    session = onnx_session((folder / "controller.onnx").read_bytes())
    state, found = np.zeros(session.get_inputs()[1].shape), []
    for number, row in enumerate(rows):
        inputs = {"signals": row, "state": state, "start": np.array([number == start])}
        voltage, state, lost = session.run(None, inputs)
        found.append((float(voltage[0]), int(lost[0])))
    return np.array(found)


def test_it_waits_for_the_first_complete_sample_and_starts_there(folders):
    names, rows = samples("flow_linearising", 30)
    broken = np.concatenate([rows[:3], rows])
    broken[:3, names.index("pressure_a")] = (np.nan, np.inf, -np.inf)
    broken[:3, names.index("previous_voltage")] = (1.5, 1.5, 99.0)
    folder = folders["flow_linearising"][0]
    found = run(folder, broken)
    assert found[:3].tolist() == [[1.5, 1], [1.5, 1], [10.0, 1]]
    assert np.array_equal(found[3:], run(folder, rows))


def test_a_lost_sample_is_replaced_by_the_last_one(folders):
    names, rows = samples("adrc", 30)
    lost, held = rows.copy(), rows.copy()
    place = names.index("position")
    lost[10:13, place], held[10:13, place] = np.nan, rows[9, place]
    found, expected = (run(folders["adrc"][0], values) for values in (lost, held))
    assert np.array_equal(found[:, 0], expected[:, 0])
    assert found[:, 1].tolist() == [0] * 10 + [1] * 3 + [0] * 17


@pytest.mark.parametrize("kind", KINDS)
def test_no_input_makes_the_voltage_anything_but_a_voltage(kind, folders):
    _, rows = samples(kind, 120)
    generator = np.random.default_rng(5)
    wild = rows * 10.0 ** generator.uniform(-3, 6, rows.shape) * generator.choice([-1.0, 1.0], rows.shape)
    wild[generator.random(rows.shape) < 0.05] = np.nan
    mixed = np.concatenate([wild, rows])
    found = run(folders[kind][0], mixed)[:, 0]
    assert np.isfinite(found).all()
    assert np.abs(found).max() <= 10.0


class Exploding:
    """A controller whose command is no number once the pressure is high."""

    def __init__(self, config):
        self.layout = ObservationLayout.of(config)

    def predict(self, observation, state=None, episode_start=None, deterministic=True):
        count = np.zeros_like(observation[:, 0]) if state is None else state + np.float32(1.0)
        pressure = self.layout.si(observation, "pressure_a")
        return (np.sqrt(60e5 - pressure) / np.sqrt(60e5 - pressure) * 0.01 * count)[:, None], count


def test_after_a_command_that_is_no_number_it_keeps_the_voltage_and_starts_again():
    measured = controller_graph(Exploding(TASK), TASK).measured
    names = [signal.name for signal in measured.signals.signals]
    assert names == ["pressure_a", "previous_voltage"]
    state, found = None, []
    for pressure in (1e5, 1e5, 1e5, 90e5, 90e5, 1e5, 1e5):
        voltage, state = measured(np.array([pressure, 0.7]), state)
        found.append(voltage)
    assert found == pytest.approx([0.0, 0.1, 0.2, 0.7, 0.7, 0.0, 0.1], abs=1e-6)


# Other tasks ---------------------------------------------------------------------------------------------------------


def test_a_policy_of_another_period_and_a_rig_without_spool_sensor():
    policy = PolicyController.load(pretrained_folder() / "policy_2ms")
    signals = controller_graph(policy, policy.features.config).signals
    assert signals.config.control_period == 0.002
    blind = TaskConfig(sensors={"spool_position": {"fitted": False}}, references={"preview_times": ()})
    names = [signal.name for signal in controller_graph(opponent("pid", blind, "pid"), blind).signals.signals]
    assert names == ["reference", "position", "previous_voltage"]


@pytest.mark.parametrize(
    ("base", "correction", "preview", "estimates", "activation", "output"),
    [(None, False, False, False, "tanh", "tanh"), ("flow_linearising", True, True, True, "relu", "linear")],
)
def test_every_form_of_a_policy_can_be_exported(base, correction, preview, estimates, activation, output):
    corrected = opponent(base, TASK, base) if base else None
    features = PolicyFeatures(TASK, corrected, 0.2, correction, preview, estimates)
    generator, sizes = np.random.default_rng(0), [features.size, 24, 1]
    layers = [
        (0.1 * generator.normal(size=(after, before)).astype(np.float32), np.zeros(after, np.float32))
        for before, after in pairwise(sizes)
    ]
    policy = PolicyController(features, layers, activation=activation, output=output)
    files, _ = exported_files(policy, TASK, "hydro export")  # it fails if ONNX or C differ
    settings = json.loads(files["contract.json"])["controller"]
    assert settings["layers"] == [[features.size, 24], [24, 1]]


def test_signals_follow_from_observations_almost_exactly():
    env = ServoHydraulicVectorEnv(50, TASK)
    observation, _ = env.reset(seed=list(range(SEED, SEED + 50)))
    signals = MeasuredSignals(TASK)
    exact, found = signals.of_axes(env.axes), signals.of_observation(observation)
    for place, signal in enumerate(signals.signals):
        tolerance = 3e-10 if signal.name == "position" else 1e-6 * max(abs(signal.low), abs(signal.high))
        assert np.abs(exact - found)[:, place].max() <= tolerance, signal.name
    measured = MeasuredController(opponent("pid", TASK, "pid"), signals)
    for row, again in zip(exact, found, strict=True):
        assert measured(row, None)[0] == pytest.approx(measured(again, None)[0], abs=1e-6)


# Refusals ------------------------------------------------------------------------------------------------------------


class Deciding:
    def predict(self, observation, state=None, episode_start=None, deterministic=True):
        return (observation[:, :1] if observation[0, 0] > 0.0 else -observation[:, :1]), ()


class Counting:
    def predict(self, observation, state=None, episode_start=None, deterministic=True):
        return observation[:, :1], {"calls": 0 if state is None else state["calls"] + 1}


class Remembering:
    def __init__(self):
        self.before = 0.0

    def predict(self, observation, state=None, episode_start=None, deterministic=True):
        command, self.before = 0.5 * observation[:, :1] + self.before, 0.5 * observation[:, :1]
        return command, ()


@pytest.mark.parametrize(
    ("controller", "what"),
    [
        (Deciding(), "depends on the data"),
        (Counting(), "'controller.calls' is a number that changes"),
        (Remembering(), "Remembering: keeps its memory outside its state"),
    ],
)
def test_what_cannot_be_exact_is_refused(controller, what):
    with pytest.raises(TraceError, match=what):
        exported_files(controller, TASK, "hydro export")


def test_a_changed_folder_is_refused_with_one_line(folders, tmp_path):
    source = folders["pid"][0]

    def refused(name, change, what):
        folder = write(tmp_path / name, {file.name: file.read_bytes() for file in source.iterdir()})
        change(folder)
        with pytest.raises(ConfigurationError, match=what) as error:
            opponent(str(folder), TASK, "exported")
        assert "\n" not in str(error.value)

    def edit(folder, name, old, new):
        content = (folder / name).read_text()
        assert old in content
        (folder / name).write_text(content.replace(old, new, 1))

    refused("model", lambda f: (f / "controller.onnx").open("ab").write(b"\0"), "controller.onnx: was changed")
    refused("task", lambda f: edit(f, "task.yaml", "control_period: 0.005", "control_period: 0.004"), "was changed")
    refused("period", lambda f: edit(f, "contract.json", '"sample_time": 0.005', '"sample_time": 0.004'), "was changed")
    refused("lost", lambda f: (f / "controller.c").unlink(), "holds no 'controller.c'")
    refused("none", lambda f: (f / "contract.json").unlink(), "is not an exported controller")
    refused("text", lambda f: (f / "contract.json").write_text("{"), "not valid JSON")
    refused("other", lambda f: (f / "contract.json").write_text("{}"), "is not a contract")


def test_a_folder_for_another_task_is_refused(folders):
    folder = str(folders["pid"][0])
    with pytest.raises(ConfigurationError, match="other observations"):
        opponent(folder, TaskConfig(control_period=0.004), "exported")
    assert trained_for(opponent(folder, TASK, "exported")) == TASK.plant


@pytest.mark.parametrize("package", ["onnx", "onnxruntime"])
def test_a_missing_package_is_one_clear_line(package, folders, monkeypatch):
    monkeypatch.setitem(sys.modules, package, None)
    controller, message = opponent("pid", TASK, "pid"), rf"package {package}: pip install 'hydro_env\[export\]'"
    with pytest.raises(ConfigurationError, match=message):
        _ = exported_files(controller, TASK, "") if package == "onnx" else ExportedController.load(folders["pid"][0])


def test_the_command_writes_the_folder_once_and_refuses_what_it_does_not_know(tmp_path):
    folder = tmp_path / "pid"
    answer = hydro("export", "pid", "--output", folder)
    assert answer.returncode == 0, answer.stderr
    assert "largest difference of command" in answer.stdout
    assert read_contract(folder).controller["kind"] == "pid"
    assert json.loads((folder / "contract.json").read_text())["sample_time"] == 0.005
    assert_one_clear_line(hydro("export", "pid", "--output", folder), "holds results already")
    assert_one_clear_line(hydro("export", folder, "--output", tmp_path / "x"), "is an exported controller already")
    answer = hydro("export", "adrc", "--output", folder, "--overwrite")
    assert answer.returncode == 0, answer.stderr
    assert read_contract(folder).controller["kind"] == "adrc"
    assert_one_clear_line(hydro("export", "nonsense", "--output", tmp_path / "x"), "nonsense")
    assert not (tmp_path / "x").exists()


@pytest.mark.slow
def test_hydro_evaluate_shows_the_same_errors(tmp_path):
    folder = tmp_path / "ppo"
    assert hydro("export", "ppo", "--output", folder).returncode == 0
    agents = "".join(
        f"  {name}\n"
        for name in (
            f"PID: {{kind: pid, settings: {ROOT}/configs/agents/pid.yaml}}",
            f"base: {{kind: flow_linearising, settings: {ROOT}/configs/agents/flow_linearising.yaml}}",
            f"PPO: {{kind: ppo, settings: {ROOT}/configs/agents/ppo.yaml, corrects: base}}",
        )
    )
    evaluation = "{leak_levels: [0.01, 1.0], plants: 3, detection_episodes: 100}"
    (tmp_path / "study.yaml").write_text(f"controllers:\n{agents}evaluation: {evaluation}\n")
    results = tmp_path / "results"
    answer = hydro(
        "evaluate", "--config", tmp_path / "study.yaml", "--agent", f"exported={folder}", "--output", results
    )
    assert answer.returncode == 0, answer.stderr
    errors = {"PPO": [], "exported": []}
    for row in csv.DictReader((results / "tables" / "cases.csv").open()):
        if row["controller"] in errors:
            errors[row["controller"]].append(float(row["mean_error_mm"]))
    assert len(errors["PPO"]) == 36
    # A last digit of a command may change a 16-bit reading, and with it a single episode a little.
    assert np.mean(errors["exported"]) == pytest.approx(np.mean(errors["PPO"]), rel=1e-3)
    np.testing.assert_allclose(errors["exported"], errors["PPO"], rtol=0.05)
