import ast
from itertools import pairwise
from pathlib import Path

from refusal import refused

from hydro_agents.running.seeds import LEDGER, TEST_SEEDS, TRAINING_SEEDS, VALIDATION_SEEDS, SeedRange

ROOT = Path(__file__).resolve().parents[3]
LEDGER_FILE = ROOT / "agents/hydro_agents/running/seeds.py"
SOURCES = [
    file
    for folder in ("agents", "benchmarks", "challenge")
    for file in sorted((ROOT / folder).rglob("*.py"))
    if file != LEDGER_FILE
]
SETS = {"TRAINING_SEEDS": TRAINING_SEEDS, "VALIDATION_SEEDS": VALIDATION_SEEDS, "TEST_SEEDS": TEST_SEEDS}
CALCULATED = (ast.BinOp, ast.AugAssign, ast.Subscript)


def test_ranges_of_seeds_are_disjoint_and_lie_within_training_validation_or_test():
    rows = sorted(LEDGER.values())
    for row, after in pairwise(rows):
        assert row.first + row.count <= after.first, (row, after)
    for row in rows:
        own = row.take(row.count)
        assert any(own[0] in every and own[-1] in every for every in SETS.values()), row
    assert TRAINING_SEEDS.stop <= VALIDATION_SEEDS.start
    assert VALIDATION_SEEDS.stop <= TEST_SEEDS.start


def test_a_range_gives_no_more_seeds_than_it_holds():
    seeds = SeedRange(100, 10, "a test")
    assert list(seeds.take(3, 7)) == [107, 108, 109]
    with refused("11 seeds are needed, but there are 10 for a test"):
        seeds.take(4, 7)
    assert [seeds.training(number, 3).start for number in range(4)] == [100, 103, 106, 102]
    assert set(seeds.training(12345, 3)) <= set(seeds.take(10))
    assert seeds.training(5, 10) == range(100, 110)


def test_seeds_are_counted_in_the_ledger_alone():
    """No other file adds to the first seed of a range, or cuts a piece out of one of the three sets."""
    found = []
    for file in SOURCES:
        text = file.read_text(encoding="utf-8")
        if not any(name in text for name in (*LEDGER, *SETS)):
            continue
        for node in ast.walk(ast.parse(text)):
            if isinstance(node, CALCULATED) and any(_is_of_the_ledger(part) for part in ast.walk(node)):
                found.append(f"{file.relative_to(ROOT)}:{node.lineno}: {ast.unparse(node)}")
    assert found == []


def _is_of_the_ledger(node: ast.AST) -> bool:
    if isinstance(node, ast.Name):
        return node.id in SETS
    named = isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name)
    return named and node.attr in ("first", "start", "stop") and node.value.id in {*LEDGER, *SETS}
