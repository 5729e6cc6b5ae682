"""Recordings of a rig: files, columns, units, time stamps, and checks."""
