"""Structured Text: the rules of its compilers, the vectors, and gains that change."""

import copy
import csv
import re
from itertools import islice
from xml.etree import ElementTree

import numpy as np
import pytest
from structured_text import FunctionBlock

from hydro_agents.controllers.registry import make_controller
from hydro_agents.running.seeds import VALIDATION_SEEDS
from hydro_env import ServoHydraulicVectorEnv
from hydro_rig.export import structured_text as writing
from hydro_rig.export.controller import controller_graph
from hydro_rig.export.controller_folder import IN_SINGLE
from hydro_rig.export.structured_text import RESERVED, structured_text

KINDS = ("pid", "flow_linearising")
SEED = VALIDATION_SEEDS.start + 710_800


@pytest.mark.parametrize(("kind", "samples"), [*((kind, None) for kind in KINDS), ("ppo", 40)])
def test_it_gives_commands_and_states_of_the_vectors_sample_by_sample(kind, samples, block, exported):
    different, usual = 0, block(kind).gains
    for row in islice(csv.DictReader((exported(kind).folder / "vectors.csv").open()), samples):
        if row["start"] == "1":
            run = block(kind)
            run.stops = False  # some vectors hold gains and limits that are not numbers
        inputs = {each.name: each.kind(float(row[each.name])) for each in exported(kind).graph.inputs}
        run.gains = {name: inputs.pop(f"gains.{name}") for name in usual}
        found = run(inputs)
        assert (found["state"], found["fault_code"]) == (float(row["state"]), float(row["fault_code"]))
        different = max(different, abs(found["command"] - float(row["command"])))
    assert different <= 1e-6


@pytest.mark.parametrize("kind", KINDS)
def test_in_single_precision_the_states_are_those_of_the_vectors_and_the_commands_close(kind, exported):
    text = structured_text(exported(kind).graph.in_single())
    assert not re.search(r"\bLREAL\b", text)
    different, usual = [], FunctionBlock(text)
    for row in csv.DictReader((exported(kind).folder / "vectors.csv").open()):
        if row["start"] == "1":
            run = copy.deepcopy(usual)
            run.stops = False
        inputs = {each.name: each.kind(float(row[each.name])) for each in exported(kind).graph.inputs}
        run.gains = {name: inputs.pop(f"gains.{name}") for name in usual.gains}
        found = run(inputs)
        assert (found["state"], found["fault_code"]) == (float(row["state"]), float(row["fault_code"]))
        different.append(abs(found["command"] - float(row["command"])))
    assert 0.0 < max(different) <= 10.0 * IN_SINGLE


@pytest.mark.parametrize("kind", ["flow_linearising", "ppo"])
def test_the_xml_holds_the_declarations_and_statements_of_the_text(kind, exported):
    space = "{http://www.plcopen.org/xml/tc6_0201}"
    folder = exported(kind).folder
    text = (folder / "controller.st").read_text() + (folder / "controller_call.st").read_text()
    project = ElementTree.fromstring((folder / "controller.xml").read_bytes())
    units = {unit.get("name"): unit for unit in project.iter(f"{space}pou")}
    assert [*units] == re.findall(r"^(?:FUNCTION|FUNCTION_BLOCK|PROGRAM) (\w+)", text, flags=re.MULTILINE)
    for name, unit in units.items():
        own = re.search(rf"^(?:FUNCTION|FUNCTION_BLOCK|PROGRAM) {name}\b.*?^END_(?:FUNC|PROG)", text, re.M | re.S)[0]
        body = "".join(unit.find(f"{space}body").itertext()).strip()
        assert own.rpartition("END_VAR\n")[2].strip().startswith(body)
        assert len(body) > 50
        plain = re.sub(r"\(\*.*?\*\)", "", own, flags=re.DOTALL).rpartition("END_VAR")[0]
        declared = re.findall(r"^    ([\w, ]+) : ", plain, flags=re.MULTILINE)
        assert [one.get("name") for one in unit.iter(f"{space}variable")] == [
            name for names in declared for name in names.split(", ")
        ]
        values = [one.get("value") for one in unit.iter(f"{space}simpleValue")]
        assert values == re.findall(r"TRUE|-?[\d.]+(?:E[-+]\d+)?", " ".join(re.findall(r":= ([^;]*);", plain)))
    types = {one.get("name") for one in project.iter(f"{space}dataType")}
    assert types < {one.get("name") for one in project.iter(f"{space}derived")} <= {*types, "Controller"}
    assert "CONSTANT" not in text or units["Controller"].find(f".//{space}localVars[@constant='true']") is not None


@pytest.mark.slow  # blark reads a thousand letters a second
@pytest.mark.parametrize("kind", KINDS)
def test_it_is_structured_text_by_the_grammar_of_others(kind, exported):
    parse = pytest.importorskip("blark.parse", reason="the extra 'dev' brings it").parse_source_code
    assert parse((exported(kind).folder / "controller.st").read_text()).exception is None


@pytest.mark.parametrize("kind", [*KINDS, "ppo"])
def test_it_keeps_the_rules_of_the_compilers_of_the_second_edition(kind, exported):
    """Each was found with MATIEC or STruC++, which take the text with these rules and give the commands of the vectors.

    STruC++ drops initial values of arrays in structures and global variables, and takes no global function block.
    """
    text = re.sub(
        r"\(\*.*?\*\)", "", (exported(kind).folder / "controller.st").read_bytes().decode("ascii"), flags=re.DOTALL
    )
    assert not re.search(r"END_(IF|FOR|STRUCT)(?!;)", text)
    assert not re.search(r"[\[,] *\(-", text)
    assert not re.search(r"TO 0 DO|VAR_TEMP|LINT|VAR_EXTERNAL", text)
    assert not re.search(r"ARRAY[^;]*:=", text.partition("END_TYPE")[0])
    assert max(abs(float(one)) for one in re.findall(r"\d+\.\d+(?:E[-+]\d+)?", text)) < 3.5e38
    declared = re.findall(r"^    (\w+) : (ARRAY\[0\.\.(\d+)\] OF )?(REAL|LREAL|DINT|BOOL)", text, flags=re.MULTILINE)
    names = {name.lower() for name, *_ in declared}
    assert not {name for name in names if name in RESERVED} - {gain.name for gain in exported(kind).graph.gains}
    whole = {name for name, array, *_ in declared if array}
    assert not re.search(rf"\b({'|'.join(whole)}) := ", text)
    inputs = text.partition("VAR_INPUT")[2].partition("END_VAR")[0]
    assert "ARRAY" not in inputs
    bytes_of = {"LREAL": 8, "REAL": 4, "DINT": 4, "BOOL": 1}
    instance = re.sub(r"VAR CONSTANT.*?END_VAR", "", text.partition("FUNCTION_BLOCK ")[2], flags=re.DOTALL)
    held = re.findall(r"^    \w+ : (?:ARRAY\[0\.\.(\d+)\] OF )?(REAL|LREAL|DINT|BOOL)", instance, flags=re.MULTILINE)
    assert sum((int(last or 0) + 1) * bytes_of[name] for last, name in held) <= 7_000  # and two rows of a product
    assert max(int(last) for last in re.findall(r"ARRAY\[0\.\.(\d+)\]", text)) < 1_000


@pytest.mark.parametrize(("largest", "abreast", "groups"), [(1000, 7, 1), (3000, 8, 2), (128, 1, 1)])
def test_functions_hold_the_weights_column_by_column_with_no_loop_over_one(
    exported, monkeypatch, largest, abreast, groups
):
    """MATIEC leaves out a loop from 0 to 0."""
    monkeypatch.setattr(writing, "LARGEST_TABLE", largest)
    graph = exported("ppo").graph
    text = structured_text(graph)
    assert "TO 0 DO" not in text
    matrix = next(node.operands[-1].table for node in graph.graph.nodes() if node.sizes == (1, 128, 128))
    found = np.zeros((128, 140), np.float32)
    for function in re.findall(r"^FUNCTION \w+Product.*?^END_FUNCTION", text, re.M | re.S):
        if "TO 127 DO" in function:
            numbers = np.array(
                re.findall(r"-?\d+\.\d+(?:E[-+]\d+)?", function.partition("[\n")[2].partition("]")[0]), np.float32
            )
            first = int(re.search(r"totals\[(\d+) \+", function)[1])
            parts = numbers.reshape(-1, 128, abreast)
            assert (len(parts) == groups) or first + numbers.size // 128 >= 128
            found[:, first : first + numbers.size // 128] = parts.swapaxes(0, 1).reshape(128, -1)
    np.testing.assert_array_equal(found[:, :128], matrix.reshape(128, 128))
    assert not found[:, 128:].any()


@pytest.mark.parametrize("kind", KINDS)
def test_a_gain_that_is_changed_acts_as_in_a_new_controller(kind, exported, block):
    graph = exported(kind).graph
    config, controller = graph.signals.config, graph.block.controller
    assert {gain.name for gain in graph.gains} >= ({"proportional"} if kind == "pid" else {"position_gain"})
    changed = block(kind)
    changed.gains = {name: 0.8 * value for name, value in changed.gains.items()}
    settings = controller.gains.model_dump() | changed.gains
    new, old = (
        controller_graph(make_controller(kind, config, s), config).block
        for s in (settings, controller.gains.model_dump())
    )
    env, memories, apart = ServoHydraulicVectorEnv(1, config), [None, None], 0.0
    env.reset(seed=[SEED], options={"reference": ["sine"]})
    for step in range(100):
        row = graph.signals.inputs_of(env.axes) | {"enable": True, "control": step > 0, "follow": True}
        (expected, memories[0]), (other, memories[1]) = new(row, memories[0]), old(row, memories[1])
        command = changed({**{each.name: each.default for each in graph.block.inputs}, **row})["command"]
        assert command == pytest.approx(expected["command"], abs=1e-6)
        apart = max(apart, abs(other["command"] - command))
        env.step(np.array([[command / 10.0]]))
    assert apart > 1e-3
