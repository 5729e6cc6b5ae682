"""The time that is left, from made-up work whose rates are known."""

import pytest

from hydro_agents.running.pace import Pace, in_words


def test_no_rate_no_time():
    pace = Pace()
    pace.update("one", 0, 10, 0.0)
    assert pace.left("one", 1.0) is None
    pace.update("one", 1, 10, 5.0)
    assert pace.left("one", 5.0) is None, "what came before the first piece may be compilation"
    pace.update("one", 2, 10, 6.0)
    assert pace.left("one", 6.0) == pytest.approx(8.0)
    assert pace.left("one", 6.5) == pytest.approx(7.5)
    assert pace.left("one", 99.0) == 0.0
    pace.update("one", 10, 10, 20.0)
    assert pace.left("one", 21.0) == 0.0
    assert pace.left_in_all(20.0) is None


def test_a_resumed_phase_counts_what_it_does_itself():
    pace = Pace()
    for done, now in ((80, 0.0), (81, 3.0), (82, 4.0), (84, 6.0)):
        pace.update("one", done, 100, now)
    assert pace.left("one", 6.0) == pytest.approx(16.0)


def test_phases_to_come_take_the_rate_of_those_that_ran():
    pace = Pace({"one": 10.0, "two": 30.0, "three": 5.0})
    assert pace.left_in_all(0.0) is None
    for done in range(11):
        pace.update("one", done, 10, 2.0 * done)
    assert pace.left_in_all(20.0) == pytest.approx(2.0 * 35.0)
    assert pace.done_in_all() == pytest.approx(10.0 / 45.0)
    for done in range(3):  # it is slower than its work says: its own rate counts, and weighs in that of the last
        pace.update("two", done, 4, 20.0 + 30.0 * done)
    assert pace.left_in_all(80.0) == pytest.approx(60.0 + 5.0 * 140.0 / 40.0)
    pace.update("beside the plan", 0, 1, 80.0)
    assert pace.done_in_all() == pytest.approx(25.0 / 45.0)


def test_a_long_piece_tells_the_rate_by_itself():
    pace = Pace()
    pace.update("ladder", 0, 15, 0.0)
    pace.update("ladder", 1, 15, 100.0)
    assert pace.left("ladder", 100.0) == pytest.approx(1400.0)


def test_a_phase_of_one_piece_has_a_rate_when_it_is_finished():
    pace = Pace({"one": 1.0, "two": 2.0})
    pace.update("one", 0, 400, 0.0)
    assert pace.left_in_all(3.0) is None
    pace.update("one", 400, 400, 5.0)
    assert pace.left_in_all(5.0) == pytest.approx(10.0)


@pytest.mark.parametrize(
    ("seconds", "words"),
    [(0.2, "5 s"), (42.0, "40 s"), (57.0, "55 s"), (59.0, "1 min"), (500.0, "8 min"), (3595.0, "1 h"),
     (4700.0, "1 h 20 min"), (7199.0, "2 h")],
)  # fmt: skip
def test_times_in_round_numbers(seconds, words):
    assert in_words(seconds) == words
