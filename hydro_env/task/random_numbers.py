"""Counter-based random numbers for compiled code.

Seeding gives each axis one 64-bit root from its Gymnasium generator (``np_random``). The root is mixed into a key per
episode and source (:data:`PLANT` and the others); the n-th number of a key is a function of key and n alone. Hence one
source's draws never shift another's, the noise of a step does not depend on the number of axes, and nothing has to be
stored. Mixing function: SplitMix64 (Steele, Lea & Flood 2014).
"""

import math

import numpy as np

from hydro_env.compiling import inline

PLANT, LEAKAGE, INITIAL_STATE, REFERENCE, NOISE, DISTURBANCE, LATENCY, FAULT, RIG = range(9)  # each has its own key

_GOLDEN = np.uint64(0x9E3779B97F4A7C15)
_FIRST = np.uint64(0xBF58476D1CE4E5B9)
_SECOND = np.uint64(0x94D049BB133111EB)
_ONE = np.uint64(1)
_SHIFT_30 = np.uint64(30)
_SHIFT_27 = np.uint64(27)
_SHIFT_31 = np.uint64(31)
_SHIFT_11 = np.uint64(11)
_UNIT = 2.0**-53
_PAIRS_OF_KEY = 2


@inline
def _mix(value):
    value = (value ^ (value >> _SHIFT_30)) * _FIRST
    value = (value ^ (value >> _SHIFT_27)) * _SECOND
    return value ^ (value >> _SHIFT_31)


@inline
def redrawn(root, attempt):
    """The root for a further attempt to draw an episode; attempt 0 is the root itself."""
    return root if attempt == 0 else _mix(root ^ (_FIRST * np.uint64(attempt)))


@inline
def source_key(root, episode, source):
    """The key of one source of randomness in one episode of an axis."""
    of_episode = _mix(root + _GOLDEN * (np.uint64(episode) + _ONE))
    return _mix(of_episode + _GOLDEN * (np.uint64(source) + _ONE))


@inline
def uniform(key, index):
    """The ``index``-th number of a key, uniform in (0, 1)."""
    bits = _mix(key + _GOLDEN * (np.uint64(index) + _ONE))
    return (float(bits >> _SHIFT_11) + 0.5) * _UNIT


@inline
def between(key, index, low, high):
    """The ``index``-th number of a key, uniform in (low, high)."""
    return low + (high - low) * uniform(key, index)


@inline
def log_between(key, index, low, high):
    """The ``index``-th number of a key, log-uniform in (low, high)."""
    return low * (high / low) ** uniform(key, index)


@inline
def within(key, index, ends):
    """:func:`between` two ends, (2,)."""
    return between(key, index, ends[0], ends[1])


@inline
def log_within(key, index, ends):
    """:func:`log_between` two ends, (2,)."""
    return log_between(key, index, ends[0], ends[1])


@inline
def normal_pair(key, index):
    """The ``index``-th pair of standard normal numbers of a key (Box & Muller 1958)."""
    radius = math.sqrt(-2.0 * math.log(uniform(key, 2 * index)))
    angle = 2.0 * math.pi * uniform(key, 2 * index + 1)
    return radius * math.cos(angle), radius * math.sin(angle)


@inline
def noise_pair(key, step, pair):
    """Normal numbers of the channels ``2 pair`` and ``2 pair + 1`` at a step.

    The first two pairs share the key of the noise; each further pair has its own key: an additional channel does not
    change the noise of the others.
    """
    if pair < _PAIRS_OF_KEY:
        return normal_pair(key, _PAIRS_OF_KEY * step + pair)
    return normal_pair(_mix(key ^ (_SECOND * np.uint64(pair))), step)
