"""Identifies a rig from recordings: one fit of all windows.

Recordings and the file of a rig come in; the identified rig goes out, with narrowed ranges, what each recording
determines, and a page. Open ``identify.py`` first (the whole job), then ``fit.py`` (values and intervals).
"""
