"""Configuration files and JSON: what is read, and the one line that answers every attack."""

import pytest
from refusal import refused

from hydro_env import ConfigurationError
from hydro_env.files import LARGEST_FILE, Group, read_json, read_text, read_yaml, validate
from hydro_env.units import Number

NESTED = "a0: &a0 [1, 1]\n" + "\n".join(f"a{n}: &a{n} [*a{n - 1}, *a{n - 1}]" for n in range(1, 40))
YAML = [
    (NESTED, "or one within an anchor"),
    ("a: &a [*a]", "or one within an anchor"),
    ("a: &a 1\nb: [" + "*a, " * 101 + "]", "more than 100 aliases"),
    ("a: " + "[" * 90_000, "maximum recursion depth"),
    ("load: {mass: 1}\nload: {mass: 2}", "line 2: the key 'load' stands here twice"),
    ("a: " + "9" * 5000, "not valid YAML: Exceeds the limit"),
    ("a: !!python/object/apply:os.system [ls]", "could not determine a constructor"),
    ("7: 1", "7 is a key: keys must be text"),
    ("- 1", "must be a mapping of settings, not list"),
]
JSON = [
    ('{"a": ', "not valid JSON in line 1"),
    ("[" * 90_000, "maximum recursion depth"),
    ('{"a": 1, "a": 2}', "a key stands twice"),
    ("[1]", "must be a mapping of settings, not list"),
]
HOSTILE = [(read, *case) for read, cases in ((read_yaml, YAML), (read_json, JSON)) for case in cases]


@pytest.mark.parametrize(("read", "content", "message"), HOSTILE, ids=[message for *_, message in HOSTILE])
def test_a_hostile_file_is_refused_with_one_line(tmp_path, read, content, message):
    file = tmp_path / "hostile"
    file.write_text(content)
    with refused(f"^{file}: .*{message}"):
        read(file)


def test_a_path_with_a_zero_byte_is_refused(tmp_path):
    with refused(r"a\\x00b': cannot be read: no path holds a zero byte"):
        read_text(tmp_path / "a\0b")


def test_numbers_and_dates_of_yaml(tmp_path):
    (tmp_path / "a.yaml").write_text("a: 1e5\nb: -2.5E-3\nc: 2024-13-45\nd: &d [1]\ne: *d\nf: .5e1\ng: e5\n")
    values = read_yaml(tmp_path / "a.yaml")
    assert values == {"a": 1e5, "b": -2.5e-3, "c": "2024-13-45", "d": [1], "e": [1], "f": 5.0, "g": "e5"}


def test_large_files_and_files_that_are_no_text(tmp_path):
    for read in (read_yaml, read_json, read_text):
        with refused(r"larger than 0\.1 MB"):
            read("/dev/zero")  # without end
        (tmp_path / "latin").write_bytes("größe".encode("latin-1"))
        with refused("not a text in UTF-8"):
            read(tmp_path / "latin")
        with refused("Is a directory"):
            read(tmp_path)
    (tmp_path / "largest").write_bytes(b"x" * LARGEST_FILE)
    assert len(read_text(tmp_path / "largest")) == LARGEST_FILE
    (tmp_path / "marked.yaml").write_bytes(b"\xef\xbb\xbfa: 1")  # as Windows writes it
    assert read_yaml(tmp_path / "marked.yaml") == {"a": 1}


class Settings(Group):
    whole: int = 1
    share: float = 0.5
    switch: bool = True
    name: str = "a"
    known: dict[str, Number] = {}


@pytest.mark.parametrize(
    ("model", "values", "message"),
    [
        (Settings, {"whole": True}, "whole = true: must be a number, not true/false"),
        (Settings, {"known": {"a": True}}, "known.a = true: must be a number, not true/false"),
        (Settings, {"switch": 7}, "switch = 7: must be a valid boolean"),
        (Settings, {"name": 7}, "name = 7: must be a valid string"),
        (Settings, {"frameskip": 1}, "frameskip = 1: unknown key"),
        (Settings, 7, "must be a mapping of settings, not int"),
        (Settings, {"whole": 1.5}, "whole = 1.5: must be a whole number"),
    ],
)
def test_a_mistake_is_answered_with_what_is_allowed(model, values, message):
    with pytest.raises(ConfigurationError) as caught:
        validate(model, values, "here")
    assert str(caught.value).startswith("here: ")
    assert message in str(caught.value)
    assert isinstance(caught.value, TypeError) == ("unknown key" in message)
