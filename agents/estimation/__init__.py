"""Estimation with the simulator as model: which parameters and start states explain measured signals best."""
