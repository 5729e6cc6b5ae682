"""Alarms over time: evidence of a detector, look after look, summed up into alarms with a known rate of false ones."""
