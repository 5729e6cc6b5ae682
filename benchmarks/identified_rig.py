"""What a controller loses that was tuned on the identified rig instead of the true one, and what it gains by it.

Run: python benchmarks/identified_rig.py [--evaluations 420] [--plants 8] [--ppo-steps 0] [--folder FOLDER]

For each of three sets of nameplates: ``hydro new-rig`` writes the rough file, a plant drawn from its ranges is the
hidden truth, 20 s of it in a closed loop are recorded, and ``hydro identify`` reads them. Each controller is tuned on
the true rig, on the identified one, and on the rough file, with one budget, and judged on the true rig: test seeds, all
leaks and families of references. PPO, if asked for, corrects the flow linearisation. An interrupted run goes on where
it was.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

from hydro_agents import evaluate
from hydro_agents.controllers.base import Controller
from hydro_agents.controllers.registry import make_controller
from hydro_agents.learning.opponents import shipped
from hydro_agents.learning.policy import PolicyController
from hydro_agents.learning.settings import PPOSettings
from hydro_agents.learning.training import train_policy
from hydro_agents.learning.tuning import tune
from hydro_agents.running.seeds import LEARNING
from hydro_agents.study.settings import default_study
from hydro_env import PlantParameters, ServoHydraulicVectorEnv, TaskConfig
from hydro_env.files import read_yaml, validate, write_text, write_yaml
from hydro_env.plant.parameters import from_vector
from hydro_env.task.configuration import task_config
from hydro_env.task.nameplates import answers_from, new_rig
from hydro_env.task.rig import read_rig
from hydro_rig.identification.identification_page import identify_to_folder
from hydro_rig.identification.identify import identify
from hydro_rig.recordings.simulated import record_axis

NAMEPLATES = {
    "63/36 x 500 mm": {"bore": "63 mm", "rod": "36 mm", "stroke": "500 mm", "rated_flow": "40 l/min"}
    | {"bandwidth": "60 Hz", "supply_pressure": "160 bar", "mass": "300 kg", "tank_pressure": "2 bar"},
    "50/36 x 300 mm": {"bore": "50 mm", "rod": "36 mm", "stroke": "300 mm", "rated_flow": "19 l/min"}
    | {"bandwidth": "60 Hz", "supply_pressure": "120 bar", "mass": "120 kg", "tank_pressure": "2 bar"},
    "40/28 x 200 mm, hoses": {"bore": "40 mm", "rod": "28 mm", "stroke": "200 mm", "rated_flow": "12 l/min"}
    | {"bandwidth": "90 Hz", "supply_pressure": "100 bar", "mass": "60 kg", "tank_pressure": "2 bar"}
    | {"line_length": "1 m", "line_diameter": "8 mm", "line_kind": "hose"},
}
"""Answers to the questions of ``hydro new-rig``, by name of the rig."""

KINDS = ("pid", "flow_linearising")
DURATION = 20.0
"""s, of the recording."""


def hidden_truth(rough: Path, seed: int) -> PlantParameters:
    """A plant drawn from the ranges of a rig's file, with a healthy seal."""
    envs = ServoHydraulicVectorEnv(1, task_config(rig=rough), info=False)
    envs.reset(seed=seed)
    return from_vector(envs.axes.physical[0]).replace(leakage={"internal_resistance": 2e13})


def prepare(folder: Path, texts: dict[str, str], seed: int) -> list[str]:
    """Write ``rough.yaml``, ``truth.yaml``, ``recording.csv`` and ``found/`` of one rig, unless they exist."""
    rough, truth, recording = folder / "rough.yaml", folder / "truth.yaml", folder / "recording.csv"
    if (folder / "found" / "rig.yaml").exists():
        return []
    text, _ = new_rig(answers_from(texts), texts, str(rough))
    write_text(rough, text)
    hidden_truth(rough, seed).to_yaml(truth)
    config = task_config("as_given", rig=truth, episode_duration=DURATION)
    done = record_axis(recording, config, shipped("pid", config), seed, leakage_flow_lpm=0.03)
    lines = [] if done.failed_at is None else [f"the axis failed after {done.failed_at:g} s"]
    found = identify(recording, task_config(rig=rough), read_rig(rough))
    return [*lines, *identify_to_folder(folder / "found", found, True, "benchmarks/identified_rig.py")]


def tuned(kind: str, task: TaskConfig, folder: Path, evaluations: int) -> Controller:
    """A controller of a kind, tuned on a task; its gains are kept in the folder."""
    file = folder / f"{kind}.yaml"
    if not file.exists():
        log = folder / f"{kind}.csv"
        best = tune(kind, task, evaluations=evaluations, log=log, resume=log.exists())
        write_yaml(file, best.gains.model_dump(mode="json"))
    return make_controller(kind, task, read_yaml(file))


def trained(task: TaskConfig, base: Controller, folder: Path, steps: int) -> Controller:
    """PPO on top of a controller, with the settings of ``configs/studies/own_rig.yaml``; its weights are kept."""
    if not (folder / "policy.safetensors").exists():
        entry = default_study(Path("own_rig")).controllers["PPO on flow linearisation"]
        settings = validate(PPOSettings, entry.settings | {"total_steps": steps}, "PPO")
        resume = (folder / "checkpoint.safetensors").exists()
        train_policy(task, settings, base, folder=folder, resume=resume).save(folder / "policy")
    return PolicyController.load(folder / "policy")


def main() -> None:
    """Print one table row per rig and kind of controller."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--evaluations", type=int, default=420)
    parser.add_argument("--plants", type=int, default=8)
    parser.add_argument("--ppo-steps", type=int, default=0)
    parser.add_argument("--folder", type=Path, default=Path("results/identified_rig"))
    given = parser.parse_args()
    ratios: dict[str, list[float]] = {}
    print("| rig | controller | tuned on the true rig, mm | identified / true (95 %) | rough file / true (95 %) |")
    print("|---|---|---:|---:|---:|", flush=True)
    seeds = LEARNING.take(len(NAMEPLATES))
    for number, (name, texts) in enumerate(NAMEPLATES.items()):
        folder = given.folder / f"rig_{number}"
        lines = prepare(folder, texts, seeds[number])
        tasks = {
            "true": task_config("as_given", rig=folder / "truth.yaml"),
            "identified": task_config(rig=folder / "found" / "rig.yaml"),
            "rough": task_config(rig=folder / "rough.yaml"),
        }
        made: dict[str, dict[str, Controller]] = {}
        for place, task in tasks.items():
            own = folder / f"tuned_{place}"
            made[place] = {kind: tuned(kind, task, own, given.evaluations) for kind in KINDS}
            if given.ppo_steps:
                made[place]["ppo"] = trained(task, made[place]["flow_linearising"], own, given.ppo_steps)
        for kind in made["true"]:
            controllers = {place: controllers[kind] for place, controllers in made.items()}
            results = evaluate(tasks["true"], controllers, settings={"plants": given.plants})
            overall = results.ratios[results.ratios["group"] == "all"].set_index("controller")
            mean = results.cases.groupby("controller")["mean_error_mm"].mean()["true"]
            cells = [
                f"{row['ratio']:.3f} ({row['low']:.3f}–{row['high']:.3f})"
                for row in (overall.loc[place] for place in ("identified", "rough"))
            ]
            ratios.setdefault(kind, []).append(float(overall.loc["identified", "ratio"]))
            print(f"| {name} | {kind} | {mean:.4f} | {cells[0]} | {cells[1]} |", flush=True)
        for line in lines:
            print(f"  ({line})", flush=True)
    for kind, found in ratios.items():
        print(f"{kind}: identified / true, geometric mean of {len(found)} rigs: {np.exp(np.mean(np.log(found))):.3f}")


if __name__ == "__main__":
    main()
