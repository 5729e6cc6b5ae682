"""Exported folders, made once for all tests of this room."""

import copy
import functools
from pathlib import Path
from typing import NamedTuple

import pytest
from structured_text import FunctionBlock

from hydro_agents.controllers.base import Controller
from hydro_agents.learning.loading import load_controller
from hydro_agents.rigs.rig_file import answers_from, new_rig
from hydro_env import TaskConfig
from hydro_rig.export.controller import ControllerGraph, controller_graph
from hydro_rig.export.controller_folder import exported_files

TASK = TaskConfig(episode_duration=0.6)
NAMEPLATES = {
    "bore": "63 mm",
    "rod": "36 mm",
    "stroke": "500 mm",
    "rated_flow": "40 l/min",
    "bandwidth": "60 Hz",
    "supply_pressure": "160 bar",
    "mass": "200 kg",
}


class Exported(NamedTuple):
    """A controller, its graph and its folder."""

    controller: Controller
    graph: ControllerGraph
    folder: Path
    report: list[str]


@pytest.fixture(scope="session")
def exported(tmp_path_factory):
    """A function: the export of a kind of controller, for a short task."""

    @functools.cache
    def export(kind):
        controller = load_controller(kind, TASK, kind)
        files, report = exported_files(controller, TASK, "hydro export")
        folder = tmp_path_factory.mktemp(kind)
        for name, content in files.items():
            (folder / name).write_bytes(content)
        return Exported(controller, controller_graph(controller, TASK), folder, report)

    return export


@pytest.fixture(scope="session")
def other_rig(tmp_path_factory):
    """The file of a rig from its nameplates, which nobody tuned."""
    file = tmp_path_factory.mktemp("rig") / "my.yaml"
    file.write_text(new_rig(answers_from(NAMEPLATES), "my.yaml")[0], encoding="utf-8")
    return file


@pytest.fixture(scope="session")
def block(exported):
    """A function: the function block of a kind of controller, parsed once, with the memory of a new one."""
    parsed = functools.cache(lambda kind: FunctionBlock((exported(kind).folder / "controller.st").read_text()))
    return lambda kind: copy.deepcopy(parsed(kind))
