"""The page, made once for all tests of this folder, with fewer leaks where they cost seconds."""

from functools import partial

import pytest

from paper import run as command
from paper.settling import friction_scan_table, settling_table

QUICK = {
    "fig13_settling_time": partial(settling_table, leaks=(0.01, 0.1, 1.0, 4.0)),
    "friction_scan": partial(friction_scan_table, leaks=(0.01, 1.0), shares=(0.0, 0.02, 0.2, 1.0)),
}


@pytest.fixture(scope="package")
def folder(tmp_path_factory):
    path = tmp_path_factory.mktemp("reproduce") / "new"
    quick = tuple(entry._replace(compute=QUICK.get(entry.key, entry.compute)) for entry in command.FIGURES)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(command, "FIGURES", quick)
        command.reproduce_to_folder(path, overwrite=False)
    return path
