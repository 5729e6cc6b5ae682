"""``hydro leak-bound``: every number in its table, and one line for what is wrong."""

import pandas as pd
import pytest
from command_line import assert_one_clear_line, done, hydro

from hydro_env import TaskConfig
from hydro_rig.estimation.information import TASK
from hydro_rig.estimation.leak_bound import COLUMNS, sensor_choices


def test_leak_bound_writes_every_number_and_a_table(tmp_path):
    out = tmp_path / "out"
    options = ("--leak", 0, "--leak", 1, "--window", 0.2, "--window", 0.4, "--plants", 3)
    answer = done("leak-bound", *options, "--unknown", "valve.null_shift", "--output", out)
    table = pd.read_csv(out / "leak_bound.csv")
    assert tuple(table.columns) == COLUMNS
    # motions, leaks, plants, windows; six sets of unknowns, and the choices of sensors with one of them
    assert len(table) == 3 * 2 * 3 * 2 * (6 + len(sensor_choices(TaskConfig())) - 1)
    assert (table["sigma_lpm"] > 0.0).all()
    mine = table[
        (table["motion"] == "ordinary motion")
        & (table["leakage_flow_lpm"] == 1.0)
        & (table["unknowns"] == TASK)
        & (table["sensors"] == "all sensors")
    ]
    median = mine.groupby("window_s")["sigma_lpm"].median()
    assert median[0.4] < median[0.2]
    text = (out / "leak_bound.md").read_text(encoding="utf-8")
    assert f"{median[0.4]:.2g}" in text
    assert text.splitlines()[-1] in answer.stdout
    assert (out / "leak_bound.png").read_bytes().startswith(b"\x89PNG")
    assert_one_clear_line(hydro("leak-bound", "--output", out), "holds results already")


@pytest.mark.parametrize(
    ("options", "parts"),
    [
        (("--leak", -1), ("--leak -1", "within 0 to 20 l/min")),
        (("--window", 0.001), ("--window 0.001", "must be within")),
        (("--window", 1, "--window", 1), ("--window 1", "given twice")),
        (("--window", "nan"), ("--window nan",)),
        (("--unknown", "load.color"), ("load.color",)),
        (("--unknown", "load.mass"), ("load.mass", "among the unknowns of the task")),
        (("--controller", "nobody"), ("--controller nobody",)),
        (("--rig", "none.yaml"), ("none.yaml",)),
    ],
)
def test_leak_bound_refuses_in_one_line(tmp_path, options, parts):
    assert_one_clear_line(hydro("leak-bound", *options, "--output", tmp_path / "out"), *parts)
    assert not (tmp_path / "out").exists()
