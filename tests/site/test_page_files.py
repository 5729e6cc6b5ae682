"""The files that the pages show, YAML and C: each is read, or compiled, by what it is meant for."""

import re
import subprocess
from pathlib import Path

import pytest
import yaml

from hydro_agents.evaluation.leak_protocol import LeakProtocol
from hydro_agents.evaluation.robustness_protocol import RobustnessProtocol
from hydro_agents.learning.loading import load_controller
from hydro_agents.study.settings import StudySettings
from hydro_env import ServoHydraulicEnv, TaskConfig
from hydro_rig.export.c_files import c_compiler
from hydro_rig.export.controller_folder import exported_files
from hydro_rig.recordings.columns import read_map

ROOT = Path(__file__).parents[2]
FENCE = re.compile(r"^```(\w+)\n(.*?)^```$", flags=re.MULTILINE | re.DOTALL)
BLOCKS = [
    (page.name, kind, body)
    for page in sorted((ROOT / "docs").rglob("*.md"))
    for kind, body in FENCE.findall(page.read_text(encoding="utf-8"))
    if kind in ("yaml", "c")
]


def blocks(page, kind):
    return [body for name, what, body in BLOCKS if (name, what) == (page, kind)]


def test_every_block_has_a_test():
    tested = {("circuit.md", "yaml")} | {  # tests/site/test_circuit_page.py
        ("own_rig.md", "yaml"),
        ("diagnose.md", "yaml"),
        ("trend.md", "yaml"),
        ("robustness.md", "yaml"),
        ("results.md", "yaml"),
        ("learning.md", "yaml"),
        ("export.md", "c"),
    }
    assert {(page, kind) for page, kind, _ in BLOCKS} == tested


@pytest.mark.parametrize("text", blocks("own_rig.md", "yaml"))
def test_the_file_of_a_rig_makes_an_environment(text, tmp_path):
    file = tmp_path / "rig.yaml"
    file.write_text(text, encoding="utf-8")
    given = yaml.safe_load(text)
    env = ServoHydraulicEnv(rig=str(file))
    env.reset(seed=1)
    if "sensors" in given:
        assert env.config.sensors.pressure_a.high == 250e5
        assert not any("spool" in name for name in env.observation_names)
    assert set(given.get("randomisation", {})) <= set(env.config.randomisation)


def test_maps_of_columns_read_files(tmp_path):
    file, maps = tmp_path / "map.yaml", []
    for text in (*blocks("trend.md", "yaml"), *blocks("diagnose.md", "yaml")):
        file.write_text(text, encoding="utf-8")
        maps.append(read_map(file).columns())
    historian, whole, names = maps
    assert (historian["time"].unit, historian["oil_temperature"].column) == ("ns", "oil")
    assert names["pressure_b"].column == "Druck B"
    assert whole["command"].rows_early == 1
    assert (whole["position"].offset, whole["spool_position"].gain) == (-200.0, 0.125)


@pytest.fixture
def with_lines(tmp_path):
    """Write a shipped protocol with more lines beside links to what it names."""
    (tmp_path / "agents").symlink_to(ROOT / "configs" / "agents")
    (tmp_path / "protocols").mkdir()

    def write(name, change):
        shipped = yaml.safe_load((ROOT / "configs" / "protocols" / f"{name}.yaml").read_text(encoding="utf-8"))
        file = tmp_path / "protocols" / "mine.yaml"
        file.write_text(yaml.safe_dump(shipped | change(shipped)), encoding="utf-8")
        return file

    return write


def test_the_condition_belongs_into_a_protocol(with_lines):
    (text,) = blocks("robustness.md", "yaml")
    ((name, condition),) = yaml.safe_load(text).items()

    def change(shipped):
        assert condition["controllers"].items() <= shipped["conditions"][name]["controllers"].items()
        return {"conditions": {name: condition}}

    protocol = RobustnessProtocol.from_yaml(with_lines("robustness", change))
    assert protocol.conditions[name].task == condition["task"]


def test_the_detector_belongs_into_the_leak_protocol(with_lines):
    (text,) = blocks("results.md", "yaml")
    own = yaml.safe_load(text)["detectors"]
    file = with_lines("leakage", lambda shipped: {"detectors": shipped["detectors"] | own})
    assert LeakProtocol.from_yaml(file).detectors["mine"].windows == 1000


def test_the_lines_of_c_compile(tmp_path):
    if c_compiler() is None:
        pytest.skip("this machine has no C compiler")
    task = TaskConfig()
    files, _ = exported_files(load_controller("pid", task, "PID"), task, "hydro export pid")
    for name, content in files.items():
        (tmp_path / name).write_bytes(content)
    (text,) = blocks("export.md", "c")
    include, *lines = text.splitlines()
    program = [include, "int main(void) {", *lines, "return voltage != voltage;", "}"]
    code = "\n".join(program).replace("[CONTROLLER_SIGNALS];", "[CONTROLLER_SIGNALS] = {0};")
    (tmp_path / "page.c").write_text(code)
    command = [c_compiler(), "-std=c99", "-Wall", "-Werror", "page.c", "controller.c", "-o", "page", "-lm"]
    result = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert result.returncode == 0, result.stderr
    assert subprocess.run([tmp_path / "page"], check=False).returncode == 0


def test_the_trainings_of_the_page_are_a_study(tmp_path):
    file = tmp_path / "study.yaml"
    file.write_text(blocks("learning.md", "yaml")[0], encoding="utf-8")
    study = StudySettings.from_yaml(file)
    preview = study.controllers["with full preview"].settings
    assert (preview.full_preview, preview.total_steps, preview.discount) == (True, 1_000_000, 0.97)
