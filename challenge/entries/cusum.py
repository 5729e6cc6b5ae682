"""The textbook's answer: an observer's residual of the flow balance, and a CUSUM; no code of this project.

    python challenge/entries/cusum.py DATA cusum.parquet [--split test]

The valve gives the flow, the area takes it, the oil is compressed; what is left over grows with the difference of the
pressures where the seal leaks (Page 1954; Gustafsson, Adaptive Filtering and Change Detection, 2000). Its unknowns,
the valve's null and gain, follow from recursive least squares beside the leak. It knows the nameplate, and learns
nothing.
"""

import argparse
from collections.abc import Iterator, Mapping
from pathlib import Path

import numpy as np
import pandas as pd

OIL = 1.2e9  # Pa, bulk modulus with some air: typical
FORGETTING, DRIFT = 0.98, 1.5  # of least squares, per look; of the CUSUM, in smallest leaks
PRIOR = np.array([20.0, 0.02, 0.1])  # spread of leak (in smallest leaks), of the valve's null, of its gain
NOISE, TOGETHER = 0.01, 10  # of the residual, in full flows; rows whose mean is one equation
EVERY, BEFORE = 1.0, 4  # s between two looks; rows of the look before that it also uses


def equations(rows: np.ndarray, axis: Mapping[str, float]) -> np.ndarray:
    """The residual and its derivatives to leak, null and gain, (4, equations), from rows (T, 6)."""
    time, position, a, b, spool, command = rows.T
    opening = np.where(np.isfinite(spool), spool / 100.0, command / 10.0)
    a, b, position = 1e5 * a, 1e5 * b, 1e-3 * position
    overlap, full_flow = axis["overlap"], axis["full_flow"]
    opening = np.sign(opening) * np.maximum(np.abs(opening) - overlap, 0.0) / (1.0 - overlap)
    drop = np.where(opening > 0.0, axis["supply_pressure"] - a, a)
    gain = axis["rated_flow"] / np.sqrt(35e5) * np.sqrt(np.maximum(drop, 0.0)) / full_flow
    volume = axis["area_a"] * (0.6 * axis["stroke"] + position)
    taken = axis["area_a"] * np.gradient(position, time) + volume / OIL * np.gradient(a, time)
    leak = axis["smallest_leak"] / 6e4 * (a - b) / 1e7 / full_flow
    terms = np.stack([gain * opening - taken / full_flow, leak, gain, gain * opening])
    blocks: np.ndarray = terms[:, : len(time) // TOGETHER * TOGETHER].reshape(4, -1, TOGETHER).mean(axis=2)
    return blocks


def looks(rows: np.ndarray, axis: Mapping[str, float]) -> Iterator[tuple[float, float, float]]:
    """Time, evidence and size (l/min at 100 bar) of each look at a recording (T, 6); a look sees no later row."""
    left, right, evidence, leak = np.zeros((3, 3)), np.zeros(3), 0.0, 0.0
    ends = np.searchsorted(rows[:, 0], np.arange(EVERY, rows[-1, 0] + EVERY, EVERY) - 1e-9)
    begin = 0
    for end in np.unique(ends):
        if end - begin >= 4 * TOGETHER:
            residual, *derivatives = equations(rows[begin:end], axis)
            inputs = np.array(derivatives)
            left = FORGETTING * left + inputs @ inputs.T / NOISE**2
            right = FORGETTING * right + inputs @ residual / NOISE**2
            leak, *valve = np.linalg.solve(left + np.diag(PRIOR**-2.0), right)
            power = inputs[0] @ inputs[0] + (0.3 * NOISE) ** 2
            now = inputs[0] @ (residual - valve @ inputs[1:]) / power  # of these rows alone
            evidence = max(evidence + float(np.clip(now, -20.0, 20.0)) - DRIFT, 0.0)
        yield rows[end - 1, 0], evidence, max(leak, 0.1) * axis["smallest_leak"]
        begin = max(end - BEFORE, 0)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("data", type=Path)
    parser.add_argument("output", type=Path)
    parser.add_argument("--split", default="test")
    given = parser.parse_args()
    plates = pd.read_parquet(given.data / "axes.parquet").set_index("axis")
    answers = []
    for (number, axis), part in pd.read_parquet(given.data / given.split).groupby(["recording", "axis"]):
        rows = part.drop(columns=["recording", "axis"]).to_numpy(dtype=float)
        answers += [(number, *look) for look in looks(rows, plates.loc[axis])]
    pd.DataFrame(answers, columns=["recording", "time", "score", "size"]).to_parquet(given.output, index=False)
