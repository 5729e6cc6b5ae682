"""A one-dimensional convolution on the raw signals of the last ten seconds; no code of this project.

    python detect.py --train DATA   # some minutes; writes model.pt beside this file
    hydro score --data DATA --code FOLDER

Signals are in parts of the axis's own supply, full speed and stroke, which the nameplate tells. Needs numpy, pandas,
pyarrow and torch.
"""

import argparse
import json
import sys
from collections import deque
from pathlib import Path

import numpy as np
import pandas as pd
import torch
from torch import nn

MODEL = Path(__file__).with_name("model.pt")
LENGTH, SAMPLES, LASTING = 10.0, 1000, 10  # s of a look, samples of it, and looks whose mean is the score
EPOCHS, BATCH = 12, 64


def network():
    """Five convolutions of stride 2 to 4, then the mean over time; a number for the leak and one for its size."""
    layers, channels = [], 7
    for width, stride in ((32, 4), (64, 4), (64, 2), (64, 2), (64, 2)):
        layers += [nn.Conv1d(channels, width, 7, stride, 3), nn.BatchNorm1d(width), nn.ReLU()]
        channels = width
    return nn.Sequential(*layers, nn.AdaptiveAvgPool1d(1), nn.Flatten(), nn.Dropout(0.3), nn.Linear(channels, 2))


def inputs(rows, axis):
    """Seven signals at SAMPLES times, (7, SAMPLES), from rows (T, 6)."""
    time, position, a, b, spool, command = rows.T
    spool = np.where(np.isfinite(spool), spool, 10.0 * command)
    supply = axis["supply_pressure"] / 1e5
    speed = np.gradient(1e-3 * position, time) * axis["area_a"] / axis["full_flow"]
    speed = np.convolve(speed, np.ones(5) / 5, mode="same")
    place = 2e-3 * position / axis["stroke"]
    signals = (place, speed, a / supply, b / supply, (a - b) / supply, spool / 100.0, command / 10.0)
    wanted = np.linspace(time[-1] - LENGTH, time[-1], SAMPLES)
    return np.stack([np.interp(wanted, time, values) for values in signals]).astype(np.float32)


def known(figures):
    """The figures that an axis has."""
    return {name: value for name, value in figures.items() if not pd.isna(value)}


def train(data):
    """Learn from the training split alone."""
    torch.manual_seed(0)
    torch.set_num_threads(1)
    axes = {row["axis"]: known(row) for row in pd.read_parquet(data / "axes.parquet").to_dict("records")}
    labels = pd.read_parquet(data / "train_labels").set_index("recording")
    looks, leaks, sizes = [], [], []
    for number, part in pd.read_parquet(data / "train").groupby("recording"):
        axis, label = axes[part["axis"].iloc[0]], labels.loc[number]
        rows = part.drop(columns=["recording", "axis"]).to_numpy(dtype=float)
        for end in np.arange(2.0, rows[-1, 0] + 2.0, 2.0):
            chosen = rows[(rows[:, 0] < end) & (rows[:, 0] >= end - LENGTH)]
            if len(chosen) > 20:
                looks.append(inputs(chosen, axis))
                leaks.append(bool(label["leak"] and chosen[-1, 0] >= label["onset"]))
                sizes.append(np.log(label["size"] / axis["smallest_leak"]))
    values = [torch.from_numpy(np.array(part, np.float32)) for part in (looks, leaks, sizes)]
    net, order = network(), np.random.default_rng(0)
    optimiser = torch.optim.AdamW(net.parameters(), lr=2e-3, weight_decay=1e-2)
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimiser, EPOCHS)
    for epoch in range(EPOCHS):
        for chosen in np.array_split(order.permutation(len(looks)), len(looks) // BATCH + 1):
            signals, leak, size = (part[chosen] for part in values)
            found = net(signals)
            loss = nn.functional.binary_cross_entropy_with_logits(found[:, 0], leak)
            loss = loss + (0.1 * leak * (found[:, 1] - size) ** 2).mean()
            optimiser.zero_grad()
            loss.backward()
            optimiser.step()
        schedule.step()
        print(f"epoch {epoch + 1} of {EPOCHS}: loss {loss.item():.3f}", flush=True)
    torch.save(net.state_dict(), MODEL)


def detect():
    """Answer looks from the standard input."""
    torch.set_num_threads(1)
    net = network()
    net.load_state_dict(torch.load(MODEL, weights_only=True))
    net.eval()
    rows, recent, axis = [], deque(maxlen=LASTING), {}
    for line in sys.stdin:
        if line.startswith("{"):
            axis, rows, recent = json.loads(line)["axis"], [], deque(maxlen=LASTING)
        elif line.strip():
            rows.append([float(cell or "nan") for cell in line.split(",")])
        else:
            rows = [row for row in rows if row[0] >= rows[-1][0] - LENGTH]
            answer = {}
            if len(rows) > 20:
                with torch.no_grad():
                    logit, size = net(torch.from_numpy(inputs(np.array(rows), axis))[None])[0].tolist()
                recent.append(logit)
                probability = 1.0 / (1.0 + np.exp(-np.clip(logit, -30.0, 30.0)))
                answer = {"score": float(np.mean(recent)), "probability": float(probability)}
                answer["size"] = float(np.exp(size)) * axis["smallest_leak"]
            print(json.dumps(answer), flush=True)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--train", type=Path)
    given = parser.parse_args()
    if given.train:
        train(given.train)
    else:
        detect()
