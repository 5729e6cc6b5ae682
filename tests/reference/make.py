"""Pinned trajectories: runs of the reference solver (Radau, relative tolerance 1e-10), kept as text.

Run from the repository root after a deliberate change of the physics: python tests/reference/make.py
"""

import json
import math
from pathlib import Path

import numpy as np

from hydro_env import PlantParameters, resistance_from_flow, simulate
from hydro_env.plant.states import STATE_NAMES

FOLDER = Path(__file__).parent
RIGS = FOLDER.parents[1] / "configs" / "rigs"
SAMPLE_TIME = 2.5e-3


def moves(*pieces):
    """Voltages held for numbers of samples."""
    return np.concatenate([np.full(count, value) for value, count in pieces])


def sweep(amplitude, count):
    """Sinusoid of rising frequency, 1 to 15 Hz."""
    time = np.arange(count) * SAMPLE_TIME
    return amplitude * np.sin(2 * math.pi * (1.0 + 7.0 * time / time[-1]) * time)


def cases():
    """Name → (parameters, voltage, initial state)."""
    paper = PlantParameters.from_yaml(RIGS / "kovari_2015.yaml")
    leaking = paper.replace(leakage={"internal_resistance": resistance_from_flow(2.0)})
    throttled = paper.replace(leakage={"orifice_gain": 3e-3 / 60 / math.sqrt(100e5)}, friction={"model": "lugre"})
    stop = moves((4.0, 30), (0.0, 40), (-10.0, 20), (10.0, 10), (0.0, 20))
    return {
        "paper_start_stop": (paper, stop, {"position": 0.01}),
        "paper_worn_seal": (leaking, stop, {"position": 0.01}),
        "paper_throttle_lugre": (throttled, sweep(3.0, 120), {"position": 0.03, "velocity": 0.05}),
        "symmetric": (PlantParameters.from_yaml(RIGS / "symmetric_eha.yaml"), sweep(5.0, 120), {}),
        "aalborg": (PlantParameters.from_yaml(RIGS / "aalborg_svsdp_2017.yaml"), stop, {}),
        "pump_ideal_valve": (
            paper.replace(supply={"model": "pump"}, valve={"model": "ideal"}),
            moves((3.0, 40), (-3.0, 40), (0.0, 40)),
            {},
        ),
    }


def described(parameters, voltage, start):
    """All that a trajectory depends on, as one line of JSON."""
    return json.dumps(
        {
            "parameters": parameters.model_dump(mode="json"),
            "voltage": [float(f"{value:.9g}") for value in voltage],
            "start": start,
            "sample_time": SAMPLE_TIME,
        },
        sort_keys=True,
    )


def read(name):
    """(description, states) of a pinned trajectory."""
    lines = (FOLDER / f"{name}.csv").read_text(encoding="utf-8").splitlines()
    states = np.array([[float(value) for value in line.split(",")] for line in lines[2:]])
    assert lines[1] == ",".join(STATE_NAMES)
    return lines[0].removeprefix("# "), states


def main():
    """Write every trajectory."""
    for name, (parameters, voltage, start) in cases().items():
        states = simulate(parameters, voltage, SAMPLE_TIME, start, method="radau").states
        rows = [",".join(f"{value:.10g}" for value in row) for row in states]
        lines = [f"# {described(parameters, voltage, start)}", ",".join(STATE_NAMES), *rows]
        (FOLDER / f"{name}.csv").write_text("\n".join(lines) + "\n", encoding="utf-8")
        print(f"{name}: {len(states)} samples")


if __name__ == "__main__":
    main()
