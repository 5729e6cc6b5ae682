"""Estimation with the simulator as model: the parameters and initial states that explain measured signals best."""
