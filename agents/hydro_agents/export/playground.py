"""The playground as one HTML file: WebAssembly of the generated C inside, no server, no network."""

from __future__ import annotations

import base64
import gzip
import importlib.util
import json
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

from matplotlib.colors import to_rgb

from hydro_agents.detection.head import LeakageHead
from hydro_agents.export.axis_code import TEMPLATES, VIEW, axis_sources
from hydro_agents.export.choices import CHOICES, written
from hydro_agents.export.plant_code import render
from hydro_agents.report.leaks import LOOKS
from hydro_agents.running.folders import pretrained_folder
from hydro_env import ConfigurationError, HydroError, __version__
from hydro_env.plant.analysis import speed_limits
from hydro_env.plant.parameters import PARAMETER_PATHS, to_vector
from hydro_env.rendering import OIL
from hydro_env.units import LEAKAGE_TEST_PRESSURE, LITRE_PER_MINUTE

CENTRE = 0.02
"""m; about the middle of the range that the supply can hold against the spring."""

SEED = 20151

_RIG_SLIDERS = (
    ("Supply pressure", "bar", 60, 100, 1e5, "supply.pressure"),
    ("Moved mass", "kg", 20, 120, 1, "load.mass"),
    ("Force on the load, against extension", "N", -2000, 2000, 1, "load.external_force"),
)
_FIELDS = ("name", "unit", "low", "high", "scale", "parameter")
RIG_SLIDERS: tuple[dict[str, Any], ...] = tuple(
    {**dict(zip(_FIELDS, row, strict=True)), "digits": 0} for row in _RIG_SLIDERS
)


PAGE_FILE = "playground.html"


def playground_page() -> str:
    """The page: the rig of the default task, with the shipped controllers and leakage head.

    Raises:
        ConfigurationError: the package ziglang is not installed.
        HydroError: the compiler failed.
    """
    head = LeakageHead.load(pretrained_folder() / "leakage_head")
    config = head.settings.task
    own = dict(zip(PARAMETER_PATHS, to_vector(config.plant).tolist(), strict=True))
    controllers = [written(choice, config) for choice in CHOICES]
    sliders = [slider for one in controllers for slider in one.sliders]
    facts = {
        "parameters": PARAMETER_PATHS,
        "own": {
            name: own[name] for name in ("leakage.internal_resistance", *(one["parameter"] for one in RIG_SLIDERS))
        },
        "view": VIEW,
        "previewTimes": config.references.preview_times,
        "period": config.control_period,
        "stroke": config.plant.cylinder.stroke,
        "largestSpeed": min(speed_limits(config.plant)),
        "centre": CENTRE,
        "seed": SEED,
        "testPressure": LEAKAGE_TEST_PRESSURE,
        "litrePerMinute": LITRE_PER_MINUTE,
        "rigSliders": [{**one, "value": own[one["parameter"]] / one["scale"]} for one in RIG_SLIDERS],
        "leakColours": [[round(255 * part) for part in to_rgb(look.colour)] for look in LOOKS.values()],
        "oil": OIL,
        "axes": [
            {"name": name, "controller": number} for number, name in enumerate(("PID", "Flow linearisation", "Mine"))
        ],
        "controllers": [{"kind": one.choice.kind, "name": one.choice.name} for one in controllers],
        "gains": [slider["gain"] for slider in sliders],
        "gainSliders": sliders,
        "threshold": head.settings.threshold,
        "window": head.settings.window * config.control_period,
    }
    module = web_assembly(axis_sources(config, controllers, head))
    wasm = base64.b64encode(gzip.compress(module, 9, mtime=0)).decode()
    parts = {name: (TEMPLATES / f"{name}.js").read_text(encoding="utf-8") for name in ("machine", "drawing", "plots")}
    script = (TEMPLATES / "page.js").read_text(encoding="utf-8")
    values: dict[str, Any] = {
        **parts,
        "page": script,
        "style": (TEMPLATES / "style.css").read_text(encoding="utf-8"),
        "facts": json.dumps(facts, ensure_ascii=False, separators=(",", ":"), default=float),
        "wasm": wasm,
        "window": f"{head.settings.window * config.control_period:g}",
        "version": __version__,
    }
    return render("playground.html.j2", values, TEMPLATES)


def web_compiler() -> list[str]:
    """Command of the compiler for WebAssembly.

    Raises:
        ConfigurationError: the compiler is not installed.
    """
    if importlib.util.find_spec("ziglang") is None:
        text = "the playground is compiled by the package ziglang: pip install 'hydro_env[playground]'"
        raise ConfigurationError(text)
    return [sys.executable, "-m", "ziglang", "cc", "-target", "wasm32-wasi", "-mexec-model=reactor"]


def web_assembly(sources: dict[str, str]) -> bytes:
    """Compile C sources to a WebAssembly module that imports nothing.

    Raises:
        ConfigurationError: the compiler is not installed.
        HydroError: the compiler failed; the message is its first line.
    """
    with tempfile.TemporaryDirectory() as folder:
        for name, text in sources.items():
            (Path(folder) / name).write_text(text, encoding="utf-8")
        units = [name for name in sources if name.endswith(".c")]
        options = ["-std=c99", "-O2", "-s", "-Wall", "-Wextra", "-Werror"]
        command = [*web_compiler(), *options, "-o", "module.wasm", *units, "-lm"]
        result = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
        if result.returncode != 0:
            raise HydroError(f"ziglang: {(result.stderr.splitlines() or ['failed'])[0]}")
        return (Path(folder) / "module.wasm").read_bytes()
