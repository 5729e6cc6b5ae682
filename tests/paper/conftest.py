"""The page of the paper's rig, made once for all tests of this folder, with fewer leaks where they cost seconds."""

from functools import partial

import pytest

from paper import run as command
from paper.sensitivity import RESULTS, sensitivity_table
from paper.settling import friction_scan_table, settling_table

QUICK = {
    "fig13_settling_time": partial(settling_table, leaks=(0.01, 1.0, 4.0)),
    "sensitivity": partial(
        sensitivity_table, results=tuple(result for result in RESULTS if not result.name.startswith("settling"))
    ),
    "friction_scan": partial(friction_scan_table, leaks=(0.01, 1.0), shares=(0.0, 0.02, 0.2, 1.0)),
}


@pytest.fixture(scope="package")
def quick_figures():
    """The figures of the page, quick to compute."""
    return tuple(entry._replace(compute=QUICK.get(entry.key, entry.compute)) for entry in command.FIGURES)


@pytest.fixture(scope="package")
def folder(tmp_path_factory, quick_figures):
    path = tmp_path_factory.mktemp("reproduce") / "new"
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(command, "FIGURES", quick_figures)
        command.reproduce_to_folder(path, overwrite=False)
    return path
