"""Kinks of the solution: its derivative jumps where a part meets or leaves a limit.

A Runge–Kutta step across such a point loses its order, and its error estimate does not always detect it. Each part
predicts its next kink; the integrator ends a step there.
"""

import math

from hydro_env.compiling import inline

FAR = 1e9  # s; no kink ahead
GRAZING = 0.3  # a motion that covers 1 / (1 + GRAZING) of the distance to a limit and reverses may still meet it


@inline
def time_to_cover(distance, rate, change):
    """First time t > 0 with rate t + change t²/2 = distance (≥ 0), s; :data:`FAR` if there is none.

    If the motion turns just short of the limit, this is the turning time: the extrapolation may be off by that much.
    """
    under_root = rate * rate + 2.0 * change * distance
    divisor = rate + math.sqrt(max(under_root, 0.0))
    grazing = under_root < 0.0 and under_root > -GRAZING * rate * rate and rate > 0.0
    crossing = 2.0 * distance / divisor if under_root >= 0.0 and divisor > 0.0 else FAR
    return -rate / change if grazing else crossing
