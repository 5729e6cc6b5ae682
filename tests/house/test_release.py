"""What a release adds: the README for the package index, and the files of a public forge."""

import importlib.util
import re
import sys
import tomllib
import types
from pathlib import Path

import pytest
import yaml

ROOT = Path(__file__).parents[2]
README = (ROOT / "README.md").read_text(encoding="utf-8")
ADDRESS = "https://example.org/hydro_env"
INSIDE = re.compile(r"\]\((?!https?:)")


@pytest.fixture(scope="module")
def release():
    """The build hooks, without hatchling, which only a build has."""
    stand_ins = {
        "hatchling.builders.hooks.plugin.interface": {"BuildHookInterface": dict},
        "hatchling.metadata.plugin.interface": {"MetadataHookInterface": object},
    }
    with pytest.MonkeyPatch.context() as patch:
        for name, parts in stand_ins.items():
            module = types.ModuleType(name)
            vars(module).update(parts)
            patch.setitem(sys.modules, name, module)
        spec = importlib.util.spec_from_file_location("hatch_build", ROOT / "hatch_build.py")
        module = importlib.util.module_from_spec(spec)
        spec.loader.exec_module(module)
    return module


def test_the_readme_has_no_dead_link_with_and_without_an_address_and_loses_no_word(release, monkeypatch):
    assert INSIDE.search(README)
    without, text = release.readme(README, ""), release.readme(README, ADDRESS)
    assert not INSIDE.search(without + text)
    assert "https://gymnasium.farama.org" in without
    words = [re.escape(word) for word in re.findall(r"(?<!!)\[([^\]]+)\]\((?!https?:)", README)]
    assert [word for word in words if not re.search(word, without)] == []
    places = re.findall(rf"\]\({ADDRESS}/(?:blob|raw)/main/([^)#]+)", text)
    assert len(places) > 20
    assert [place for place in places if not (ROOT / place).exists()] == []
    monkeypatch.setenv(release.ADDRESS, "example.org")
    hook = release.AddressHook()
    hook.root = str(ROOT)
    with pytest.raises(ValueError, match="must be an address such as"):
        hook.update({})


def test_workflows_classifiers_and_the_release_name_the_same_versions_of_python():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    versions = re.findall(r"Python :: (3\.\d+)", "\n".join(project["classifiers"]))
    tests = yaml.safe_load((ROOT / ".github/workflows/tests.yml").read_text(encoding="utf-8"))
    assert tests["jobs"]["tests"]["strategy"]["matrix"]["python"] == versions
    script = (ROOT / "benchmarks/release.py").read_text(encoding="utf-8")
    assert re.findall(r"\"(3\.\d+)\"", script) == versions
