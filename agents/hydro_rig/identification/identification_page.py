"""The page of an identification."""

from __future__ import annotations

import math
from collections.abc import Iterable
from pathlib import Path

import numpy as np
import pandas as pd
from matplotlib.axes import Axes

from hydro_agents.report.kit import BLUE, GREY, ORANGE, Page, drawn, signal, time_panels
from hydro_agents.running.text import capitalised, listed, number
from hydro_env import PlantParameters
from hydro_env.folders import page as page_address
from hydro_env.task.sensors import POSITION
from hydro_env.units import UNITS
from hydro_rig.identification.found_rig import share_in_words, shown
from hydro_rig.identification.held_back import JUDGED_OVER, HeldBack, sizes_of
from hydro_rig.identification.identify import Identification
from hydro_rig.recordings.findings import Finding

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
        "explained to within the sensors' noise": int(found.fit.explained.sum()),
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
        if test is not None:
            shares = ["–" if math.isnan(share) else share_in_words(share) for share in test.share.tolist()]
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
    return f"{name}{part.begin:g} to {part.begin + float(part.time[-1]):.4g} s"
