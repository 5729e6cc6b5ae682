"""Watches the axes of a fleet, while they run and over months.

Rows of running axes or recordings of each day come in; one table with a row per reading, a page of all axes, and an
exit code for timers go out. Open ``fleet.py`` first, then ``watch.py`` (files) or ``stream.py`` (rows), and
``trend.py`` (what the table says about an axis).
"""
