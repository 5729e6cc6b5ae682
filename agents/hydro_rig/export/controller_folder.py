"""The folder of an exported controller: all files that a machine needs to run it, checked before they are written."""

import math
import re
from collections.abc import Sequence
from functools import partial
from typing import NamedTuple

import numpy as np
import yaml

from hydro_agents.controllers.base import Controller
from hydro_agents.controllers.own_loop import LOST_TIME, OUT_OF_RANGE, OwnLoop
from hydro_agents.controllers.registry import gain_rows
from hydro_agents.running.seeds import CONTROLLER_VECTORS
from hydro_env import ConfigurationError, HydroError, ServoHydraulicVectorEnv, TaskConfig
from hydro_env.files import Group
from hydro_env.task.sensors import CHANNELS
from hydro_env.types import ByName
from hydro_env.units import FULL_VOLTAGE
from hydro_rig.export.c_files import TEMPLATES, csv_text, tested
from hydro_rig.export.contract import LOST_RULE
from hydro_rig.export.controller import GAINS, ControllerGraph, c_name, controller_code, controller_graph, facts_of
from hydro_rig.export.onnx_writer import controller_model, onnx_session
from hydro_rig.export.structured_text import RESERVED, call_example, plcopen_xml, st_name, structured_text

LARGEST_DIFFERENCE = 1e-5  # of the command between the exported controller and the one in Python; more is an error
IN_SINGLE = 1e-4  # the same of a block in single precision: a millivolt, three steps of a 16-bit output
NAME = "Controller"
MODEL_FILE, TASK_FILE = "controller.onnx", "task.yaml"
FAMILIES = ("step", "multi_sine", "start_stop")  # references of the closed-loop episodes, if the task has them
LONGEST = 180  # control periods per episode of the vectors
FREE = {"output_rate": 1e9, "max_speed": 1e9, "max_acceleration": 1e9}  # the controller itself, without the block
COMPARED = ("command", "state", "fault_code")


TOUR = """
2 control; 2 on control; 2 on; 2 on control; 2; 2 on; 2; 2 on; 2 on control; 2 on; 2 on control
10 on manual; 60 on control; 10 on control weak; 10 on control slow; 4 on control negative; 4 on control wrong
lost on control away; 3 on control; 2 on control reset away; 2 on control reset; 2 on control; 2 on reset
2 on control reset; 2 on manual; lost on manual away; 1 on away; 2 on manual away; 2 on away; 2 away; 2 on away
2 on manual away; 2; 2 on; 4 on control; 3 on control exact; 2 on manual; 2 reset; 2 on; 4 on control
3 on control exact hasty; 2 on reset; 2 on manual; 2 on; 4 on hasty away; 2 on reset
4 on control; 4 on control hasty away; 2; 2 on; 20 on control free
"""
"""Every transition between two states, every fault: samples, and what changes in the inputs of a healthy axis."""

LONGEST_TOUR = 600  # control periods


class Vector(NamedTuple):
    """A sample."""

    start: bool  # it begins with a new block
    inputs: ByName  # of the block and its gains, by name
    outputs: ByName  # COMPARED


HEADERS = frozenset((TEMPLATES / "c_headers.txt").read_text(encoding="utf-8").split())
"""Of C; a file of such a name would stand in their place."""


def files_of(name: str) -> tuple[str, ...]:
    """Names of the files of a block with a name."""
    code = c_name(name)
    sources = (code + end for end in (".c", ".h", ".st", "_call.st", ".xml"))
    return (MODEL_FILE, *sources, f"test_{code}.c", "vectors.csv", TASK_FILE, "README.md")


def check_block_name(name: str) -> None:
    """Check the name of a block; ConfigurationError: it is no name, or a word of C or Structured Text."""
    if not re.fullmatch(r"[A-Za-z][A-Za-z0-9]{0,30}", name) or name.lower() in RESERVED | HEADERS:
        raise ConfigurationError(
            f"--name {name}: must be at most 31 letters and digits, a letter first, and no word of C or Structured Text"
        )


def make_vectors(graph: ControllerGraph) -> list[Vector]:
    """Closed-loop episodes on a given motion, and a tour through all states, faults and limits.

    :class:`~hydro_agents.controllers.own_loop.OwnLoop` gives the same commands on the same references, with the
    observations of the environment.

    Raises:
        HydroError: it does not.
    """
    config = graph.signals.config
    weights = config.references.weights
    families: list[str | None] = [name for name in FAMILIES if weights.get(name, 0.0) > 0.0] or [None]
    *seeds, last = CONTROLLER_VECTORS.take(len(families) + 1)
    vectors = []
    for seed, family in zip(seeds, families, strict=True):
        run = _Episode(graph, config, seed, family)
        _follow(run)
        vectors += run.vectors
    duration = max(config.episode_duration, LONGEST_TOUR * config.control_period)
    run = _Episode(graph, config.model_copy(update={"episode_duration": duration}), last, families[0])
    _tour(run, [gain.name for gain in graph.gains])
    return [*vectors, *run.vectors]


class _Episode:
    """A block that drives a simulated axis; it keeps all inputs and outputs."""

    def __init__(self, graph: ControllerGraph, config: TaskConfig, seed: int, family: str | None) -> None:
        self.block, self.config, self.memory = graph.block, config, graph.block.empty()
        self._usual = {row.name: row.default for row in graph.inputs}
        self._env = ServoHydraulicVectorEnv(1, config, info=False)
        self._env.reset(seed=[seed], options={"reference": [family]} if family is not None else None)
        self.axes = self._env.axes
        self.signals = partial(graph.signals.inputs_of, self.axes)  # and the references of the environment
        self.vectors: list[Vector] = []

    def step(self, inputs: ByName, moves: bool = True) -> float:
        """One call of the block, V; the axis moves for a control period, until the end of its episode."""
        refused = any(name.startswith(GAINS) for name in inputs)  # such a gain is out of its range
        outputs, self.memory = self.block(inputs, self.memory, refused)
        found = {name: outputs[name] for name in COMPARED}
        self.vectors.append(Vector(not self.vectors, self._usual | inputs, found))
        command = float(outputs["command"])
        if not math.isfinite(command):
            raise HydroError(f"{type(self.block.controller).__name__}: its voltage is not finite: cannot be exported")
        if moves and self.axes.column("step")[0] < self.config.steps - 1:
            self._env.step(np.array([[command / FULL_VOLTAGE]]))
        return command


def _follow(run: _Episode) -> None:
    """The block takes over from a manual command and follows the reference of the episode."""
    first = float(FULL_VOLTAGE * run.axes.column("command")[0])
    run.step({"enable": True, **run.signals()}, moves=False)
    run.step({"enable": True, "manual": True, "manual_command": first, **FREE, **run.signals()}, moves=False)
    loop = OwnLoop(run.block.controller, run.config, si=True)
    loop.reset(first)
    ahead = np.array([0, *run.config.preview_samples])
    for _ in range(min(LONGEST, run.config.steps - 1)):
        given = run.axes.reference[0, int(run.axes.column("step")[0]) + ahead]
        sensed = dict(zip(CHANNELS, run.axes.column("measured")[0], strict=True))
        command = run.step({"enable": True, "control": True, "follow": True, **FREE, **run.signals()})
        own = loop.step(given, **sensed)
        if abs(own - command) > LARGEST_DIFFERENCE * FULL_VOLTAGE:
            who = type(run.block.controller).__name__
            raise HydroError(f"{who}: {command:.6g} V in the block, {own:.6g} V in the environment: cannot be exported")


def _tour(run: _Episode, gains: Sequence[str]) -> None:
    """Drive the axis through TOUR, then with lost signals, and values and gains out of range."""
    here = run.signals()["position"]
    words = {
        "on": {"enable": True, "reference": here + 0.01},
        "control": {"control": True},
        "manual": {"manual": True, "manual_command": 0.3},
        "away": {"valid_position": False, "position": math.nan},
        "reset": {"reset": True},
        "exact": {"error_limit": 1e-9},
        "hasty": {"lost_limit": 2},
        "weak": {"output_limit": 0.2},
        "slow": {"output_rate": 2.0, "max_speed": 0.02, "max_acceleration": 0.1, "reference": here},
        "negative": {"output_limit": -1.0},
        "wrong": dict.fromkeys(("output_limit", "output_rate", "max_speed", "manual_command"), math.nan),
        "free": {"follow": True, **FREE},
    }
    lost = math.ceil(LOST_TIME / run.config.control_period) + 3
    for step in re.split(";|\n", TOUR.strip()):
        count, *held = step.split()
        for _ in range(lost if count == "lost" else int(count)):
            run.step(run.signals() | {name: value for word in held for name, value in words[word].items()})
    changes = [{GAINS + name: value} for name in gains for value in (math.nan, -1e6)]
    if run.block.corrects:
        changes += [{"correction_limit": limit} for limit in (0.0, 0.05, math.nan)]
    for name in (signal.name for signal in run.block.signals.signals if signal.sensor):
        changes += [{f"valid_{name}": False, name: math.nan}, {}, {name: 1e12}, {}, {name: -1e12}, {}]
    for change in changes:
        run.step({**run.signals(), **words["on"], **words["control"], **words["free"], **change})


def exported_files(
    controller: Controller, config: TaskConfig, command: str, origin: str = "", name: str = NAME, single: bool = False
) -> tuple[dict[str, bytes], list[str]]:
    """The files of an exported controller by name, and the results of their checks, one line each.

    Their page names the ``command`` that exports it, and the ``origin`` of its gains; ``name``: of the block;
    ``single``: C and Structured Text in single precision.

    Raises:
        TraceError: the controller cannot be exported exactly.
        ConfigurationError: the package onnx or onnxruntime is not installed, or a language keeps the name for itself.
        HydroError: the ONNX model or the C code gives other commands.
    """
    check_block_name(name)
    graph = controller_graph(controller, config)
    if name.lower() in {st_name(each).lower() for each in (*(row.name for row in graph.block.inputs), *graph.outputs)}:
        raise ConfigurationError(f"--name {name}: is an input or output of the block")
    model = controller_model(graph).SerializeToString()
    vectors, gains = make_vectors(graph), getattr(controller, "gains", None)
    written = graph.in_single() if single else graph
    prefix, in_text = c_name(name), structured_text(written, name)
    values = {
        **facts_of(graph, name),
        "command": command,
        "origin": origin,
        "st_name": st_name,
        "samples": len(vectors),
        "single": single,
        "allowed": LARGEST_DIFFERENCE * FULL_VOLTAGE,
        "allowed_in_c": (IN_SINGLE if single else LARGEST_DIFFERENCE) * FULL_VOLTAGE,
        "compared": COMPARED,
        "lost_rule": LOST_RULE,
        "outside": OUT_OF_RANGE,
        "products": f"FUNCTION {name}Product1 " in in_text,
        "all_gains": gain_rows(gains) if isinstance(gains, Group) else [],
    }
    in_onnx = check_onnx(model, graph, vectors)
    rows = [[start, *given.values(), *found.values()] for start, given, found in vectors]
    csv = csv_text([*(row.name for row in graph.inputs), *COMPARED], rows)
    files, in_c = tested(prefix, "controller", controller_code(written, name), csv, values)
    task = yaml.safe_dump(config.model_dump(mode="json"), sort_keys=False, allow_unicode=True)
    call = call_example(written, name)
    texts = {".st": in_text, "_call.st": call, ".xml": plcopen_xml(in_text + call, name)}
    files |= {prefix + end: text.encode("ascii") for end, text in texts.items()}
    files |= {MODEL_FILE: model, TASK_FILE: task.encode()}
    return files, [f"{MODEL_FILE}: {in_onnx}", f"{prefix}.c: {in_c}"]


def check_onnx(model: bytes, graph: ControllerGraph, vectors: list[Vector]) -> str:
    """Differences between the ONNX model in onnxruntime and the test vectors, in words.

    Raises:
        HydroError: a difference is above :data:`LARGEST_DIFFERENCE`, or a state is another one.
    """
    session, who = onnx_session(model), type(graph.block.controller).__name__
    size = sum(part.size for part in graph.memory)
    names = [output.name for output in session.get_outputs()]
    differences, same = [], True
    kinds = {row.name: row.kind for row in graph.inputs}
    memory = np.zeros(size)
    for start, given, expected in vectors:
        memory = np.zeros(size) if start else memory
        values: ByName = {name: np.array([value], kinds[name]) for name, value in given.items()}
        found = dict(zip(names, session.run(None, {**values, "memory": memory}), strict=True))
        memory = found["next_memory"]
        differences.append(abs(float(found["command"][0]) - expected["command"]) / FULL_VOLTAGE)
        same = same and all(int(found[name][0]) == expected[name] for name in COMPARED[1:])
    largest = float(np.max(differences))
    if not (largest <= LARGEST_DIFFERENCE and same):
        raise HydroError(
            f"{who}: the ONNX model differs by {largest:.2g} of full command from the controller in Python: "
            "cannot be exported"
        )
    return f"{len(differences)} samples in onnxruntime, largest difference of command {largest:.2g}"
