"""The table of the benchmark: medians, ratios within a round, files, going on, refusing."""

import copy

import numpy as np
import pandas as pd
import pytest
from command_line import hydro
from refusal import refused

from benchmarks import run as command
from benchmarks.run import benchmark_to_folder, measure_group
from benchmarks.table import Case, Row, UnavailableError, figure, markdown_table, ratios, write_csv
from hydro_agents.running.console import ProgressDisplay


def peer_and_own():
    peer = Row("peer", "steps/s", group="g", values=[100.0, 200.0, 400.0])
    return [peer, Row("own", "steps/s", "peer", "a note", "g", [300.0, 400.0, 4000.0])]


def test_ratio_is_taken_run_by_run():
    results = peer_and_own()
    assert ratios(results[1], results) == [3.0, 2.0, 10.0]
    assert ratios(results[0], results) == []


def test_markdown_holds_median_range_and_ratio():
    text = markdown_table(peer_and_own(), "g")
    assert "| own | steps/s | 400 | 300–4,000 | 3 | 3.00 × peer (2.00–10.0) | a note |" in text
    assert len(text.splitlines()) == 4


def test_a_row_without_values_says_why():
    missing = Row("motor", "steps/s", note="not installed: no module", group="g")
    assert "| motor | steps/s | – | – | 0 |  | not installed: no module |" in markdown_table([missing], "g")


def test_csv_holds_every_value(tmp_path):
    write_csv(tmp_path / "t.csv", [*peer_and_own(), Row("motor", "steps/s", group="g")])
    peer, own, motor = pd.read_csv(tmp_path / "t.csv").to_dict("records")
    assert own["values"] == "300.0 400.0 4000.0"
    assert (own["median"], own["ratio"]) == (400.0, 3.0)
    assert np.isnan(peer["ratio"])
    assert np.isnan(motor["median"])


@pytest.mark.parametrize(
    ("value", "text"), [(0.0, "0"), (93_572.6, "93,573"), (123.4, "123"), (0.6712, "0.671"), (1e-7, "1.00e-07")]
)
def test_figures_are_short(value, text):
    assert figure(value) == text


def groups_of(monkeypatch, **cases):
    monkeypatch.setattr(command, "GROUPS", {n: (n, lambda extent, c=c: copy.deepcopy(c)) for n, c in cases.items()})


def case(name, measure, runs=3):
    return Case([Row(name, "s")], measure, runs)


def unavailable(run):
    raise UnavailableError("not installed: nothing there")


def test_cases_run_in_turn():
    order = []
    cases = [case(name, lambda run, name=name: (order.append(name) or 1.0,)) for name in "ab"]
    measure_group("g", cases, [], ProgressDisplay())
    assert "".join(order) == "ababab"


def test_ctrl_c_keeps_what_was_measured(tmp_path, monkeypatch):
    def stopped(run):
        if run == 2:
            raise KeyboardInterrupt
        return (1.0,)

    first = [case("one", lambda run: (run + 1.0,)), case("absent", unavailable)]
    groups_of(monkeypatch, first=first, second=[case("two", stopped)])
    with pytest.raises(KeyboardInterrupt):
        benchmark_to_folder(tmp_path, [], True, False, "hydro benchmark")
    table = pd.read_csv(tmp_path / "benchmark.csv", keep_default_na=False).set_index("row")
    assert dict(table["values"]) == {"one": "1.0 2.0 3.0", "absent": "", "two": "1.0 1.0"}
    assert "nothing there" in table.loc["absent", "note"]
    assert "## first" in (tmp_path / "benchmark.md").read_text(encoding="utf-8")
    with refused("holds results already"):
        benchmark_to_folder(tmp_path, [], True, False, "hydro benchmark")


def test_help_names_every_group():
    shown = hydro("benchmark", "--help").stdout
    assert all(name in shown for name in command.GROUPS)
