"""Leak detection from measured signals: the leakage head, its training, its metrics."""
