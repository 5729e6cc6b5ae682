"""Intervals of the leak's size with correct coverage at every size.

The network gives three quantiles of the size. Validation windows give, for every true size, the distance between the
truth and the middle quantile, relative to the distance of the outer one. The interval contains the sizes for which the
network's answer is not among the rarest 5 % at either end (Neyman 1937, *Outline of a Theory of Statistical
Estimation*).
"""

import numpy as np

from hydro_env.types import Array, Floats, Indices, Mask

SIZES = np.linspace(-2.0, 0.7, 10)  # log10 of the true sizes, l/min at 100 bar, whose distances are stored

WIDTHS = 3
GROUPS = 2 * WIDTHS
"""Groups of windows, each with its own distances: by the width of the network's interval, and with a constant or a
changing leak."""

ROUNDS = 6  # iterations of the search for the ends
COVERAGE = 0.9  # share of the intervals that contain the true size
FEWEST, REACH = 40, 0.2  # smallest number of windows for a size; largest distance of a window from the size, in decades


def quantiles(output: Floats) -> Floats:
    """The 5, 50 and 95 % quantiles (N, 3) of log10 of the flow, from the outputs of the network."""
    middle, below, above = output[:, -3:].T
    return np.column_stack([middle - np.logaddexp(0.0, below - 2.0), middle, middle + np.logaddexp(0.0, above - 2.0)])


def groups(quantiles: Floats, change: Array, widths: Array, changing: float) -> Indices:
    """Group of each window, (N,), by its :func:`quantiles` and by how much its leak changes, (N,).

    ``widths`` are the bounds between the widths, ``changing`` is the smallest change that counts.
    """
    return WIDTHS * (change > changing).astype(np.int64) + np.searchsorted(widths, quantiles[:, 2] - quantiles[:, 0])


def intervals(quantiles: Floats, distance: Array) -> Floats:
    """Middle and ends (N, 3) of log10 of the size, from its :func:`quantiles`.

    ``distance`` (N, SIZES, 2) is that of the ends from the middle, relative to the distances of the quantiles.
    """
    low, middle, high = quantiles.T
    ends, places = [], np.arange(len(SIZES))
    for side, reach in enumerate((low - middle, high - middle)):
        end = middle
        for _ in range(ROUNDS):
            place = np.clip((end - SIZES[0]) / (SIZES[1] - SIZES[0]), 0.0, len(SIZES) - 1.001)
            near = np.maximum(1.0 - np.abs(place[:, None] - places), 0.0)  # weights of a linear interpolation
            end = middle + (near * distance[:, :, side]).sum(axis=1) * reach
        ends.append(end)
    return np.column_stack([middle, *ends])


def distances(quantiles: Floats, size: Array, chosen: Mask) -> Floats:
    """95 % quantile of the distance between truth and middle quantile, at each of SIZES and to each side, (SIZES, 2).

    It is a fraction of the distance of the outer quantiles. ``size`` is log10 of the true one, ``chosen`` are the
    windows of the group; if it has fewer than FEWEST of a size, all windows of that size are used.
    """
    low, middle, high = quantiles.T
    off = np.column_stack([(middle - size) / (middle - low), (size - middle) / (high - middle)])
    found = np.ones((len(SIZES), 2))
    for number, place in enumerate(SIZES):
        mine = near = np.abs(size - place) < REACH
        if (near & chosen).sum() >= FEWEST:
            mine = near & chosen
        if mine.any():
            found[number] = np.quantile(off[mine], 0.5 * (1.0 + COVERAGE), axis=0)
    return np.maximum(found, 0.0)
