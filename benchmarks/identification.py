"""How well `hydro identify` finds hidden rigs: 20 s under a PID, noise, biases and a leak; intervals, held-back part.

Run: python benchmarks/identification.py [--rigs 30] [--folder FOLDER] [--validation]

Each seed hides a rig of its own: files of ``hydro new-rig``, recordings, and the true values. Drawn cylinders of 25 to
100 mm, supplies of 70 to 250 bar, every second valve with an overlap of up to 6 %. All that the file leaves open is
drawn from its ranges. Every fifth rig or so lacks sensors or has a clipped position; one in ten has a file with a wrong
number that the file calls certain. The code behind `hydro record` writes the recording, the code behind `hydro
identify` reads it. Figures: test seeds. ``rows.csv`` in the folder has a row for each unknown of each rig; a later call
continues it.
"""

import json
import time
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pandas as pd

from benchmarks import command_line, kept_rows
from hydro_agents.controllers.pid import PIDGains
from hydro_agents.controllers.registry import make_controller
from hydro_agents.learning.loading import usual_gains
from hydro_agents.learning.stable_gain import stable_start
from hydro_agents.rigs.rig_file import answers_from, new_rig, written_answers
from hydro_agents.running.seeds import HIDDEN_RIGS, THRESHOLDS
from hydro_agents.running.text import markdown
from hydro_env import ConfigurationError, HydroError, ServoHydraulicVectorEnv, TaskConfig
from hydro_env.files import write_text
from hydro_env.plant.parameters import PARAMETER_PATHS, to_vector
from hydro_env.task.configuration import task_config
from hydro_env.task.drawn_rigs import TRIES, drawn_figures
from hydro_env.task.law import RigLaw
from hydro_env.task.rig import read_rig
from hydro_env.task.sensors import SENSOR_COLUMNS
from hydro_env.units import flow_from_resistance
from hydro_rig.estimation.unknowns import BIASES, EXTERNAL_LEAKAGE, EXTERNAL_RESISTANCE, LATENCY, LEAKAGE, RISE_TIME
from hydro_rig.identification.identify import identify
from hydro_rig.recordings.simulated import record_axis

LARGEST_BORE, MOST_OVERLAP = 100, 6.0  # mm, %
EVERY = 30  # rigs until the pattern below repeats
WITHOUT_PRESSURES = (1, 5, 9, 13, 17, 20, 24, 28)  # number of the rig within the pattern
WITHOUT_SPOOL = (2, 6, 10, 14, 18, 22, 25, 29)
CLIPPED = (3, 11, 19, 27)
WRONG_FACTORS = {"bore": 1.04, "rated_drop": 0.5, "rod": 1.12}
WRONG = dict(zip((7, 16, 23), WRONG_FACTORS, strict=True))  # by the number of the rig, what the file calls certain
VALIDATION_SKIP = 50_000  # seeds of validation before those of this benchmark
DURATION = 20.0  # s
FAR = 10.0  # standard deviations
CORE = "core: median; longest, s"
KINDS = ("no spool sensor", "no pressures", "clipped")  # in the names of the rigs


class HiddenRig(NamedTuple):
    """What ``hydro identify`` gets, and what it should find."""

    name: str  # in words
    recording: Path
    rig: Path
    wrong: str  # the number of the file that is wrong; empty: none
    true: dict[str, float]  # of all unknowns by name


def true_values(config: TaskConfig, seed: int) -> dict[str, float]:
    """True values of all unknowns of an episode by name."""
    env = ServoHydraulicVectorEnv(1, config, info=False)
    env.reset(seed=[seed])
    values = dict(zip(PARAMETER_PATHS, to_vector(env.axes.parameters(0)).tolist(), strict=True))
    values |= dict(zip(BIASES, env.axes.column("bias")[0, SENSOR_COLUMNS].tolist(), strict=True))
    values |= {LATENCY: float(env.axes.column("latency")[0]), RISE_TIME: config.sensors.pressure_rise_time}
    values[LEAKAGE] = float(env.axes.column("leak_flow")[0])
    values[EXTERNAL_LEAKAGE] = flow_from_resistance(values[EXTERNAL_RESISTANCE])
    env.close()
    return values


def hidden_rig(folder: Path, seed: int, number: int) -> HiddenRig:
    """The rig of a seed, with its recording; both are kept in the folder and read again.

    ``number``: of the rig; it sets the sensors that are absent, and the number that is wrong.

    Raises:
        ConfigurationError: no rig can be drawn.
    """
    kind = number % EVERY
    wrong = WRONG.get(kind, "")
    recording, rig, kept = (folder / f"{seed}{end}" for end in (".csv", ".yaml", ".json"))
    if not kept.exists():
        texts, config = _drawn(folder / f"{seed}-true.yaml", seed, kind)
        moving = stable_start(config, PIDGains.model_validate(usual_gains("pid")))
        record_axis(recording, config, make_controller("pid", config, moving.model_dump()), seed)
        given = dict(texts)
        if kind in CLIPPED:
            given["position_range"] = f"{_clip(recording):.7g} mm"
        if wrong:
            size, unit = given.get(wrong, "70 bar").split(" ")
            given[wrong] = f"{WRONG_FACTORS[wrong] * float(size):.4g} {unit}"
        _write(rig, given)
        name = f"{texts['bore']} x {texts['stroke']}, {texts['supply_pressure']}, overlap {texts.get('overlap', '0 %')}"
        name += ", no pressures" * (kind in WITHOUT_PRESSURES) + ", no spool sensor" * (kind in WITHOUT_SPOOL)
        name += ", clipped" * (kind in CLIPPED) + (f", wrong {wrong}" if wrong else "")
        write_text(kept, json.dumps({"name": name, "true": true_values(config, seed)}))
    stored = json.loads(kept.read_text(encoding="utf-8"))
    return HiddenRig(stored["name"], recording, rig, wrong, stored["true"])


def identified_task(rig: Path) -> TaskConfig:
    """The task of ``hydro identify`` on a rig: only the ranges of its file are open."""
    ranges = read_rig(rig).randomisation
    return task_config("as_given", rig=rig, randomisation={path: each.model_dump() for path, each in ranges.items()})


def _drawn(file: Path, seed: int, kind: int) -> tuple[dict[str, str], TaskConfig]:
    """The answers of a rig that can work, and the task that records it."""
    fault = ConfigurationError(f"{file}: no rig was drawn")
    for attempt in range(TRIES):
        texts = written_answers(drawn_figures(RigLaw(), seed, attempt)[0])
        if float(texts["bore"].split(" ")[0]) > LARGEST_BORE:
            continue
        for name in ("overlap", "absent"):
            texts.pop(name, None)
        if kind % 2 == 0:
            texts["overlap"] = f"{np.random.default_rng([seed, 1]).uniform(0.0, MOST_OVERLAP):.2g} %"
            texts.pop("null_flow", None)
        if kind in WITHOUT_PRESSURES:
            texts["absent"] = "pressure_a,pressure_b"
        elif kind in WITHOUT_SPOOL:
            texts["absent"] = "spool_position"
        try:
            _write(file, texts)
            return texts, identified_task(file).model_copy(update={"episode_duration": DURATION})
        except ConfigurationError as error:
            fault = error
    raise fault


def _write(file: Path, texts: dict[str, Any]) -> None:
    write_text(file, new_rig(answers_from(texts), str(file))[0])


def _clip(recording: Path) -> float:
    """Clip the highest third of the positions of a recording, as a sensor that is too short would; its range in mm."""
    table = pd.read_csv(recording, dtype=str)
    position = table["position [mm]"].astype(float)
    end = float(np.quantile(position, 2 / 3))
    table["position [mm]"] = [f"{min(value, end):.7g}" for value in position]
    write_text(recording, table.to_csv(index=False))
    return end


def unknowns_of(seed: int, first: int, folder: Path) -> Iterator[dict[str, Any]]:
    """Identify a hidden rig; a row for each unknown, and one row alone if the recording is refused.

    ``away`` is in standard deviations from the middle of the interval.
    """
    hidden = hidden_rig(folder, seed, seed - first)
    began, cost = time.monotonic(), time.process_time()
    row: dict[str, Any] = {"seed": seed, "rig": hidden.name, "wrong": bool(hidden.wrong), "refused": True}
    try:
        found = identify([hidden.recording], identified_task(hidden.rig), read_rig(hidden.rig))
    except HydroError as error:
        yield row | {"verdict": str(error)}
        return
    fit = found.fit
    row |= {"refused": not found.describes, "verdict": found.verdict(), "share": found.share}
    row |= {"seconds": time.monotonic() - began, "core_s": time.process_time() - cost}
    for one in fit.unknowns:
        value = hidden.true[one.name]
        away = abs(value - 0.5 * (one.low + one.high)) / max((one.high - one.low) / 3.92, 1e-300)
        judged = {"determined": fit.knows(one), "within": bool(one.low <= value <= one.high)}
        yield row | {"unknown": one.name, **judged, "away": float(away)}


def columns_of(rows: pd.DataFrame) -> list[str]:
    """A column of the table: rigs, refusals, determined unknowns, those within their interval, those far off, time."""
    done = rows[~rows["refused"]]
    known = done[done["determined"].astype(bool)]
    times = done.groupby("seed")["core_s"].first()
    cells = [str(rows["seed"].nunique()), str(rows.loc[rows["refused"], "seed"].nunique())]
    if known.empty:
        return [*cells, "–", "–", "–", "–"]
    within = f"{known['within'].mean():.1%} of {len(known)}"
    far = str(int((known["away"] > FAR).sum()))
    return [*cells, f"{len(known) / len(done):.1%}", within, far, f"{times.median():.0f}; {times.max():.0f}"]


def report(rows: pd.DataFrame) -> None:
    """Print the table by kind of rig, the table by unknown, and what else the page says."""
    right, wrong = rows[~rows["wrong"]], rows[rows["wrong"]]
    whole = ~right["rig"].str.contains("|".join(KINDS))
    kinds = {"all sensors": right[whole], **{kind: right[right["rig"].str.contains(kind)] for kind in KINDS}}
    columns = {name: columns_of(part) for name, part in (kinds | {"all": right}).items()}
    names = ("rigs", "refused", "determined", "within their 95 % interval", f"beyond {FAR:g} σ", CORE)
    print(markdown(("", *columns), [(name, *cells) for name, *cells in zip(names, *columns.values(), strict=True)]))
    refused = wrong.loc[wrong["refused"], "seed"].nunique()
    print(f"\nwith a wrong fixed number {refused} of {wrong['seed'].nunique()} refused")
    done = right[~right["refused"]]
    if done.empty:
        return
    shares = done.groupby("seed")["share"].first()
    print(f"share of the position's variance: median {shares.median():.3%}, lowest {shares.min():.3%}")
    print()
    lines = []
    for name, own in done.groupby("unknown", sort=False):
        known = own["determined"].astype(bool)
        within = f"{own.loc[known, 'within'].mean():.0%}" if known.any() else "–"
        lines.append((str(name), f"{known.mean():.0%}", within))
    print(markdown(("unknown", "determined", "within"), lines))


def main() -> None:
    """Identify the hidden rigs, and print the tables."""
    given = command_line(__doc__, rigs=30, folder=Path("results/identification"), validation=False)
    seeds = THRESHOLDS.take(given.rigs, VALIDATION_SKIP) if given.validation else HIDDEN_RIGS.take(given.rigs)
    given.folder.mkdir(parents=True, exist_ok=True)
    rows_of = partial(unknowns_of, first=seeds[0], folder=given.folder)
    report(kept_rows(given.folder / "rows.csv", "seed", seeds, rows_of))


if __name__ == "__main__":
    main()
