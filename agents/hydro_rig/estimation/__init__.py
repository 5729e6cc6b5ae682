"""Estimates what a recording does not show: the leak, friction, supply and more, with the simulator as model.

Windows of measured signals and a task with ranges come in; the most probable values of the unknowns, their
uncertainty and whether the model explains the readings go out. Open ``estimate.py`` first, then ``estimator.py`` (the
same as a detector of leaks) and ``unknowns.py`` (what can be estimated, with its priors).
"""
