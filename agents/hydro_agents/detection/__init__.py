"""Leaks, from windows of measured signals to a reading and an alarm over time."""
