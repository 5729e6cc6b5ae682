"""The pages of the documentation: what they print runs as printed, and what they name exists."""

import importlib.util
import re
import shlex
import sys
import tomllib
from pathlib import Path
from urllib.parse import unquote

import numpy as np
import pytest
import typer
import yaml
from recorded import healthy

import hydro_env
from hydro_agents.commands.application import application

ROOT = Path(__file__).parents[2]
DOCS = ROOT / "docs"
PAGES = [*sorted(DOCS.rglob("*.md")), *(ROOT / name for name in ("README.md", "CONTRIBUTING.md", "CHANGELOG.md"))]
TEXTS = {page.relative_to(ROOT).as_posix(): page.read_text(encoding="utf-8") for page in PAGES}
FENCE = re.compile(r"^```([^\n]*)\n(.*?)^```$", flags=re.MULTILINE | re.DOTALL)
PYTHON = [
    (name, number)
    for name, text in TEXTS.items()
    if name.startswith(("docs/", "README"))
    for number, (kind, _) in enumerate(FENCE.findall(text))
    if kind == "python"
]
MOST_COLUMNS = 88
AS_WIDE_AS_THE_SOURCE = ("diff", "text", "{eval-rst}")
"""Kinds of blocks that quote: lines of the sources, which have up to 120 columns, what a command prints, signatures."""
SLOW = ("docs/bound.md", "docs/leak_bound.md", "docs/cluster.md", "docs/alarms.md")
NO_DEPENDENCIES = ("control", "torchrl")
"""Packages that some blocks of a page import, and that are no dependencies."""


@pytest.fixture
def given(tmp_path, monkeypatch):
    """What the code of some pages takes as given, in a folder that looks like the root of the repository."""
    for folder in ("agents", "configs"):
        (tmp_path / folder).symlink_to(ROOT / folder)
    (tmp_path / "results" / "alarms").mkdir(parents=True)
    (tmp_path / "results" / "alarms" / "alarm.yaml").symlink_to(ROOT / "configs" / "agents" / "alarm.yaml")
    monkeypatch.chdir(tmp_path)
    signals = np.array(healthy(tmp_path).signals)[None, :, 100:901]
    row = {"controller": "PID", "training_seed": 0, "condition": "leak_1", "family": "sine", "plant": 0}
    row |= {"leakage_flow_lpm": 1.0, "seed": 2_200_000}
    return {"signals": signals[:, :, :401], "window": signals[:, :, :401], "row": row}


@pytest.mark.parametrize(
    ("page", "number"), [pytest.param(*block, marks=pytest.mark.slow if block[0] in SLOW else ()) for block in PYTHON]
)
def test_python_runs(page, number, given, capsys):
    block = FENCE.findall(TEXTS[page])[number][1]
    if re.search(r"^(import mujoco|from ray\.rllib)\b", block, re.MULTILINE):
        compile(block, page, "exec")
        pytest.skip("this code needs a library that is no dependency, or processes")
    for package in NO_DEPENDENCIES:
        if re.search(rf"^(import|from) {package}\b", block, re.MULTILINE) and not importlib.util.find_spec(package):
            pytest.skip(f"{package} is not installed")
    space = {**given, "__name__": "__main__"}
    exec(compile(block, f"{page}, block {number}", "exec"), space)
    assert page != "README.md" or capsys.readouterr().out.strip()


@pytest.mark.parametrize("page", [name for name in TEXTS if name != "CHANGELOG.md"])
def test_a_line_of_code_fits_a_screen(page):
    blocks = [body for kind, body in FENCE.findall(TEXTS[page]) if kind not in AS_WIDE_AS_THE_SOURCE]
    wide = [line for line in "".join(blocks).splitlines() if len(line) > MOST_COLUMNS]
    assert not wide, f"{page}: more than {MOST_COLUMNS} characters"


def test_the_readme_shows_a_loop_and_targets_that_exist():
    assert any("gym.make(" in block and "env.step(" in block for _, block in FENCE.findall(TEXTS["README.md"]))
    makefile = (ROOT / "Makefile").read_text(encoding="utf-8")
    for target in re.findall(r"`make ([a-z-]+)", TEXTS["README.md"]):
        assert re.search(rf"^{target}:", makefile, flags=re.MULTILINE), target


def lines_of_commands():
    """Every line of a block, and every span of code, that calls ``hydro``."""
    for name, text in TEXTS.items():
        blocks = "\n".join(body for kind, body in FENCE.findall(text) if kind in ("", "sh", "bash", "console"))
        blocks = blocks.replace("\\\n", " ")
        for line in blocks.splitlines():
            if re.match(r"(\$ )?hydro ", line):
                yield name, line.removeprefix("$ ")
        prose = FENCE.sub("", text)
        yield from ((name, " ".join(span.split())) for span in re.findall(r"`(hydro [^`]+)`", prose))


@pytest.mark.parametrize(("page", "line"), sorted(set(lines_of_commands())))
def test_a_command_is_one(page, line):
    words = shlex.split(line.replace("…", ""), comments=True)[1:]
    whole = command = typer.main.get_command(application())
    context = command.make_context("hydro", list(words), resilient_parsing=True)
    for word in words:
        if not hasattr(command, "commands") or word not in command.commands:
            break
        command = command.commands[word]
    else:
        return
    rest = words[words.index(word) :]
    options = {name for parameter in command.params for name in (*parameter.opts, *parameter.secondary_opts)}
    for option in (part.split("=")[0] for part in rest if part.startswith("-") and not re.match(r"-\d", part)):
        assert option in options | {"--help"}, f"{page}: {line}: no option {option}"
    assert context.command.name == "hydro"
    assert command is not whole, f"{page}: {line}: no such command"


@pytest.mark.parametrize("page", TEXTS)
def test_links_and_pictures(page):
    text, here = FENCE.sub("", TEXTS[page]), (ROOT / page).parent
    for alt, _ in re.findall(r"!\[([^\]]*)\]\(([^)]+)\)", text):
        assert len(alt) > 20, f"{page}: a picture needs a text for those who cannot see it"
    for link in re.findall(r"\]\(([^)\s]+)\)", text):
        if "://" not in link and not link.startswith(("#", "mailto:")):
            assert (here / unquote(link.split("#")[0])).exists(), f"{page}: {link}"


def test_every_page_stands_in_the_contents():
    parents = (TEXTS["docs/index.md"], TEXTS["docs/clients.md"].partition("```{toctree}")[2].join(("```{toctree}", "")))
    contents = "\n".join(body for text in parents for _, body in FENCE.findall(text))
    pages = {page.relative_to(DOCS).with_suffix("").as_posix() for page in DOCS.rglob("*.md")}
    listed = set(re.findall(r"^[\w./]+$", contents, flags=re.MULTILINE))
    assert listed == pages - {"index"} | {"../CONTRIBUTING", "../CHANGELOG"}


def test_every_command_and_every_room_is_listed():
    for command in typer.main.get_command(application()).commands:
        assert f"`hydro {command}" in TEXTS["docs/commands.md"], command
    for room in sorted((ROOT / "agents").glob("*/*/__init__.py")):
        assert f"(../{room.parent.relative_to(ROOT)})" in TEXTS["docs/architecture.md"], room.parent.name


def test_the_citation_names_this_version():
    entry = yaml.safe_load((ROOT / "CITATION.cff").read_text(encoding="utf-8"))
    assert entry["version"] == hydro_env.__version__
    assert {"cff-version", "message", "title", "authors"} <= set(entry)
    assert entry["authors"] == [{"name": "hydro_env contributors"}]


@pytest.mark.parametrize("page", sorted((DOCS / "notebooks").glob("*.md")), ids=lambda page: page.stem)
def test_a_notebook_names_the_extra_that_brings_what_its_cells_import(page):
    text = page.read_text(encoding="utf-8")
    (extra,) = re.findall(rf'to ipynb {page.name}`.*"hydro_env\[(\w+)\]"`\.$', text, flags=re.MULTILINE)
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    wanted = [*project["dependencies"], *project["optional-dependencies"][extra]]
    brought = {re.split(r"[\[<>=]", one)[0].replace("-", "_") for one in wanted}
    cells = "\n".join(re.findall(r"^```\{code-cell\} ipython3\n(.*?)^```$", text, flags=re.MULTILINE | re.DOTALL))
    needed = set(re.findall(r"^(?:import|from) (\w+)", cells, flags=re.MULTILINE)) - sys.stdlib_module_names
    assert len(needed) > 1
    assert needed <= brought | {"hydro_env", "hydro_agents", "hydro_rig"}
