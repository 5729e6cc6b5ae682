"""Compares controllers, and detectors of leaks, under conditions: a protocol's jobs, their rows, tables, intervals.

Comes in: a protocol (YAML or Python) and participants by name; goes out: one CSV table per question, each figure with
its interval. Open ``conditions.py`` first (a protocol and its cells), then ``runner.py`` (jobs to tables); an
evaluation on test plants (``evaluate.py``) is a protocol with one condition, and a study (``study.py``) tunes and
trains its controllers before it runs one.
"""
