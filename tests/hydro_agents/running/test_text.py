"""Numbers, durations, names and tables as a person writes them."""

from hydro_agents.running.text import duration, markdown, number


def test_numbers_and_names_as_a_person_writes_them():
    assert [number(x) for x in (0.0, 1234.5, 12.345, 0.98765, 0.001234)] == ["0", "1234", "12.3", "0.988", "0.00123"]
    assert [number(float("nan")), number(0.0000123), number(948.14, digits=4)] == ["–", "0.0000123", "948.1"]
    assert [number(-12.3), number(-0.0004, 2), number(-0.0)] == ["−12.3", "0.00", "0"]
    assert [duration(x) for x in (1.25, 75.0, 3725.0)] == ["1.2 s", "1 min 15 s", "1 h 2 min"]
    assert markdown(["a|b", "mm"], [["x", "1"]]) == "| a\\|b | mm |\n|---|---:|\n| x | 1 |"
