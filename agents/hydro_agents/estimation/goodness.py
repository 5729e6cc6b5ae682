"""Whether a fit explains the readings: do the residuals look like the sensors' noise?"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

BLOCK = 20
"""Number of samples per block; the mean residual of each block is tested."""


def misfit_of(residual: Any, jacobian: Any, covariance: Any, known: NDArray[np.bool_]) -> Array:
    """Excess of the residuals over their expectation from noise after a fit, in standard deviations, (B,).

    The excess is infinite if it is not a number. Two sums of squares are tested, and the larger excess counts: of all
    residuals, and of their means over blocks of samples. A small model error changes slowly; it is hidden in the noise
    of single samples, but not in that of block means.

    Args:
        residual: over the noise, (B, channels · T), 0 where a reading is missing.
        jacobian: derivatives of the same readings, (B, P, channels · T), 0 where a reading is missing.
        covariance: of the unknowns, (B, P, P).
        known: readings that exist, (B, channels, T).
    """
    windows, channels, samples = known.shape
    starts = np.arange(0, samples, BLOCK)
    number = np.add.reduceat(known, starts, axis=2, dtype=np.int64).reshape(windows, -1)
    root = np.sqrt(np.maximum(number, 1))

    def sums(values: Any) -> Any:
        blocks = np.add.reduceat(values.reshape(*values.shape[:-1], channels, samples), starts, axis=-1)
        return blocks.reshape(*values.shape[:-1], -1)

    return np.maximum(
        _excess(residual, jacobian, covariance, known.sum(axis=(1, 2))),
        _excess(sums(residual) / root, sums(jacobian) / root[:, None], covariance, (number > 0).sum(axis=1)),
    )


def _excess(residual: Any, jacobian: Any, covariance: Any, number: NDArray[np.int64]) -> Array:
    """Excess of one sum of squares of ``number`` residuals.

    The sum has a chi-square distribution, whose cube root is nearly normal (Wilson and Hilferty 1931).
    """
    fitted = np.einsum("bij,bij->b", jacobian @ jacobian.transpose(0, 2, 1), covariance)
    freedom = np.maximum(number - fitted, 1.0)
    spread = 2.0 / (9.0 * freedom)
    excess = (np.cbrt((residual**2).sum(axis=1) / freedom) - 1.0 + spread) / np.sqrt(spread)
    return np.where(np.isfinite(excess), excess, np.inf)
