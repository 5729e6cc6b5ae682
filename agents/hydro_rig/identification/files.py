"""The files of an identification: page, rig and numbers."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from pydantic_core import to_jsonable_python

from hydro_agents.running.folders import output_folder
from hydro_agents.running.machine import Origin
from hydro_env import ConfigurationError, __version__
from hydro_env.files import read_yaml, write_text
from hydro_env.task.sensors import SENSORS
from hydro_rig.estimation.unknowns import EXTERNAL_LEAKAGE, LEAKAGE
from hydro_rig.identification.found_rig import rig_yaml
from hydro_rig.identification.held_back import Forecast
from hydro_rig.identification.identification_page import identification_page
from hydro_rig.identification.identify import Identification
from hydro_rig.recordings.findings import lines_of

PAGE_FILE, RIG_FILE, RESULT_FILE = FILES = ("identification.html", "rig.yaml", "identification.json")
JOB = "identify"


def identify_to_folder(folder: Path, found: Identification, overwrite: bool, command: str) -> list[str]:
    """Write page, numbers and, if the model describes the axis, the rig; returns the lines for the user.

    Raises:
        ConfigurationError: the folder cannot be written, or the model does not describe the axis; in this case page and
            numbers are written, but no rig.
    """
    with output_folder(folder, JOB, FILES, overwrite=overwrite):
        write_text(folder / RESULT_FILE, json.dumps(as_json(found, command), indent=1, allow_nan=False) + "\n")
        identification_page(found).write(folder / PAGE_FILE, Origin.now(command))
        if found.describes:
            notes = [
                f"Found by: {command}",
                f"hydro_env {__version__}; {found.verdict()}.",
                "Ranges: 95 % intervals; an undetermined parameter keeps its range.",
            ]
            text = rig_yaml(read_yaml(found.rig.source), found.fit, found.config, found.rig.randomisation, notes)
            write_text(folder / RIG_FILE, text)
    if not found.describes:
        first, *others = (recording.source for recording in found.recordings)
        more = f" and {len(others)} more" if others else ""
        raise ConfigurationError(f"{first}{more}: {found.verdict()}; see {folder / PAGE_FILE}")
    lines = [*lines_of(found.findings), *found.noted]
    if found.undetermined:
        lines.append(f"Not determined: {', '.join(one.name for one in found.undetermined)}")
    return [*lines, str(folder / PAGE_FILE), str(folder / RIG_FILE), found.verdict()]


def as_json(found: Identification, command: str) -> Any:
    """The result for programs; SI units, leaks in l/min at 100 bar; ``None`` if there is no number."""
    fit, sources = found.fit, [recording.source for recording in found.recordings]

    def sizes(test: Forecast) -> dict[str, float]:
        found = {"speed_rms": test.speed_error}
        for place, name in enumerate(SENSORS):
            found |= {f"{name}_share_of_variance": test.share[place], f"{name}_rms": test.error[place]}
        return found

    unknowns = {}
    for one in fit.unknowns:
        unit = "l/min at 100 bar" if one.name in (LEAKAGE, EXTERNAL_LEAKAGE) else "SI"
        unknowns[one.name] = one._asdict() | {"unit": unit, "determined": fit.knows(one)}
    parts = []
    for part in found.held_back:
        out, back = part.speed_ratios
        place = {"recording": sources[part.recording], "from_s": part.begin, "to_s": part.begin + float(part.time[-1])}
        parts.append(place | sizes(part.whole) | {"speed_out": out, "speed_in": back})
    whole = {
        "command": command,
        "hydro_env": __version__,
        "recordings": sources,
        "rig": found.rig.source,
        "describes": found.describes,
        "verdict": found.verdict(),
        "held_back": {"why": found.parts.reason, "parts": parts, "together": sizes(found.whole)},
        "over_2_s": None if found.ahead is None else sizes(found.ahead),
        "windows": len(fit.misfit),
        "windows_explained": int(fit.explained.sum()),
        "unknowns": unknowns,
        "findings": lines_of(found.findings),
        "notes": found.noted,
    }
    return to_jsonable_python(whole, inf_nan_mode="null", fallback=lambda value: value.tolist())
