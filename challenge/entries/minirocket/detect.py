"""MiniRocket (Dempster, Schmidt & Webb, KDD 2021) of aeon, and a logistic regression; no code of this project.

pip install aeon
python detect.py --train DATA   # some minutes; writes model.joblib beside this file
hydro score --data DATA --code FOLDER
"""

import argparse
import json
import sys
from collections import deque
from pathlib import Path

import joblib
import numpy as np
import pandas as pd
from aeon.transformations.collection.convolution_based import MiniRocket
from sklearn.linear_model import LogisticRegression
from sklearn.pipeline import make_pipeline
from sklearn.preprocessing import StandardScaler

MODEL = Path(__file__).with_name("model.joblib")
LENGTH, SAMPLES, LASTING = 10.0, 500, 10  # s of a look, samples of it, and looks whose mean is the score


def inputs(rows, axis):
    """Six signals at SAMPLES times, (6, SAMPLES), in parts of the axis's own supply, full speed and stroke."""
    time, position, a, b, spool, command = rows.T
    spool = np.where(np.isfinite(spool), spool, 10.0 * command)
    supply = axis["supply_pressure"] / 1e5
    speed = np.gradient(1e-3 * position, time) * axis["area_a"] / axis["full_flow"]
    speed = np.convolve(speed, np.ones(5) / 5, mode="same")
    signals = (speed, a / supply, b / supply, (a - b) / supply, spool / 100.0, command / 10.0)
    wanted = np.linspace(time[-1] - LENGTH, time[-1], SAMPLES)
    return np.stack([np.interp(wanted, time, values) for values in signals]).astype(np.float32)


def known(figures):
    """The figures that an axis has."""
    return {name: value for name, value in figures.items() if not pd.isna(value)}


def train(data):
    """Learn from the training split alone."""
    axes = {row["axis"]: known(row) for row in pd.read_parquet(data / "axes.parquet").to_dict("records")}
    labels = pd.read_parquet(data / "train_labels").set_index("recording")
    looks, leaks = [], []
    for number, part in pd.read_parquet(data / "train").groupby("recording"):
        axis, label = axes[part["axis"].iloc[0]], labels.loc[number]
        rows = part.drop(columns=["recording", "axis"]).to_numpy(dtype=float)
        for end in np.arange(4.0, rows[-1, 0] + 4.0, 4.0):
            chosen = rows[(rows[:, 0] < end) & (rows[:, 0] >= end - LENGTH)]
            if len(chosen) > 20:
                looks.append(inputs(chosen, axis))
                leaks.append(bool(label["leak"] and chosen[-1, 0] >= label["onset"]))
    rocket = MiniRocket(n_kernels=2000, random_state=0)
    features = np.asarray(rocket.fit_transform(np.array(looks)))
    model = make_pipeline(StandardScaler(), LogisticRegression(C=1e-3, max_iter=500)).fit(features, leaks)
    joblib.dump((rocket, model), MODEL)


def detect():
    """Answer looks from the standard input."""
    rocket, model = joblib.load(MODEL)
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
                features = np.asarray(rocket.transform(inputs(np.array(rows), axis)[None]))
                probability = model.predict_proba(features)[0, 1]
                recent.append(float(np.log(probability + 1e-9) - np.log1p(1e-9 - probability)))
                answer = {"score": float(np.mean(recent)), "probability": float(probability)}
            print(json.dumps(answer), flush=True)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--train", type=Path)
    given = parser.parse_args()
    if given.train:
        train(given.train)
    else:
        detect()
