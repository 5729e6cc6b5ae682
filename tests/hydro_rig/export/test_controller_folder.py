"""Exported controllers against those in Python: sample by sample, in closed loops, refusals."""

import ctypes
import sys
from itertools import pairwise

import numpy as np
import onnx
import pytest
from command_line import assert_one_clear_line, hydro
from exported_code import InC, InPython, library
from refusal import refused

from hydro_agents.controllers import PID, PIDGains
from hydro_agents.learning.any_axis import AnyAxisFeatures
from hydro_agents.learning.features import PolicyFeatures
from hydro_agents.learning.loading import load_controller
from hydro_agents.learning.policy import PolicyController
from hydro_agents.running.folders import pretrained_folder
from hydro_agents.running.seeds import VALIDATION_SEEDS
from hydro_env import ServoHydraulicVectorEnv, TaskConfig, __version__
from hydro_env.task.configuration import task_config
from hydro_rig.export.controller import controller_code, controller_graph, variable_gains
from hydro_rig.export.controller_folder import exported_files
from hydro_rig.export.tracing import TraceError

KINDS = ("pid", "flow_linearising", "ppo")
TASK = TaskConfig(episode_duration=0.6)
SEED = VALIDATION_SEEDS.start + 710_000


@pytest.mark.parametrize("kind", KINDS)
def test_the_vectors_of_each_kind_are_those_of_the_environment_onnx_and_c(kind, exported):
    made = exported(kind)  # fails if the environment, ONNX or C differ from the block in Python
    rows = np.genfromtxt(made.folder / "vectors.csv", delimiter=",", names=True)
    assert rows["start"].sum() == 4  # three episodes and the tour
    assert (np.abs(rows["command"]) == 10.0).any()
    assert np.isnan(rows["position"]).any()
    assert made.report[0].startswith(f"controller.onnx: {len(rows)} samples in onnxruntime")
    assert made.report[1].startswith((f"controller.c: {len(rows)} samples", "controller.c: not compiled"))


@pytest.mark.parametrize("kind", ["pid", "ppo"])
def test_the_model_has_plain_operators_fixed_shapes_and_names(kind, exported):
    model = onnx.load(exported(kind).folder / "controller.onnx")
    onnx.checker.check_model(model, full_check=True)
    assert [(entry.domain, entry.version <= 17) for entry in model.opset_import] == [("", True)]
    assert not [node.op_type for node in model.graph.node if node.op_type in ("Loop", "If", "Scan", "CustomOp")]
    for value in (*model.graph.input, *model.graph.output):
        assert all(dimension.dim_value > 0 for dimension in value.type.tensor_type.shape.dim)
    names = [node.name for node in model.graph.node]
    assert len(set(names)) == len(names)
    assert {"previous_command_sample", "position_scaled"} <= set(names)
    assert {"memory", "position", "valid_position", "output_limit"} <= {value.name for value in model.graph.input}


def test_the_compensation_of_an_overlapped_valve_is_exported():
    task = task_config(TASK, plant={"valve": {"overlap": 0.1, "underlap": 0.002}})
    plain, compensating = (PID(PIDGains(overlap_compensation=share), task) for share in (0.0, 1.0))
    exported_files(compensating, task, "hydro export")  # fails if C or ONNX differs from Python
    proportional = ["proportional" in [gain.name for gain in variable_gains(one)] for one in (compensating, plain)]
    assert proportional == [False, True]  # the compensation is as wide as the noise that this gain makes


def test_several_blocks_with_own_gains_fit_into_one_program(exported, tmp_path):
    names = {"pid": "Lift", "flow_linearising": "TiltAxis"}
    graphs = {kind: exported(kind).graph for kind in names}
    loaded = library(tmp_path, *(controller_code(graph, names[kind]) for kind, graph in graphs.items()))
    env = ServoHydraulicVectorEnv(1, TASK)
    env.reset(seed=[SEED + 30])
    for kind, prefix in (("pid", "lift"), ("flow_linearising", "tilt_axis")):
        graph = graphs[kind]
        row = graph.signals.inputs_of(env.axes) | {"enable": True, "output_rate": 1e9}
        row |= {"max_speed": 1e9, "max_acceleration": 1e9, "reference": row["position"] + 1e-3}
        usual, turned, expected = (InC(loaded, graph, prefix), InC(loaded, graph, prefix), InPython(graph))
        gain = graph.inputs[-len(graph.gains)]
        for closes in (False, True, True):
            found = [run({**row, "control": closes})["command"] for run in (usual, expected)]
            other = turned({**row, "control": closes, gain.name: 0.5 * gain.default})["command"]
            assert found[0] == found[1]
        assert other != found[0]
        version = getattr(loaded, f"{prefix}_version")
        version.restype = ctypes.c_char_p
        assert version().decode() == __version__


# Other tasks ---------------------------------------------------------------------------------------------------------


def test_a_rig_without_spool_sensor_needs_no_such_signal():
    blind = TaskConfig(sensors={"spool_position": {"fitted": False}}, references={"preview_times": ()})
    names = [signal.name for signal in controller_graph(load_controller("pid", blind, "pid"), blind).signals.signals]
    assert names == ["reference", "position"]


@pytest.mark.parametrize(
    ("task", "base", "more", "activation"),
    [(TASK, None, False, "tanh"), (task_config("no_preview"), "flow_linearising", True, "relu")],
)
def test_every_form_of_a_policy_can_be_exported(task, base, more, activation):
    features = PolicyFeatures(task, load_controller(base, task, base) if base else None, 0.2, more, more)
    generator, sizes = np.random.default_rng(0), [features.size, 24, 1]
    layers = [
        (0.1 * generator.normal(size=(after, before)).astype(np.float32), np.zeros(after, np.float32))
        for before, after in pairwise(sizes)
    ]
    policy = PolicyController(features, layers, activation=activation)
    exported_files(policy, task, "hydro export")  # it fails if ONNX or C differ


def test_a_policy_with_a_memory_can_be_exported():
    policy = PolicyController.load(pretrained_folder() / "policy_any_axis")
    exported_files(policy, policy.features.config, "hydro export")
    alone = AnyAxisFeatures(policy.features.config, None).normalised()  # its slow averages are a memory
    layers = [(np.full((1, alone.size), 0.02, np.float32), np.zeros(1, np.float32))]
    exported_files(PolicyController(alone, layers), alone.config, "hydro export")


# Refusals ------------------------------------------------------------------------------------------------------------


class Deciding:
    def predict(self, observation, state=None, episode_start=None, deterministic=True):
        return (observation[:, :1] if observation[0, 0] > 0.0 else -observation[:, :1]), ()


class Counting:
    def predict(self, observation, state=None, episode_start=None, deterministic=True):
        return observation[:, :1], {"calls": 0 if state is None else state["calls"] + 1}


class Remembering:
    before = 0.0

    def predict(self, observation, state=None, episode_start=None, deterministic=True):
        command, self.before = 0.5 * observation[:, :1] + self.before, 0.5 * observation[:, :1]
        return command, ()


@pytest.mark.parametrize(
    ("controller", "what"),
    [
        (Deciding(), "depends on the data"),
        (Counting(), "calls: int holds no arrays"),
        (Remembering(), "Remembering: keeps its memory outside its state"),
    ],
)
def test_what_cannot_be_exact_is_refused(controller, what):
    with pytest.raises(TraceError, match=what):
        exported_files(controller, TASK, "hydro export")


@pytest.mark.parametrize("package", ["onnx", "onnxruntime"])
def test_a_missing_package_is_one_clear_line(package, exported, monkeypatch):
    controller = exported("pid").controller
    monkeypatch.setitem(sys.modules, package, None)
    with refused(rf"package {package}: pip install 'hydro_env\[export\]'"):
        exported_files(controller, TASK, "")


@pytest.mark.parametrize("name", ["Pid", "while", "2Lift", "Lift axis", "Math", "Enable", "FaultCode"])
def test_a_name_that_no_compiler_takes_is_refused(name, exported):
    with refused("must be at most 31 letters and digits|is an input or output of the block"):
        exported_files(exported("pid").controller, TASK, "", name=name)


def test_the_command_writes_the_folder_of_a_rig_that_nobody_tuned_once(tmp_path, other_rig):
    folder, timing = tmp_path / "lift", ("--rig", other_rig, "--period", "2ms", "--latency", "0.6ms")
    answer = hydro("export", "flow_linearising", *timing, "--name", "Lift", "--output", folder)
    assert (answer.returncode, answer.stderr) == (0, "")
    assert "gains for any rig" in answer.stdout
    assert "largest difference of command" in answer.stdout
    assert "FUNCTION_BLOCK Lift" in (folder / "lift.st").read_text()
    assert "LIFT_SAMPLE_TIME 0.002 " in (folder / "lift.h").read_text()
    assert_one_clear_line(hydro("export", "pid", "--output", folder), "holds results already")


@pytest.mark.parametrize(
    ("arguments", "what"),
    [
        (("flow_linearising", "--period", "2 bar"), "export flow_linearising: --period = '2 bar': unit 'bar'"),
        (("flow_linearising", "--latency", "26ms"), "--latency = 0.026 s must not exceed 5 times --period = 0.005 s"),
        (("plant", "--latency", "1ms"), "export plant: takes no --period and no --latency"),
        (("plant", "--single"), "export plant: takes no --name, no --gains and no --single"),
    ],
)
def test_what_the_command_does_not_know_is_one_line(arguments, what, tmp_path):
    assert_one_clear_line(hydro("export", *arguments, "--output", tmp_path / "x"), what)
    assert not (tmp_path / "x").exists()
