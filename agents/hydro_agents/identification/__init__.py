"""Fits the unknowns of a rig file to a recording, and reports which of them the recording cannot determine."""
