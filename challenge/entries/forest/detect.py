"""A random forest on statistics of the last ten seconds, with the nameplate if it is given; no code of this project.

    python detect.py --train DATA [--signals-only]   # some minutes; writes model.joblib beside this file
    hydro score --data DATA --code FOLDER [--signals-only]

Needs numpy, pandas, pyarrow and scikit-learn.
"""

import argparse
import json
import sys
from collections import deque
from pathlib import Path

import joblib
import numpy as np
import pandas as pd
from sklearn.ensemble import RandomForestClassifier, RandomForestRegressor

MODEL = Path(__file__).with_name("model.joblib")
LENGTH, LASTING = 10.0, 10  # s of a look, and looks whose mean is the score
POSITION, A, B, SPOOL, COMMAND = range(1, 6)  # columns of a row; 0 is the time
UNKNOWN = "none"


def statistics(rows, axis):
    """Numbers of one look, from rows (T, 6) in the units of the files, and the figures of the axis, if known."""
    time, position, a, b, spool, command = rows.T
    spool = np.where(np.isfinite(spool), spool, 10.0 * command)
    speed = np.convolve(np.gradient(position, time), np.ones(9) / 9, mode="same")
    if axis:  # parts of the axis's own supply and full speed, so that axes compare
        supply, flow = axis["supply_pressure"] / 1e5, axis["full_flow"]
        a, b, speed = a / supply, b / supply, speed * 1e-3 * axis["area_a"] / flow
        spool, command = spool / 100.0, command / 10.0
    signals = {"speed": speed, "command": command, "a": a, "b": b, "spool": spool}
    signals |= {"difference": a - b, "sum": a + b, "lag": spool - (command if axis else 10.0 * command)}
    found = {}
    for name, values in signals.items():
        found |= {f"{name} mean": values.mean(), f"{name} std": values.std()}
        found |= {f"{name} {q}": np.quantile(values, q) for q in (0.1, 0.5, 0.9)}
    # What an engineer would look at: how much the axis moves for a command, and what it needs to stand still.
    found["gain"] = speed @ spool / (spool @ spool + 1e-6)
    still = np.abs(speed) < 0.01
    found["spool at rest"] = spool[still].mean() if still.any() else 0.0
    found["difference at rest"] = (a - b)[still].mean() if still.any() else 0.0
    drops = [spool, spool * (a - b), a - b, np.ones(len(a))]
    if axis:  # flow through an opening grows with the root of its pressure drop
        forth = np.maximum(spool, 0.0) * np.sqrt(np.maximum(1.0 - a, 0.0))
        drops += [forth, np.minimum(spool, 0.0) * np.sqrt(np.maximum(a, 0.0))]
    weights = np.linalg.lstsq(np.stack(drops, axis=1), speed, rcond=None)[0]
    found |= {f"law {number}": weight for number, weight in enumerate(weights)}
    return found | {name: axis[name] for name in ("control_period", "overlap", "area_b", "area_a") if name in axis}


def looks(recordings, axes, every):
    """A row of statistics for each look, every so many seconds."""
    found = []
    for number, part in recordings.groupby("recording"):
        rows = part.drop(columns=["recording", "axis"]).to_numpy(dtype=float)
        axis = axes.get(part["axis"].iloc[0], {})
        for end in np.arange(every, rows[-1, 0] + every, every):
            chosen = rows[(rows[:, 0] < end) & (rows[:, 0] >= end - LENGTH)]
            if len(chosen) > 20:
                found.append({"recording": number, "time": chosen[-1, 0], **statistics(chosen, axis)})
    return pd.DataFrame(found)


def train(data, signals_only):
    """Learn from the training split alone."""
    table = pd.read_parquet(data / "axes.parquet")
    axes = {} if signals_only else {r["axis"]: known(r) for r in table.to_dict("records")}
    rows = looks(pd.read_parquet(data / "train"), axes, 5.0)
    labels = pd.read_parquet(data / "train_labels").set_index("recording").loc[rows["recording"]].reset_index(drop=True)
    scale = labels["axis"].map(table.set_index("axis")["smallest_leak"])
    names = [column for column in rows if column not in ("recording", "time")]
    leaks = labels["leak"] & (rows["time"] >= labels["onset"])
    cause = np.where(labels["leak"] & ~leaks, UNKNOWN, labels["cause"])
    inputs = rows[names].fillna(0.0)
    forest = RandomForestClassifier(300, min_samples_leaf=5, n_jobs=-1, random_state=0).fit(inputs, cause)
    sizes = labels["size"] / (1.0 if signals_only else scale)
    regressor = RandomForestRegressor(100, min_samples_leaf=5, n_jobs=-1, random_state=0)
    regressor.fit(inputs[leaks], np.log(sizes[leaks]))
    forest.n_jobs = regressor.n_jobs = 1
    joblib.dump({"names": names, "forest": forest, "sizes": regressor, "axis": not signals_only}, MODEL)


def known(figures):
    """The figures that an axis has."""
    return {name: value for name, value in figures.items() if not pd.isna(value)}


def detect():
    """Answer looks from the standard input."""
    model = joblib.load(MODEL)
    forest, leak = model["forest"], list(model["forest"].classes_).index("internal leak")
    rows, recent, axis = [], deque(maxlen=LASTING), {}
    for line in sys.stdin:
        if line.startswith("{"):
            head = json.loads(line)
            axis = head.get("axis", {}) if model["axis"] else {}
            rows, recent = [], deque(maxlen=LASTING)
        elif line.strip():
            rows.append([float(cell or "nan") for cell in line.split(",")])
        else:
            rows = [row for row in rows if row[0] >= rows[-1][0] - LENGTH]
            answer = {}
            if len(rows) > 20:
                found = statistics(np.array(rows), axis)
                inputs = pd.DataFrame([found]).reindex(columns=model["names"]).fillna(0.0)
                shares = forest.predict_proba(inputs)[0]
                recent.append(shares[leak])
                size = float(np.exp(model["sizes"].predict(inputs)[0])) * axis.get("smallest_leak", 1.0)
                answer = {"score": float(np.mean(recent)), "probability": float(shares[leak]), "size": size}
                answer["cause"] = str(forest.classes_[shares.argmax()])
            print(json.dumps(answer), flush=True)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--train", type=Path)
    parser.add_argument("--signals-only", action="store_true")
    given = parser.parse_args()
    if given.train:
        train(given.train, given.signals_only)
    else:
        detect()
