"""A recording comes in; a verdict with the size of the leak, a page and tables go out.

The road: checked samples (:mod:`hydro_rig.recordings.quality`) → ``pipeline`` (windows, readings, one way for all
commands) → ``verdict`` (rules) → pages; ``change`` compares two recordings, ``leak_test_*`` plan an active test and
read it. Open ``pipeline.py`` first, then ``verdict.py``.
"""
