"""``hydro train KIND``: writes the gains, resumes, refuses what does not fit in one line."""

import pytest
import yaml

from hydro_agents.commands.study import Objective, train
from hydro_agents.controllers.registry import CONTROLLERS, make_controller
from hydro_env import ConfigurationError, TaskConfig
from hydro_env.files import read_yaml


@pytest.fixture
def study(tmp_path):
    file = tmp_path / "study.yaml"
    file.write_text(yaml.safe_dump({"task": {"episode_duration": 0.3}, "controllers": {"PID": {"kind": "pid"}}}))
    return file


@pytest.mark.parametrize("kind", CONTROLLERS)
def test_every_kind_is_tuned_and_resumed(kind, study, tmp_path):
    folder = tmp_path / "out"
    train(kind, folder, study, evaluations=14)
    first = (folder / f"{kind}.yaml").read_text()
    make_controller(kind, TaskConfig(), read_yaml(folder / f"{kind}.yaml"))
    train(kind, folder, study, evaluations=14, resume=True)  # nothing is left to do
    assert (folder / f"{kind}.yaml").read_text() == first
    train(kind, folder, study, evaluations=28, resume=True)
    assert len((folder / "tuning.csv").read_text().splitlines()) == 2 + 28


def test_what_does_not_fit_is_told_and_nothing_is_lost(study, tmp_path):
    folder = tmp_path / "out"
    train("pid", folder, study, evaluations=14)
    before = {path.name: path.read_bytes() for path in folder.iterdir()}
    wrong = tmp_path / "wrong.yaml"
    wrong.write_text("proportional: -3\n")
    for options, message in (
        ({}, "holds results already"),
        ({"resume": True, "objective": Objective.MEAN}, "was written with another objective"),
        ({"resume": True, "seed": 5}, "was written with another seed"),
        ({"resume": True, "start": wrong}, r"wrong\.yaml: line 1: proportional = -3"),
    ):
        with pytest.raises(ConfigurationError, match=message) as raised:
            train("pid", folder, study, evaluations=14, **options)
        assert "\n" not in str(raised.value)
        assert {path.name: path.read_bytes() for path in folder.iterdir()} == before
