"""Watches axes over months.

Recordings of each day come in; one table with a row per reading, a page, and an exit code for timers go out. Open
``watch.py`` first, then ``trend.py`` (what the table says about an axis).
"""
