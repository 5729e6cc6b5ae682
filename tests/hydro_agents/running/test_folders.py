"""Output folders: no file of anybody else's is ever replaced, and one process writes at a time."""

import json
import subprocess
import sys

import pytest
from refusal import refused

from hydro_agents.running.folders import MANIFEST_FILE, output_folder

FILES = ("a.csv", "tables/*.csv", "b.csv")


def write(folder, *names, job="study", writes=FILES, text="ours", **options):
    with output_folder(folder, job, writes, **options):
        for name in names:
            (folder / name).parent.mkdir(exist_ok=True)
            (folder / name).write_text(text)


def listed(folder):
    return json.loads((folder / MANIFEST_FILE).read_text())["files"]


def test_results_are_listed_and_replaced_only_on_request(tmp_path):
    folder = tmp_path / "new" / "out"
    write(folder, "a.csv", "tables/1.csv")
    assert listed(folder) == {"study": ["a.csv", "tables/1.csv"]}
    with refused("holds results already .*--overwrite"):
        write(folder)
    with refused("--resume"):
        write(folder, resume=False)
    with refused("exclude each other"):
        write(folder, resume=True, overwrite=True)
    write(folder, "b.csv", resume=True)
    assert set(listed(folder)["study"]) == {"a.csv", "b.csv", "tables/1.csv"}
    write(folder, "b.csv", overwrite=True, text="new")
    assert listed(folder) == {"study": ["b.csv"]}
    assert not (folder / "a.csv").exists()
    assert (folder / "b.csv").read_text() == "new"


@pytest.mark.parametrize("options", [{}, {"overwrite": True}, {"resume": True}])
@pytest.mark.parametrize("name", ["a.csv", "tables/mine.csv"])
def test_a_file_of_the_user_is_never_replaced(tmp_path, name, options):
    (tmp_path / "tables").mkdir()
    (tmp_path / name).write_text("mine")
    with refused(f"{name}: was not written by hydro"):
        write(tmp_path, name, **options)
    (tmp_path / name).rename(tmp_path / "kept")
    write(tmp_path, "b.csv")
    (tmp_path / "kept").rename(tmp_path / name)
    with refused(f"{name}: was not written by hydro"):
        write(tmp_path, name, **options)
    assert (tmp_path / name).read_text() == "mine"


KILLED = """
import sys, os
from pathlib import Path
from hydro_agents.running.folders import output_folder
with output_folder(Path(sys.argv[1]), "study", ["a.csv", "tables/*.csv"]) as folder:
    (folder / "a.csv").write_text("ours")
    os._exit(9)
"""


def test_a_killed_process_leaves_its_results_and_their_list(tmp_path):
    subprocess.run([sys.executable, "-c", KILLED, str(tmp_path)], check=False)
    with refused("holds results already"):
        write(tmp_path, "a.csv")
    write(tmp_path, "b.csv", resume=True)
    assert listed(tmp_path) == {"study": ["a.csv", "b.csv"]}
