"""The pages of the documentation: what they print runs as printed, and what they name exists."""

import importlib.util
import re
import shlex
from pathlib import Path
from urllib.parse import unquote

import numpy as np
import pytest
import typer
import yaml
from recorded import healthy

import hydro_env
from hydro_agents.commands.application import application
from hydro_agents.learning import rig_gains

ROOT = Path(__file__).parents[2]
DOCS = ROOT / "docs"
PAGES = [*sorted(DOCS.rglob("*.md")), *(ROOT / name for name in ("README.md", "CONTRIBUTING.md", "CHANGELOG.md"))]
TEXTS = {page.relative_to(ROOT).as_posix(): page.read_text(encoding="utf-8") for page in PAGES}
NOTES = sorted((ROOT / "benchmarks").rglob("*.md"))
FENCE = re.compile(r"^ *```([^\n]*)\n(.*?)^ *```$", flags=re.MULTILINE | re.DOTALL)
PYTHON = [
    (name, number)
    for name, text in TEXTS.items()
    if name.startswith(("docs/", "README")) and name != "docs/extend.md"  # tests/house/test_recipes.py
    for number, (kind, _) in enumerate(FENCE.findall(text))
    if kind == "python"
]
NO_DEPENDENCIES = ("control", "torchrl")
"""Packages that some blocks of a page import, and that are no dependencies."""


@pytest.fixture(scope="module")
def signals(tmp_path_factory):
    """Two seconds of a healthy axis, (1, 5, 401)."""
    return np.array(healthy(tmp_path_factory.mktemp("axis")).signals)[None, :, 100:501]


@pytest.fixture
def given(tmp_path, signals, monkeypatch):
    """What the code of some pages takes as given, in a folder that looks like the root of the repository."""
    for folder in ("agents", "configs"):
        (tmp_path / folder).symlink_to(ROOT / folder)
    monkeypatch.chdir(tmp_path)
    sets = rig_gains.gain_sets
    monkeypatch.setattr(rig_gains, "gain_sets", lambda *rig: sets(*rig)[:2])  # of which a simulation chooses
    row = {"controller": "PID", "training_seed": 0, "condition": "leak_8", "family": "sine", "plant": 0}
    return {"signals": signals, "row": row | {"leakage_flow_lpm": 8.0, "seed": 2_200_000}}


@pytest.mark.parametrize(("page", "number"), PYTHON)
def test_python_runs(page, number, given, capsys):
    block = FENCE.findall(TEXTS[page])[number][1]
    for package in NO_DEPENDENCIES:
        if re.search(rf"^(import|from) {package}\b", block, re.MULTILINE) and not importlib.util.find_spec(package):
            pytest.skip(f"{package} is not installed")
    exec(compile(block, f"{page}, block {number}", "exec"), {**given, "__name__": "__main__"})
    assert page != "README.md" or capsys.readouterr().out.strip()


def lines_of_commands():
    """Every line of a block, and every span of code, that calls ``hydro``."""
    for name, text in TEXTS.items():
        if name == "CHANGELOG.md":
            continue  # it names commands that are gone
        blocks = "\n".join(body for kind, body in FENCE.findall(text) if kind in ("", "bash"))
        for line in blocks.replace("\\\n", " ").splitlines():
            if re.match(r" *(\$ )?hydro ", line):
                yield name, line.strip().removeprefix("$ ")
        yield from ((name, " ".join(span.split())) for span in re.findall(r"`(hydro [^`]+)`", FENCE.sub("", text)))


@pytest.mark.parametrize(("page", "line"), sorted(set(lines_of_commands())))
def test_a_command_is_one(page, line):
    words = shlex.split(line, comments=True)[1:]
    command = whole = typer.main.get_command(application())
    whole.make_context("hydro", list(words), resilient_parsing=True)
    rest = list(words)
    while rest and rest[0] in getattr(command, "commands", {}):
        command = command.commands[rest.pop(0)]
    assert command is not whole or words == ["--version"], f"{page}: {line}: no such command"
    options = {name for parameter in command.params for name in (*parameter.opts, *parameter.secondary_opts)}
    for option in (part.split("=")[0] for part in rest if part.startswith("-") and not re.match(r"-\d", part)):
        assert option in options | {"--help"}, f"{page}: {line}: no option {option}"


@pytest.mark.parametrize("page", [*PAGES, *NOTES], ids=lambda page: page.stem)
def test_links_and_pictures(page):
    text = FENCE.sub("", page.read_text(encoding="utf-8"))
    for alt in re.findall(r"!\[([^\]]*)\]\(", text):
        assert alt, "a picture needs a text for those who cannot see it"
    for link in re.findall(r"\]\(([^)\s]+)\)", text):
        if "://" not in link and not link.startswith("#"):
            assert (page.parent / unquote(link.split("#")[0])).exists(), link
    for script in [] if page in NOTES else re.findall(r"python (?:-m )?(benchmarks[./]\w+|docs/\w+|paper)", text):
        assert (ROOT / f"{script.replace('.', '/')}.py").exists() or script == "paper", script


def test_every_page_and_every_command_is_listed():
    pages = {page.relative_to(DOCS).with_suffix("").as_posix() for page in DOCS.rglob("*.md")}
    contents = "\n".join(body for _, body in FENCE.findall(TEXTS["docs/index.md"]))
    listed = set(re.findall(r"^[\w./]+$", contents, flags=re.MULTILINE))
    assert listed == pages - {"index"} | {"../CONTRIBUTING", "../CHANGELOG"}
    for command in typer.main.get_command(application()).commands:
        assert f"`hydro {command}" in TEXTS["docs/commands.md"], command


def test_the_citation_names_this_version():
    entry = yaml.safe_load((ROOT / "CITATION.cff").read_text(encoding="utf-8"))
    assert entry["version"] == hydro_env.__version__
    assert {"cff-version", "message", "title", "authors"} <= set(entry)
