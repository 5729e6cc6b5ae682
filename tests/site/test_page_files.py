"""The files that the pages show, YAML and C: each is read, or compiled, by what it is meant for."""

import re
import subprocess
from pathlib import Path

import numpy as np
import pytest
import yaml

from hydro_agents.evaluation.leak_protocol import LeakProtocol
from hydro_agents.evaluation.study import StudySettings
from hydro_agents.learning.loading import load_controller
from hydro_env import PlantParameters, ServoHydraulicEnv, TaskConfig, simulate
from hydro_env.plant.parameters import PARAMETER_PATHS
from hydro_env.plant.workable import refuse_unworkable
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


def blocks(page, kind="yaml", begins=""):
    return [body for name, what, body in BLOCKS if (name, what) == (page, kind) and body.startswith(begins)]


def written(text, folder):
    (folder / "file.yaml").write_text(text, encoding="utf-8")
    return folder / "file.yaml"


def test_every_block_has_a_test():
    tested = {(f"{page}.md", "yaml") for page in ("own_rig", "diagnose", "trend", "own_controller", "learning")}
    assert {(page, kind) for page, kind, _ in BLOCKS} == tested | {("export.md", "c")}


@pytest.mark.parametrize("text", [text for text in blocks("own_rig.md") if not text.startswith("# task:")])
def test_a_rig_of_the_page_runs(text, tmp_path):
    file, given = written(text, tmp_path), yaml.safe_load(text)
    if not {"sensors", "randomisation"} & set(given):
        plant = PlantParameters.from_yaml(file)
        refuse_unworkable(plant)
        run = simulate(plant, np.repeat([4.0, 0.0, -4.0], 10), 5e-3)
        assert run.position.max() - run.position[0] > 2e-3
    env = ServoHydraulicEnv(rig=str(file))
    env.reset(seed=1)
    if "sensors" in given:
        assert env.config.sensors.pressure_a.high == 250e5
        assert not any("spool" in name for name in env.observation_names)


def test_the_tasks_of_the_page_are_what_they_are_called(tmp_path):
    def task(name):
        (text,) = blocks("own_rig.md", begins=f"# task: {name}")
        return TaskConfig.from_yaml(written(text, tmp_path))

    env = ServoHydraulicEnv(task("another circuit, nothing drawn"))
    env.reset(seed=1)
    assert env.parameters.replace(leakage={"internal_resistance": 2e13}) == env.config.plant
    env = ServoHydraulicEnv(task("leak through the throttle, exact sensors, no latency"))
    observation, info = env.reset(seed=1)
    assert env.parameters.leakage.orifice_gain > 0.0
    column = env.observation_names.index("position")
    assert observation[column] * env.observation_scale[column] == pytest.approx(info["position"], abs=1e-8)
    poor = task("a poorer position sensor").sensors
    assert (poor.position.noise, poor.position.high) == (1e-4, TaskConfig().sensors.position.high)
    assert len(blocks("own_rig.md", begins="# task:")) == 3


def test_the_parts_of_the_circuit_name_fields_that_exist():
    page = (ROOT / "docs" / "own_rig.md").read_text(encoding="utf-8").partition("## The parts of the circuit")[2]
    named = set(re.findall(r"`((?:supply|valve|cylinder|lines|fluid|load|leakage)\.[a-z_]+)", page))
    assert 30 < len(named & set(PARAMETER_PATHS)) == len(named)


def test_maps_of_columns_read_files(tmp_path):
    historian, whole, names = [
        read_map(written(text, tmp_path)).columns()
        for text in (*blocks("trend.md"), *blocks("diagnose.md"))
        if "axes:" not in text  # a fleet
    ]
    assert (historian["time"].unit, historian["oil_temperature"].column) == ("ns", "oil")
    assert names["pressure_b"].column == "Druck B"
    assert whole["command"].rows_early == 1
    assert (whole["position"].offset, whole["spool_position"].gain) == (-200.0, 0.125)


def test_the_detector_belongs_into_the_leak_protocol(tmp_path):
    (tmp_path / "agents").symlink_to(ROOT / "configs" / "agents")
    (tmp_path / "protocols").mkdir()
    shipped = yaml.safe_load((ROOT / "configs" / "protocols" / "leakage.yaml").read_text(encoding="utf-8"))
    shipped["detectors"] |= yaml.safe_load(blocks("own_controller.md")[0])["detectors"]
    protocol = LeakProtocol.from_yaml(written(yaml.safe_dump(shipped), tmp_path / "protocols"))
    assert protocol.detectors["mine"].windows == 1000


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
    (tmp_path / "page.c").write_text("\n".join(program))
    command = [c_compiler(), "-std=c99", "-Wall", "-Werror", "page.c", "controller.c", "-o", "page", "-lm"]
    result = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert result.returncode == 0, result.stderr
    assert subprocess.run([tmp_path / "page"], check=False).returncode == 0


def test_the_trainings_of_the_page_are_those_of_a_study(tmp_path):
    practice, study = (yaml.safe_load(text) for text in blocks("learning.md"))
    study["controllers"]["mine"] = {"kind": "ppo", "corrects": "PID", "settings": practice}
    found = StudySettings.from_yaml(written(yaml.safe_dump(study), tmp_path)).controllers
    assert found["with full preview"].settings.full_preview
    assert found["mine"].settings.practice["disturbance"]["share"] == 0.3
