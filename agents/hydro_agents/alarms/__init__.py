"""Alarms over time: they sum up the evidence of a detector, with a known rate of false alarms."""
