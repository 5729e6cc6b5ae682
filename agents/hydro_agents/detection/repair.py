"""Fills gaps of measured signals: a lost sample gets the previous reading. Compiled code for one signal at a time."""

from __future__ import annotations

from hydro_env.compiling import inline

LONGEST_GAP = 5
"""Samples; a reading that stays at the lower end of its range for longer is valid."""


@inline
def mark_lost(values, low, high, far, lost):
    """Mark lost samples by 1 in ``lost``: NaN, and short falls to the lower end of the sensor's range.

    ``far`` is the fraction of the range by which a valid signal does not fall within one period.
    """
    samples = values.shape[0]
    end = low + 1e-9 * (high - low)
    begin = 0  # of the run of readings at the end of the range
    for k in range(samples):
        lost[k] = 0.0 if values[k] == values[k] else 1.0
    for k in range(samples + 1):
        if not (k < samples and values[min(k, samples - 1)] <= end):
            if k - begin <= LONGEST_GAP:
                for gap in range(begin, k):
                    fallen = values[max(gap - 1, 0)] > low + far * (high - low)
                    if gap > begin or fallen or (begin == 0 and values[samples - 1] <= end):
                        lost[gap] = 1.0
            begin = k + 1


@inline
def fill_gaps(values, lost, filled):
    """Copy a signal to ``filled``, with lost readings replaced by the previous one; returns the share of lost readings.

    Gaps at the start take the first reading; a signal without any reading is 0.
    """
    samples = values.shape[0]
    first = 0
    for k in range(samples):
        if lost[k] == 0.0:
            first = k
            break
    held, share = values[first] if values[first] == values[first] else 0.0, 0.0
    for k in range(samples):
        if lost[k] == 0.0:
            held = values[k]
        else:
            share += 1.0
        filled[k] = held
    return share / samples
