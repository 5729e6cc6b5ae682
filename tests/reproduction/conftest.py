"""The figures of the paper's rig, made once for all tests of this folder."""

import pytest

from agents.commands import reproduce as command


@pytest.fixture(scope="package")
def folder(tmp_path_factory):
    path = tmp_path_factory.mktemp("reproduce") / "new"
    command.reproduce_to_folder(path, overwrite=False)
    return path
