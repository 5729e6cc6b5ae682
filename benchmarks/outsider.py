"""A leak detector for the benchmark of leaking axes without any code of this project: statistics and a random forest.

    python benchmarks/outsider.py FOLDER --split test --output outsider.parquet

Every second it looks at the last ten seconds: statistics of each signal and of simple combinations, and a forest that
says how probable each cause is. Needs pandas, pyarrow and scikit-learn.
"""

import argparse
from pathlib import Path

import numpy as np
import pandas as pd
from sklearn.ensemble import RandomForestClassifier, RandomForestRegressor
from sklearn.linear_model import LogisticRegression
from sklearn.pipeline import make_pipeline
from sklearn.preprocessing import RobustScaler

LENGTH, STEP = 2000, 200  # rows of a look, and between two looks: 10 s and 1 s at 200 Hz


def features(rows: pd.DataFrame) -> dict[str, float]:
    """Statistics of one look."""
    position, command = rows["position [mm]"].to_numpy(), rows["command [V]"].to_numpy()
    a, b, spool = (rows[name].to_numpy() for name in ("pressure_a [bar]", "pressure_b [bar]", "spool_position [%]"))
    speed = np.convolve(np.gradient(position), np.ones(9) / 9, mode="same")  # mm per row
    signals = {"speed": speed, "command": command, "a": a, "b": b, "spool": spool}
    signals |= {"difference": a - b, "sum": a + b, "lag": spool - 10.0 * command}
    found: dict[str, float] = {}
    for name, values in signals.items():
        found |= {f"{name} mean": values.mean(), f"{name} std": values.std()}
        found |= {f"{name} {q}": np.quantile(values, q) for q in (0.1, 0.5, 0.9)}
    # What an engineer would look at: how much the axis moves for a command, and what it needs to stand still.
    found["gain"] = float(speed @ spool / (spool @ spool + 1e-6))
    still = np.abs(speed) < 0.01
    found["spool at rest"] = float(spool[still].mean()) if still.any() else 0.0
    found["difference at rest"] = float((a - b)[still].mean()) if still.any() else 0.0
    design = np.stack([spool, spool * (a - b), a - b, np.ones(len(a))], axis=1)
    weights = np.linalg.lstsq(design, speed, rcond=None)[0]
    return found | {f"law {number}": weight for number, weight in enumerate(weights)}


def looks(recordings: pd.DataFrame) -> pd.DataFrame:
    """A row of features per look at each recording."""
    found = []
    for number, rows in recordings.groupby("recording"):
        ends = range(LENGTH, len(rows) + 1, STEP) if len(rows) >= LENGTH else [len(rows)]
        for end in ends:
            part = rows.iloc[max(end - LENGTH, 0) : end]
            found.append({"recording": number, "time": part["time [s]"].iloc[-1], **features(part)})
    return pd.DataFrame(found)


def main() -> None:
    """Train on the training split, predict another."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--split", default="test")
    parser.add_argument("--output", type=Path, default=Path("outsider.parquet"))
    parser.add_argument("--linear", action="store_true", help="a logistic regression instead of the forest")
    arguments = parser.parse_args()
    train = looks(pd.read_parquet(arguments.folder / "train"))
    labels = pd.read_parquet(arguments.folder / "train_labels").set_index("recording")
    own = labels.loc[train["recording"]].reset_index(drop=True)
    names = [column for column in train if column not in ("recording", "time")]
    leaks = own["leak"] & (train["time"] >= own["onset"])
    cause = np.where(own["leak"] & ~leaks, "none", own["cause"])
    forest = RandomForestClassifier(300, min_samples_leaf=5, n_jobs=-1, random_state=0)
    if arguments.linear:
        forest = make_pipeline(RobustScaler(), LogisticRegression(max_iter=2000, C=0.1))
    forest.fit(train[names], cause)
    sizes = RandomForestRegressor(100, min_samples_leaf=5, n_jobs=-1, random_state=0)
    sizes.fit(train.loc[leaks, names], np.log(own.loc[leaks, "size"]))
    seen = looks(pd.read_parquet(arguments.folder / arguments.split))
    shares = forest.predict_proba(seen[names])
    result = seen[["recording", "time"]].copy()
    result["probability"] = shares[:, list(forest.classes_).index("internal leak")]
    # Evidence lasts: the mean of the last ten looks.
    result["score"] = result.groupby("recording")["probability"].transform(lambda s: s.rolling(10, 1).mean())
    result["cause"] = forest.classes_[shares.argmax(axis=1)]
    result["size"] = np.exp(sizes.predict(seen[names]))
    result.to_parquet(arguments.output, index=False)


if __name__ == "__main__":
    main()
