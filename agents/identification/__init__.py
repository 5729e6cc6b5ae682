"""Fits what a rig file leaves open to a recording, and tells what the recording cannot determine."""
