"""What a release needs of the files of a public forge; benchmarks/release.py builds it and tries it."""

import re
import tomllib
from pathlib import Path

import yaml

ROOT = Path(__file__).parents[2]


def test_workflows_classifiers_and_the_release_name_the_same_versions_of_python():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    versions = re.findall(r"Python :: (3\.\d+)", "\n".join(project["classifiers"]))
    tests = yaml.safe_load((ROOT / ".github/workflows/tests.yml").read_text(encoding="utf-8"))
    assert tests["jobs"]["tests"]["strategy"]["matrix"]["python"] == versions
    script = (ROOT / "benchmarks/release.py").read_text(encoding="utf-8")
    assert re.findall(r"\"(3\.\d+)\"", script) == versions
