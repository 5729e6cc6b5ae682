"""Watches axes over months: the trend of recordings, and alarms tried on simulated axes.

Recordings of each day come in; one table with a row per reading, and a page with a sentence per axis, go out.
``alarm_*`` set an alarm and measure how often it is false and how late. Open ``trend_job.py`` first, then
``trend_summary.py`` (what the table says about an axis).
"""
