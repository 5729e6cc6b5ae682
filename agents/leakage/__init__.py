"""Notices the leak from what the rig measures: the leakage head, its training, its metrics."""
