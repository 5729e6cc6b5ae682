"""Profiles of a common fit along its curved valleys: how far its unknowns move while the readings allow it.

Some unknowns compensate each other along a curve: the dead volume and the wall of a hose, or the parts of a friction.
The inverse of the information matrix describes the tangent of such a valley, whose ends lie elsewhere. A profile moves
one unknown step by step and fits all others again (Raue et al., *Bioinformatics* 25, 2009), until the cost has risen as
far as at the end of an interval. What the others do along the way belongs to their intervals.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from hydro_env.types import Floats
from hydro_rig.estimation.solver import Effort, Problem, fit
from hydro_rig.estimation.unknowns import Prior
from hydro_rig.identification.common_fit import MOST_DAMPING, Joint, costs_of

PINNED = 1e-6  # standard deviation of an unknown that a fit keeps, in standard deviations of its range
ALIKE = 0.8  # correlation with a profiled unknown from which an unknown needs no profile of its own
MOST_PROFILES = 3
MOST_PLACES, MOST_ITERATIONS = 8, 8  # of one side of a profile, and of the fit at each place
SMALL_RISE = 0.25  # of the rest, by which the cost rises at least from place to place, unless the steps get longer
FIRST, LONGEST, LONGEST_PROFILE = 0.5, 2.5, 3.0
"""First step, as a share of the interval; largest ratio of two steps; longest profile, in standard deviations of the
range."""


class Path(NamedTuple):
    """One side of the profile of an unknown, K places from the fit on."""

    scaled: Floats  # (K, p), the common unknowns
    rise: Floats  # (K,), of the cost
    endless: bool  # whether the cost had not risen enough where the range of the unknown ends


def pinned(problem: Problem, values: dict[int, float]) -> Problem:
    """The problem with some unknowns, by their places, kept at scaled values; their scaled values are 0 there."""
    model = problem.model
    priors = dict(model.priors)
    for place, value in values.items():
        name = model.names[place]
        prior = priors[name]
        priors[name] = Prior(float(prior.value(np.array(value))), PINNED * prior.deviation, prior.logarithmic)
    return problem._replace(model=model.with_priors(priors))


def ridge(joint: Joint, unknown: int) -> Floats:
    """Change of all unknowns, (B, P) scaled, per change of one common unknown, by the linear model of a fit."""
    tangent = joint.covariance[unknown] / joint.covariance[unknown, unknown]
    slope = np.zeros_like(joint.scaled)
    slope[:, joint.shared] = tangent
    slope[:, joint.own] = joint.response @ tangent
    return slope


def follow(problem: Problem, joint: Joint, unknown: int, reach: float, target: float, end: float) -> Path:
    """Move one common unknown from a fit, and fit the others again, until the cost has risen by ``target``.

    Args:
        problem: of the windows of the fit.
        joint: the fit.
        unknown: its number among the common ones.
        reach: end of its interval by the linear model, scaled, from the fit; its sign gives the side.
        target: rise of the cost at the end of an interval.
        end: of the unknown's range on this side, scaled; infinite: none.
    """
    slope = ridge(joint, unknown)
    place = int(joint.shared[unknown])
    begin = costs_of(problem, [joint.scaled])[0]
    path, rises, away, step = [joint.scaled], [0.0], [0.0], FIRST * reach
    effort = Effort(MOST_ITERATIONS, 0.1 * target, give_up=MOST_DAMPING)
    most = min(abs(end - joint.scaled[0, place]), LONGEST_PROFILE) * float(np.sign(reach))
    for _ in range(MOST_PLACES):
        if abs(away[-1]) >= abs(most):
            break
        moved = away[-1] + step if abs(away[-1] + step) < abs(most) else most
        step = moved - away[-1]
        first = path[-1] + slope * step
        here = pinned(problem, {place: float(joint.scaled[0, place] + moved)})
        first[:, place] = 0.0
        found, _ = fit(here, first, effort, shared=joint.shared)
        found[:, place] = joint.scaled[0, place] + moved
        rise = costs_of(problem, [found])[0] - begin
        slope = (found - path[-1]) / step
        path.append(found)
        rises.append(max(rise, 0.0))
        away.append(moved)
        if not rise < target:
            break
        further = abs(1.1 * moved) * (np.sqrt(target / max(rise, 1e-9)) - 1.0)  # if the cost rises with the square
        flat = rises[-1] - rises[-2] < SMALL_RISE * (target - rise)
        step *= LONGEST if flat else float(np.clip(further / abs(step), 0.2, LONGEST))
    places, rise_at = np.array(path)[:, 0, joint.shared], np.array(rises)
    if rise_at[-1] > target:  # the end lies before the last place
        share = (np.sqrt(target) - np.sqrt(rise_at[-2])) / (np.sqrt(rise_at[-1]) - np.sqrt(rise_at[-2]))
        places[-1] = places[-2] + share * (places[-1] - places[-2])
        rise_at[-1] = target
    return Path(places, rise_at, bool(rise_at[-1] < target and abs(away[-1]) >= abs(most)))
