"""The page of an identification, and the files beside it: rig and numbers."""

import json
import math
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from pydantic_core import to_jsonable_python

from hydro_agents.report.kit import BLUE, GREY, ORANGE, Page, drawn, signal, time_panels
from hydro_agents.running.folders import output_folder
from hydro_agents.running.machine import Origin
from hydro_agents.running.text import capitalised, listed, number
from hydro_env import ConfigurationError, PlantParameters, __version__
from hydro_env.files import read_yaml, write_text
from hydro_env.folders import page as page_address
from hydro_env.task.sensors import POSITION, SENSORS
from hydro_env.units import UNITS
from hydro_rig.estimation.unknowns import EXTERNAL_LEAKAGE, LEAKAGE
from hydro_rig.identification.found_rig import rig_yaml, share_in_words, shown
from hydro_rig.identification.held_back import JUDGED_OVER, Forecast, HeldBack, sizes_of
from hydro_rig.identification.identify import Identification
from hydro_rig.recordings.findings import Finding, lines_of

MANUAL = page_address("identify.md")
CONTINUE = (
    "rig.yaml beside this page holds the identified rig. Continue with hydro check-rig --rig rig.yaml and hydro study "
    "--rig rig.yaml."
)
CHECK = (
    "No rig was written. Check wiring, units and signs of the recording, and the values in the rig file that have no "
    "range."
)

PANELS = (("position, mm", 1e3), ("pressure a, bar", 1e-5), ("pressure b, bar", 1e-5), ("spool, %", 100.0))
"""Label and factor from SI of each channel."""

ERRORS = ("position, mm", "speed, mm/s", "pressure a, bar", "pressure b, bar")
SHARES = ("share of position", "of pressure a", "of pressure b", "of spool")
PAGE_FILE, RIG_FILE, RESULT_FILE = FILES = ("identification.html", "rig.yaml", "identification.json")
JOB = "identify"


@drawn
def identification_page(found: Identification) -> Page:
    """The verdict and what to do next, the held-back parts, the identified values, and the recordings."""
    page = Page("Identification of the axis", f"Numbers: identification.json beside this page. How it works: {MANUAL}.")
    kind = "worse" if not found.describes else "doubtful" if found.unexplained else "good"
    page.verdict(capitalised(found.verdict()), kind)
    page.text(CONTINUE if found.describes else CHECK)
    for note in found.noted:
        page.text(note)
    page.heading("Measured and simulated")
    if found.held_back:
        held_back(page, found)
    else:
        page.text("The recording is too short: nothing was held back.")
    page.heading("Identified values")
    page.text(f"What to record for a value that is not determined: the table of motions in {MANUAL}.")
    page.table(unknowns_table(found), "Determined: the uncertainty is at most half of that of the range", words=True)
    page.heading("The recordings")
    if found.findings:
        page.table(findings_frame(found.findings), "Findings", words=True)
    facts = {
        "recordings": listed([recording.source for recording in found.recordings]),
        "windows of the fit": len(found.parts.fitted),
        "explained to within the sensors' noise": found.fit.explained.sum(),
        "held back": "; ".join(place_of_part(found, part) for part in found.held_back) or "nothing",
    }
    page.facts(facts)
    return page


def findings_frame(findings: Iterable[Finding]) -> pd.DataFrame:
    """Findings about a recording as a table."""
    rows = [(each.signal, each.line().removeprefix(f"{each.signal} "), each.weight.value) for each in findings]
    return pd.DataFrame(rows, columns=["signal", "finding", "weight"]).set_index("signal")


def rig_line(plant: PlantParameters) -> str:
    """The nameplate of a rig in one line, by which a person sees whether it is the recorded one."""
    cylinder, supply = plant.cylinder, plant.supply.pressure / UNITS["Pa"]["bar"]
    return (
        f"bore {1e3 * cylinder.bore_diameter:g} mm, rod {1e3 * cylinder.rod_diameter:g} mm, "
        f"stroke {1e3 * cylinder.stroke:g} mm, supply {supply:g} bar"
    )


def held_back(page: Page, found: Identification) -> None:
    """The part that the fit did not use with the largest error, and how errors grow."""
    worst = max(found.held_back, key=lambda part: np.nan_to_num(part.whole.error[POSITION]))
    page.text(
        f"The fit did not use these parts: {found.parts.reason}. The simulation gets the state at the start and the "
        "recorded commands: its errors add up. The table also begins every 2 s at the measured state."
    )
    page.figure(held_back_axes(worst), f"The held-back part with the largest error: {place_of_part(found, worst)}")
    rows = {}
    for over, test in ((f"{JUDGED_OVER:g} s", found.ahead), ("the whole part", found.whole)):
        if test:
            shares = ["–" if math.isnan(share) else share_in_words(share) for share in test.share]
            rows[over] = [*(number(size, digits=2) for size in sizes_of(test)), *shares]
    frame = pd.DataFrame.from_dict(rows, orient="index", columns=(*ERRORS, *SHARES))
    page.table(frame, "Root mean square error, and share of the variance explained, by the simulated time")


def held_back_axes(part: HeldBack) -> list[Axes]:
    """Each recorded channel, measured and simulated, and the difference in position."""
    recorded = [row for row in range(len(PANELS)) if np.isfinite(part.measured[row]).any()]
    labels = [PANELS[row][0] for row in recorded]
    axes, time = time_panels([labels[0], "simulated −\nmeasured, mm", *labels[1:]]), part.begin + part.time
    for one, row in zip([axes[0], *axes[2:]], recorded, strict=True):
        factor = PANELS[row][1]
        signal(one, time, factor * part.measured[row], color=GREY, linestyle="-", linewidth=2.4)
        signal(one, time, factor * part.simulated[row], color=BLUE, linestyle="-", linewidth=1.1)
    axes[0].legend(axes[0].lines, ["measured", "simulated"], loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=2)
    signal(axes[1], time, 1e3 * (part.simulated[0] - part.measured[0]), color=ORANGE, linestyle="-", linewidth=0.9)
    return axes


def unknowns_table(found: Identification) -> pd.DataFrame:
    """Each unknown: its value, its interval, and whether it is determined."""
    rows = {}
    for one in found.fit.unknowns:
        look = shown(one.name)
        rows[f"{look.words}, {look.unit}"] = {
            "found": look.value(one.value, one.high - one.low),
            "95 % interval": look.span(one.low, one.high),
            "determined": "yes" if found.fit.knows(one) else "no",
        }
    return pd.DataFrame.from_dict(rows, orient="index")


def place_of_part(found: Identification, part: HeldBack) -> str:
    """Recording and time of a held-back part."""
    name = f"{Path(found.recordings[part.recording].source).name}, " if len(found.recordings) > 1 else ""
    return f"{name}{part.begin:g} to {part.begin + part.time[-1]:.4g} s"


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
    parts = [
        {"recording": sources[part.recording], "from_s": part.begin, "to_s": part.begin + part.time[-1]}
        | sizes(part.whole)
        for part in found.held_back
    ]
    whole = {
        "command": command,
        "hydro_env": __version__,
        "recordings": sources,
        "rig": found.rig.source,
        "describes": found.describes,
        "verdict": found.verdict(),
        "held_back": {"why": found.parts.reason, "parts": parts, "together": sizes(found.whole)},
        "over_2_s": found.ahead and sizes(found.ahead),
        "windows": len(fit.misfit),
        "windows_explained": int(fit.explained.sum()),
        "unknowns": unknowns,
        "findings": lines_of(found.findings),
        "notes": found.noted,
    }
    return to_jsonable_python(whole, inf_nan_mode="null", fallback=lambda value: value.tolist())
