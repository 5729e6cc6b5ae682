"""How well `hydro identify` finds hidden rigs: 20 s under the PID, noise, biases and a leak; intervals, held-back part.

Run: python benchmarks/identification.py [--rigs 40] [--rig NAME|FILE] [--without pressure_a pressure_b] [--validation]
     python benchmarks/identification.py --new-rig [--rigs 30] [--folder FOLDER] [--validation]

Each seed hides a rig: its parameters, leak and biases of the sensors are drawn from the ranges of the rig file. The
code behind `hydro record` writes the recording, the code behind `hydro identify` reads it. With ``--new-rig`` every
seed has a rig of its own (:mod:`benchmarks.hidden_rigs`). Figures: test seeds. Results in a folder are read again.
"""

from __future__ import annotations

import argparse
import json
import os
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.hidden_rigs import HiddenRig, hidden_rig, identified_task, true_values
from hydro_agents.learning.opponents import opponent
from hydro_agents.running.seeds import EVALUATION, HIDDEN_RIGS, THRESHOLDS
from hydro_env import HydroError
from hydro_env.files import write_text, write_yaml
from hydro_env.task.configuration import task_config
from hydro_env.task.rig import read_rig
from hydro_env.task.sensors import SENSORS
from hydro_rig.identification.identify import identify
from hydro_rig.recordings.simulated import record_axis

VALIDATION_SKIP = 50_000  # seeds of validation before those of the drawn rigs
FAR = 10.0  # standard deviations
KINDS = ("no spool sensor", "no pressures", "clipped")  # in the names of the rigs of ``--new-rig``


def rig_of_a_task(folder: Path, seed: int, arguments: argparse.Namespace) -> HiddenRig:
    """A hidden rig of the default task or of ``--rig``, whose file leaves open all that an episode draws."""
    file, recording = folder / "rig.yaml", folder / f"{seed}.csv"
    given = task_config(None, rig=arguments.rig)
    groups = given.plant.model_dump(mode="json")
    groups["randomisation"] = {
        path: drawn.model_dump(mode="json", exclude_defaults=True) for path, drawn in given.randomisation.items()
    }
    write_yaml(file, groups)
    config = task_config(None, rig=file, episode_duration=arguments.duration)
    record_axis(
        recording, config, opponent(arguments.controller, config, "--controller"), seed, family=arguments.family
    )
    if arguments.without:
        lines = recording.read_text(encoding="utf-8").splitlines()
        cells = [line.split(",") for line in lines]
        keep = [place for place, head in enumerate(cells[0]) if head.split(" ")[0] not in arguments.without]
        kept = "\n".join(",".join(row[place] for place in keep) for row in cells)
        write_text(recording, kept + "\n")
    return HiddenRig(str(seed), recording, file, "", true_values(config, seed))


def judged(hidden: HiddenRig) -> dict[str, Any]:
    """Identify a hidden rig and compare the result with the truth."""
    began, cost = time.monotonic(), time.process_time()
    result: dict[str, Any] = {"name": hidden.name, "wrong": hidden.wrong, "refused": "", "unknowns": []}
    try:
        found = identify(hidden.recording, identified_task(hidden.rig), read_rig(hidden.rig))
    except HydroError as error:
        return result | {"refused": str(error), "share": None, "explained": "", "time": time.monotonic() - began}
    fit = found.fit
    for one in fit.unknowns:
        value = hidden.true[one.name]
        away = abs(value - 0.5 * (one.low + one.high)) / max((one.high - one.low) / 3.92, 1e-300)
        row = {"name": one.name, "determined": fit.knows(one), "side": one.side}
        within = {"within": bool(one.low <= value <= one.high), "left": one.remaining, "away": float(away)}
        result["unknowns"].append(row | within)
    return result | {
        "refused": "" if found.describes else found.verdict(),
        "share": None if np.isnan(found.share) else found.share,
        "explained": f"{int(fit.explained.sum())} of {len(fit.misfit)} windows explained",
        "time": time.monotonic() - began,
        "core": time.process_time() - cost,
    }


def told(result: dict[str, Any]) -> str:
    """One line about one rig."""
    if result["refused"]:
        return f"{result['name']}: refused: {result['refused']}"
    known = [row for row in result["unknowns"] if row["determined"]]
    words = f"{sum(row['within'] for row in known)} of {len(known)} determined values inside"
    if known:
        worst = max(known, key=lambda row: row["away"])
        words += f", farthest {worst['away']:.1f} σ ({worst['name']})"
    for row in result["unknowns"]:
        if row["side"]:
            words += (
                f"; {row['name']} {'at least' if row['side'] > 0 else 'at most'}: {'yes' if row['within'] else 'no'}"
            )
    return (
        f"{result['name']}: {words}; {result['explained']}; {result['time']:.0f} s, {result['core']:.0f} s of one core"
    )


def main() -> None:
    """Identify the hidden rigs and print one line for each, then a table of all parameters."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--rigs", type=int, default=40)
    parser.add_argument("--first", type=int, default=0, help="the first seed's place among the seeds")
    parser.add_argument("--new-rig", action="store_true", help="a rig of hydro new-rig for each seed")
    parser.add_argument("--folder", type=Path, default=None, help="for recordings and results, which it keeps")
    parser.add_argument("--rig", default=None, help="a rig whose ranges the hidden rigs are drawn from")
    parser.add_argument("--controller", default="pid")
    parser.add_argument("--duration", type=float, default=20.0, help="s")
    parser.add_argument("--family", default=None, help="of references; default: drawn")
    parser.add_argument("--without", nargs="+", default=[], choices=SENSORS[1:], help="sensors that are absent")
    parser.add_argument("--validation", action="store_true", help="validation seeds instead of test seeds")
    arguments = parser.parse_args()
    print(f"{os.cpu_count()} cores; load {os.getloadavg()[0]:.1f}")
    numbers = range(arguments.first, arguments.first + arguments.rigs)
    skip = VALIDATION_SKIP if arguments.new_rig else 0
    seeds = THRESHOLDS if arguments.validation else HIDDEN_RIGS if arguments.new_rig else EVALUATION
    results = []
    with tempfile.TemporaryDirectory() as name:
        folder = arguments.folder or Path(name)
        folder.mkdir(parents=True, exist_ok=True)
        for number in numbers:
            seed = seeds.take(1, number + (skip if arguments.validation else 0))[0]
            kept = folder / f"{seed}-result.json"
            if not kept.exists():
                make = hidden_rig(folder, seed, number, arguments.duration) if arguments.new_rig else None
                write_text(kept, json.dumps(judged(make or rig_of_a_task(folder, seed, arguments))))
            results.append(json.loads(kept.read_text(encoding="utf-8")))
            print(f"{seed}: {told(results[-1])}", flush=True)
    _report(results)


def _report(results: list[dict[str, Any]]) -> None:
    right = [result for result in results if not result["wrong"]]
    done = [result for result in right if not result["refused"]]
    wrong = [result for result in results if result["wrong"]]
    print(f"\n{len(right)} rigs, {len(right) - len(done)} refused", end="")
    print(f"; with a wrong fixed number {sum(bool(one['refused']) for one in wrong)} of {len(wrong)} refused"
          if wrong else "")  # fmt: skip
    shares = np.array([result["share"] for result in done if result["share"] is not None])
    if len(shares):
        print(
            f"share of the position's variance: median {100 * np.median(shares):.3f} %, "
            f"lowest {100 * shares.min():.3f} %; at least 95 % in {np.mean(shares >= 0.95):.0%}, "
            f"at least 99 % in {np.mean(shares >= 0.99):.0%} of the rigs"
        )
    if done:
        times = np.array([[result["time"], result["core"]] for result in done])
        print(f"time: median {np.median(times[:, 0]):.0f} s, longest {times[:, 0].max():.0f} s; "
              f"of one core {np.median(times[:, 1]):.0f} s, {times[:, 1].max():.0f} s")  # fmt: skip
    rows = [row for result in done for row in result["unknowns"]]
    known = [row for row in rows if row["determined"]]
    if known:
        inside = sum(row["within"] for row in known)
        print(f"determined: {len(known) / len(rows):.1%} of the unknowns; within their 95 % interval: "
              f"{inside / len(known):.1%} ({inside} of {len(known)}); "
              f"beyond {FAR:g} σ: {sum(row['away'] > FAR for row in known)}")  # fmt: skip
        by_rig = [[row["within"] for row in result["unknowns"] if row["determined"]] for result in done]
        shares_within = np.array([np.mean(one) for one in by_rig if one])
        print(f"rigs with at least 90 % of their determined unknowns within: {np.mean(shares_within >= 0.9):.0%}")
    for kind in KINDS:
        some = [one for one in right if kind in one["name"]]
        own = [row for one in some if not one["refused"] for row in one["unknowns"]]
        sure = [row for row in own if row["determined"]]
        if sure:
            print(f"{kind}: {len(some)} rigs, {sum(bool(one['refused']) for one in some)} refused; determined "
                  f"{len(sure) / len(own):.1%}, inside {np.mean([row['within'] for row in sure]):.1%} of {len(sure)}, "
                  f"beyond {FAR:g} σ {sum(row['away'] > FAR for row in sure)}")  # fmt: skip
    one_sided = [row for row in rows if row["side"]]
    print(f"one end known: {len(one_sided)}, of which {sum(row['within'] for row in one_sided)} hold the truth")
    print(f"\n{'unknown':32} determined  within  median uncertainty left")
    for name in dict.fromkeys(row["name"] for row in rows):
        own = [row for row in rows if row["name"] == name]
        sure = [row["within"] for row in own if row["determined"]]
        within = f"{np.mean(sure):6.0%}" if sure else "     –"
        left = np.median([row["left"] for row in own])
        print(f"{name:32} {np.mean([row['determined'] for row in own]):9.0%}  {within}  {left:8.3f}")


if __name__ == "__main__":
    main()
