"""docs/your_rig.md, from nameplates to a verdict: the commands run as printed, and the truth is found."""

import re
import shlex
import shutil
from pathlib import Path

import pytest
from command_line import hydro

from hydro_env.files import read_json
from hydro_env.task.rig import read_rig

DOCS = Path(__file__).parents[2] / "docs"
PAGE = (DOCS / "your_rig.md").read_text(encoding="utf-8").replace("\\\n", "")
STEPS = {
    shlex.split(command)[1]: (shlex.split(command)[1:], printed.splitlines())
    for command, printed in re.findall(r"^```\n\$ ([^\n]+)\n(.*?)```$", PAGE, flags=re.M | re.S)
}
"""Arguments and printed lines of each command of the page, by name."""


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """An empty current folder beside the hidden rig."""
    shutil.copy(DOCS / "hidden_rig.yaml", tmp_path)
    monkeypatch.chdir(tmp_path)
    return tmp_path


def run(name, printed=True):
    """Run a command of the page; every line that the page shows must come out, up to spaces."""
    arguments, shown = STEPS[name]
    answer = hydro(*arguments)
    assert answer.returncode == 0, answer.stderr
    said = " ".join(answer.stdout.split())
    for line in shown if printed else []:
        assert " ".join(line.split()) in said, (line, answer.stdout)
    return answer


def test_the_figures_and_the_recording_come_out_as_printed(folder):
    assert list(STEPS) == ["new-rig", "check-rig", "record", "identify", "study", "export", "diagnose"]
    run("new-rig")
    assert read_rig("known.yaml").plant.valve.rated_flow == pytest.approx(19e-3 / 60)
    run("record")
    heading = (folder / "lab.csv").read_text().splitlines()[1]
    assert heading == "time [s],position [mm],pressure_a [bar],pressure_b [bar],spool_position [%],command [V]"


@pytest.mark.slow
def test_the_whole_way_finds_the_truth(folder):
    run("new-rig")
    run("check-rig", printed=False)
    run("record")
    run("identify", printed=False)
    truth, rough = read_rig("hidden_rig.yaml").plant, read_rig("known.yaml").plant
    found = read_json(folder / "found" / "identification.json")
    assert found["held_back"]["together"]["position_share_of_variance"] > 0.99
    right = []
    for path, unknown in found["unknowns"].items():
        if "." not in path or path.startswith("start.") or not unknown["determined"]:
            continue
        group, field = path.split(".")
        true = getattr(getattr(truth, group), field)
        if path == "load.mass":  # the sum counts
            true += truth.cylinder.piston_mass - rough.cylinder.piston_mass
        right.append(unknown["low"] <= true <= unknown["high"])
    assert len(right) >= 12
    assert sum(right) >= 0.8 * len(right)
    assert found["unknowns"]["leakage_flow_lpm"]["value"] == pytest.approx(0.3, abs=0.02)
    run("study", printed=False)
    assert run("diagnose", printed=False).stdout.splitlines()[-1].startswith("internal leak of 0.3")
    run("export")
    assert (folder / "export" / "controller.c").is_file()
