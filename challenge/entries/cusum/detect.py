"""The textbook's answer: an observer's residual of the flow balance, and a CUSUM; no code of this project.

    hydro score --data DATA --code challenge/entries/cusum

The valve gives the flow, the area takes it, the oil is compressed; what is left over grows with the difference of the
pressures where the seal leaks (Page 1954; Gustafsson, Adaptive Filtering and Change Detection, 2000). Its unknowns,
the valve's null and gain, follow from recursive least squares beside the leak. It
knows the nameplate, and learns nothing.
"""

import json
import sys

import numpy as np

OIL = 1.2e9  # Pa, bulk modulus with some air: typical
FORGETTING, DRIFT = 0.98, 1.5  # of least squares, per look; of the CUSUM, in smallest leaks
PRIOR = np.array([20.0, 0.02, 0.1])  # spread of leak (in smallest leaks), of the valve's null, of its gain
NOISE, TOGETHER = 0.01, 10  # of the residual, in full flows; rows whose mean is one equation


class Observer:
    """Leak of one recording, and the evidence so far."""

    def __init__(self, axis):
        self.axis, self.rows, self.evidence = axis, [], 0.0
        self.left, self.right = np.zeros((3, 3)), np.zeros(3)  # of the normal equations
        self.leak = 0.0

    def look(self):
        """Use the rows since the last look; the evidence and the size (l/min at 100 bar)."""
        axis, rows = self.axis, np.array(self.rows)
        self.rows = self.rows[-4:]
        if len(rows) < 4 * TOGETHER:
            return self.evidence, self.size()
        time, position, a, b, spool, command = rows.T
        opening = np.where(np.isfinite(spool), spool / 100.0, command / 10.0)
        a, b, position = 1e5 * a, 1e5 * b, 1e-3 * position
        supply, overlap = axis["supply_pressure"], axis.get("overlap", 0.0)
        opening = np.sign(opening) * np.maximum(np.abs(opening) - overlap, 0.0) / (1.0 - overlap)
        drop = np.where(opening > 0.0, supply - a, a)
        gain = axis["rated_flow"] / np.sqrt(35e5) * np.sqrt(np.maximum(drop, 0.0)) / axis["full_flow"]
        volume = axis["area_a"] * (0.6 * axis["stroke"] + position)
        taken = axis["area_a"] * np.gradient(position, time) + volume / OIL * np.gradient(a, time)
        leak = axis["smallest_leak"] / 6e4 * (a - b) / 1e7 / axis["full_flow"]
        terms = np.stack([gain * opening - taken / axis["full_flow"], leak, gain, gain * opening])
        residual, *inputs = terms[:, : len(time) // TOGETHER * TOGETHER].reshape(4, -1, TOGETHER).mean(axis=2)
        inputs = np.array(inputs)
        self.left = FORGETTING * self.left + inputs @ inputs.T / NOISE**2
        self.right = FORGETTING * self.right + inputs @ residual / NOISE**2
        known = np.linalg.solve(self.left + np.diag(PRIOR**-2.0), self.right)
        self.leak = known[0]
        power = inputs[0] @ inputs[0] + (0.3 * NOISE) ** 2
        now = inputs[0] @ (residual - known[1:] @ inputs[1:]) / power  # of these rows alone
        self.evidence = max(self.evidence + float(np.clip(now, -20.0, 20.0)) - DRIFT, 0.0)
        return self.evidence, self.size()

    def size(self):
        """Of the leak, l/min at 100 bar."""
        return max(float(self.leak), 0.1) * self.axis["smallest_leak"]


def main():
    """Answer looks from the standard input."""
    observer = None
    for line in sys.stdin:
        if line.startswith("{"):
            observer = Observer(json.loads(line)["axis"])
        elif line.strip():
            observer.rows.append([float(cell or "nan") for cell in line.split(",")])
        else:
            score, size = observer.look()
            print(json.dumps({"score": score, "size": size} if np.isfinite(score) else {}), flush=True)


if __name__ == "__main__":
    main()
